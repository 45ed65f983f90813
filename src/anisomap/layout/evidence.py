"""Likelihood of similarities at distances on a layout, and its gain by moves of sensors."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression
from scipy.spatial.distance import cdist, pdist

from anisomap.numerics.neighbours import nearest_distances
from anisomap.numerics.precision import Reals

_MIN_PAIRS = 6  # per bin, for a median and a spread; chosen by hand
_MIN_SPREAD = 0.05  # of a similarity; keeps distant pairs, which agree closely, from dominating
_RESOLUTION = 4  # steps per spacing, of which the edges of bins are multiples
_LARGEST = 1000  # spacings; all larger distances are in the last bin
# Edges of bins in spacings, chosen by hand: 1.25, 1.75 ... 11.75, and then in equal ratios.
_EDGES = np.concatenate(
    [
        np.arange(1.25, 12, 0.5),
        np.round(np.geomspace(12.5, _LARGEST, 25) * _RESOLUTION) / _RESOLUTION,
    ]
)
_BIN_OF_STEP = np.searchsorted(
    _EDGES, np.arange(_LARGEST * _RESOLUTION + 1) / _RESOLUTION, side="right"
).astype(np.uint8)
_DEGREES = 3.0
"""Degrees of freedom of Student's t distribution: single pairs that fit no distance count little.

Between 2 and 5, the results on icub_torso and nao_torso differ little (seeds 1 to 40).
"""


@dataclass(frozen=True, eq=False)
class Falloff:
    """Distribution of the similarity of two sensors, given their distance.

    spacing: Median distance between neighbours, in units of the positions.
    level (B,): Median similarity in each bin; does not increase.
    spread (B,): Spread of the similarity in each bin: 1.48 times the median absolute deviation.
    """

    spacing: float
    level: NDArray[np.float64]
    spread: NDArray[np.float64]

    def bins(self, distances: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the bin of each distance, given in units of the positions."""
        steps = distances * (_RESOLUTION / self.spacing)
        return _BIN_OF_STEP[np.minimum(steps, len(_BIN_OF_STEP) - 1).astype(np.int32)]

    @cached_property
    def _peak(self) -> NDArray[np.float64]:
        """Log-likelihood of a similarity at the level of each bin, shape (B,)."""
        return np.asarray(-np.log(self.spread))

    def log_likelihood(self, similarity: Reals, bins: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Return the log-likelihood of similarities at distances, up to a constant."""
        deviation = (similarity - self.level[bins]) / self.spread[bins]
        tail = (_DEGREES + 1) / 2 * np.log1p(deviation**2 / _DEGREES)
        return np.asarray(self._peak[bins] - tail)


def neighbour_spacing(positions: NDArray[np.float64]) -> float:
    """Return the median distance to the nearest sensor at another position; 0 if there is none."""
    places = np.unique(positions, axis=0)
    if len(places) < 2:
        return 0.0
    return float(np.median(nearest_distances(places)))


def fit_falloff(similarity: Reals, positions: NDArray[np.float64], spacing: float) -> Falloff:
    """Fit the falloff of similarity with distance. similarity (n, n), positions (n, k)."""
    pairs = np.triu_indices(len(positions), 1)
    values = np.asarray(similarity[pairs], dtype=np.float64)
    distances = pdist(positions) / spacing
    label = np.searchsorted(_EDGES, distances, side="right")
    order = np.argsort(label, kind="stable")
    ends = np.searchsorted(label[order], np.arange(len(_EDGES) + 2))
    centre, level, spread, weight = [], [], [], []
    for k in range(len(_EDGES) + 1):
        inside = values[order[ends[k] : ends[k + 1]]]
        if inside.size >= _MIN_PAIRS:
            middle = float(np.median(inside))
            centre.append(k)
            level.append(middle)
            spread.append(1.4826 * float(np.median(np.abs(inside - middle))))
            weight.append(inside.size)
    if not centre:  # so few sensors that no bin is filled
        centre, weight = [0], [1]
        level, spread = [float(np.median(values))], [float(np.ptp(values)) / 2]
    decreasing = isotonic_regression(level, weights=weight, increasing=False).x
    every = np.arange(len(_EDGES) + 1)
    return Falloff(
        spacing,
        np.interp(every, centre, decreasing),
        np.maximum(np.interp(every, centre, spread), _MIN_SPREAD),
    )


REACH = 2.6
"""Distance in spacings up to which sensors count as neighbours; chosen by hand.

The second ring of a hexagonal lattice is 2 spacings away, and modules have gaps of 2.2 spacings.
"""

_N_SIMILAR = 6  # most similar sensors, near which a sensor may belong; chosen by hand


@dataclass(frozen=True, eq=False)
class Move:
    """Positions other than the stated ones for some sensors.

    places (m, k): Their new positions.
    """

    sensors: NDArray[np.intp]
    places: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Proposal:
    """A move and its gain.

    gain: Increase of the log-likelihood of all similarities, in nats.
    alternatives: Moves of the same sensors among which it was chosen, itself included; empty if
        each sensor could have had any place.
    """

    gain: float
    move: Move
    alternatives: tuple[Move, ...] = ()


@dataclass(frozen=True, eq=False)
class Evidence:
    """Similarities of n sensors, and the positions that they are compared with.

    similarity (n, n): Row i: of sensor i to each other sensor. It need not be symmetric, since in a
        null of shifted readings, sensor i is shifted against the others.
    positions (n, k): Current positions.
    usable: Sensors whose similarities say something.
    """

    similarity: Reals
    positions: NDArray[np.float64]
    usable: NDArray[np.bool_]
    falloff: Falloff

    def with_similarity(self, similarity: Reals) -> Evidence:
        """Return the same with other similarities."""
        return replace(self, similarity=similarity)

    def refitted(self) -> Evidence:
        """Return the same with the falloff of the current positions."""
        inside = self.similarity[np.ix_(self.usable, self.usable)]
        falloff = fit_falloff(inside, self.positions[self.usable], self.falloff.spacing)
        return replace(self, falloff=falloff)

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

        places (m, k) -> (m, n).
        """
        bins = self.falloff.bins(cdist(places, self.positions))
        values = self.falloff.log_likelihood(self.similarity[sensors], bins)
        return np.where(self.known[sensors], values, 0.0)

    def gain(self, move: Move, before: NDArray[np.float64] | None = None) -> float:
        """Return the increase of the log-likelihood by a move of some sensors together.

        before (m, n): Log-likelihoods of these sensors, if known from another move of them.
        """
        sensors = move.sensors
        if before is None:
            before = self.likelihood_at(sensors, self.positions[sensors])
        change = self.likelihood_at(sensors, move.places) - before
        # Pairs of moved sensors are at the distance of their new places, and in two rows.
        bins = self.falloff.bins(cdist(move.places, move.places))
        inside = np.ix_(sensors, sensors)
        values = self.falloff.log_likelihood(self.similarity[inside], bins)
        within = np.where(self.known[inside], values, 0.0) - before[:, sensors]
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


MIN_GAIN = 15.0
"""Least gain in nats of a move.

On the right layouts of icub_torso and nao_torso no swap gains more than 5; every one of 300 seeded
swaps of 3 spacings and more gained 35 and more (seed 1).
"""
