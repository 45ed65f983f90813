"""Log-likelihood of the similarities of sensors at given positions, and its gain by moves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap.numerics.layout.falloff import Falloff
from anisomap.numerics.precision import Reals

REACH = 2.6
"""Distance in spacings up to which sensors count as neighbours; chosen by hand.

The second ring of a hexagonal lattice is 2 spacings away, and modules have gaps of 2.2 spacings.
"""

_N_SIMILAR = 6  # most similar sensors, near which a sensor may belong; chosen by hand


@dataclass(frozen=True, eq=False)
class Move:
    """Positions other than the stated ones for some sensors.

    Attributes
    ----------
    sensors : ndarray of int, shape (m,)
    places : ndarray of shape (m, k)
        Their new positions.
    """

    sensors: NDArray[np.intp]
    places: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Proposal:
    """A move and its gain.

    Attributes
    ----------
    gain : float
        Increase of the log-likelihood of all similarities, in nats.
    move : Move
    alternatives : tuple of Move
        Moves of the same sensors among which it was chosen, itself included; empty if each sensor
        could have had any place.
    """

    gain: float
    move: Move
    alternatives: tuple[Move, ...] = ()


@dataclass(frozen=True, eq=False)
class Evidence:
    """Similarities of n sensors, and the positions that they are compared with.

    Attributes
    ----------
    similarity : ndarray of shape (n, n)
        Row i: of sensor i to each other sensor. It need not be symmetric, since in a null of
        shifted readings, sensor i is shifted against the others.
    positions : ndarray of shape (n, k)
        Current positions.
    usable : ndarray of bool, shape (n,)
        Sensors whose similarities say something.
    falloff : Falloff
    """

    similarity: Reals
    positions: NDArray[np.float64]
    usable: NDArray[np.bool_]
    falloff: Falloff

    def with_similarity(self, similarity: Reals) -> Evidence:
        """Return the same with other similarities."""
        return replace(self, similarity=similarity)

    def moved(self, move: Move) -> Evidence:
        """Return the same with some sensors at other positions."""
        positions = self.positions.copy()
        positions[move.sensors] = move.places
        return replace(self, positions=positions)

    @cached_property
    def bins(self) -> NDArray[np.uint8]:
        """Bins of the distances between current positions, shape (n, n)."""
        return self.falloff.bins(cdist(self.positions, self.positions))

    @cached_property
    def known(self) -> NDArray[np.bool_]:
        """Pairs of two different usable sensors, shape (n, n)."""
        return np.outer(self.usable, self.usable) & ~np.eye(len(self.usable), dtype=bool)

    @cached_property
    def likelihood(self) -> NDArray[np.float64]:
        """Log-likelihood of each similarity at current positions; 0 for pairs not `known`."""
        values = self.falloff.log_likelihood(self.similarity, self.bins)
        return np.where(self.known, values, 0.0)

    def likelihood_at(
        self, sensors: NDArray[np.intp], places: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return the log-likelihood of similarities to all sensors, if some were elsewhere.

        Parameters
        ----------
        sensors : ndarray of int, shape (m,)
        places : ndarray of shape (m, k)
            Where they are supposed to be; all others are where they are.

        Returns
        -------
        ndarray of shape (m, n)
            0 for pairs that are not `known`.
        """
        bins = self.falloff.bins(cdist(places, self.positions))
        values = self.falloff.log_likelihood(self.similarity[sensors], bins)
        return np.where(self.known[sensors], values, 0.0)

    def gain(self, move: Move) -> float:
        """Return the increase of the log-likelihood by a move of some sensors together."""
        sensors = move.sensors
        change = self.likelihood_at(sensors, move.places) - self.likelihood[sensors]
        # Pairs of moved sensors are at the distance of their new places, and in two rows.
        bins = self.falloff.bins(cdist(move.places, move.places))
        inside = np.ix_(sensors, sensors)
        values = self.falloff.log_likelihood(self.similarity[inside], bins)
        within = np.where(self.known[inside], values, 0.0) - self.likelihood[inside]
        return float(change.sum() - change[:, sensors].sum() + within.sum() / 2)

    def similar(self, sensor: int) -> NDArray[np.intp]:
        """Return the usable sensors that are most similar to a sensor."""
        row = np.where(self.usable, self.similarity[sensor], -np.inf)
        row[sensor] = -np.inf
        n_similar = min(_N_SIMILAR, np.count_nonzero(np.isfinite(row)))
        return np.argsort(-row, kind="stable")[:n_similar]

    @property
    def reach(self) -> float:
        """Distance up to which sensors count as neighbours, in units of the positions."""
        return REACH * self.falloff.spacing
