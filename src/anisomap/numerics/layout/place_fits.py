"""How well single sensors fit the places of others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap.numerics.layout.evidence import Evidence

MIN_GAIN = 15.0
"""Least gain in nats of a move.

On the right layouts of icub_torso and nao_torso no swap gains more than 5; every one of 300 seeded
swaps of 3 spacings and more gained 35 and more (seed 1).
"""


class PlaceFits:
    """Log-likelihoods of single sensors at the places of others.

    Parameters
    ----------
    evidence : Evidence
    """

    def __init__(self, evidence: Evidence) -> None:
        self._evidence = evidence
        self._distances = cdist(evidence.positions, evidence.positions)
        self._total = evidence.likelihood.sum(axis=1)

    def places_near(self, sensor: int) -> NDArray[np.intp]:
        """Return the sensors whose places are near those most similar to a sensor."""
        evidence = self._evidence
        near = (self._distances[evidence.similar(sensor)] <= evidence.reach).any(axis=0)
        return np.flatnonzero(near & (self._distances[sensor] > 0))

    def gains(self, sensor: int, others: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the gains of a sensor at the places of others, which are left out."""
        evidence = self._evidence
        after = evidence.falloff.log_likelihood(evidence.similarity[sensor], evidence.bins[others])
        known = np.repeat(evidence.known[sensor][None], len(others), axis=0)
        known[np.arange(len(others)), others] = False
        before = self._total[sensor] - evidence.likelihood[sensor, others]
        return np.asarray(np.where(known, after, 0.0).sum(axis=1) - before)

    def gains_at(self, sensor: int, others: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the gains of others at the place of a sensor, which is left out."""
        evidence = self._evidence
        after = evidence.falloff.log_likelihood(evidence.similarity[others], evidence.bins[sensor])
        known = evidence.known[others]
        known[:, sensor] = False
        before = self._total[others] - evidence.likelihood[others, sensor]
        return np.asarray(np.where(known, after, 0.0).sum(axis=1) - before)

    def best_gains(self, min_distance: float = 0.0) -> NDArray[np.float64]:
        """Return the largest gain of each sensor at the place of another, shape (n,).

        Parameters
        ----------
        min_distance : float
            Least distance of that place, in units of the positions.

        Returns
        -------
        ndarray of shape (n,)
            -inf for sensors that are not usable, and without such a place.
        """
        best = np.full(len(self._distances), -np.inf)
        for i in np.flatnonzero(self._evidence.usable).tolist():
            places = self.places_near(i)
            places = places[self._distances[i, places] >= min_distance]
            if places.size:
                best[i] = self.gains(i, places).max()
        return best
