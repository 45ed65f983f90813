"""Agreement of sensors with those around a place, and its gain by chance after shifts in time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import REACH, Evidence, Move
from anisomap.numerics.precision import Reals

_WIDTH = 1.3  # spacings, of the Gaussian weights of neighbours; chosen by hand
_MIN_WEIGHT = 0.3  # of all neighbours: about one sensor at 2 spacings; chosen by hand


@dataclass(frozen=True, eq=False)
class Chance:
    """What shifted readings gain by the free choice of a place.

    shifted (s, n, n): Similarities of each sensor, the row, to the others, after s circular shifts.
    gains (s, n): Largest agreement of a shifted sensor at any place, less that at its stated place.
    """

    shifted: Reals
    gains: NDArray[np.float64]

    @classmethod
    def of(cls, shifted: Reals, evidence: Evidence) -> Chance:
        """Compute the gains of shifted sensors on a layout."""
        weights: Any = neighbour_weights(evidence)
        return cls(shifted, np.stack([_free_gains(one, weights, evidence) for one in shifted]))

    def of_sensors(self, sensors: NDArray[np.intp]) -> float:
        """Return the largest mean gain of some sensors that each choose any place.

        The sensors were chosen, too: it is no less than the mean of as many of the largest gains,
        the median of the shifts.
        """
        known = np.isfinite(self.gains[0])
        count = int(known[sensors].sum())
        if not count:
            return 0.0
        own = self.gains[:, sensors[known[sensors]]].mean(axis=1).max()
        largest = np.sort(self.gains[:, known], axis=1)[:, -count:].mean(axis=1)
        return float(max(own, np.median(largest)))

    def of_moves(self, evidence: Evidence, moves: Iterable[Move]) -> float:
        """Return the largest gain of alternative moves of the same sensors."""
        return max(agreement_gain(evidence, move, self.shifted) for move in moves)


def agreement(
    evidence: Evidence, sensors: NDArray[np.intp], places: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the mean similarity of sensors to those around places, which did not move with them.

    places (m, k) -> (m,).
    """
    others, weights = _weights_around(evidence, sensors, places)
    return _means((weights * evidence.similarity[sensors][:, others]).sum(axis=1), weights)


def agreement_gain(
    evidence: Evidence, move: Move, similarities: Iterable[Reals] | None = None
) -> float:
    """Return the increase of the mean `agreement` of sensors by a move.

    It is 0 if no place has neighbours after the move; without neighbours before it, agreement is
    0 before.

    similarities: Several, of which the largest increase counts; that of the evidence by default.
    """
    sensors = move.sensors
    others, before = _weights_around(evidence, sensors, evidence.positions[sensors])
    _, after = _weights_around(evidence, sensors, move.places)
    if after.sum() <= _MIN_WEIGHT:
        return 0.0
    gains = []
    for one in [evidence.similarity] if similarities is None else similarities:
        similarity = one[sensors][:, others]
        stated, there = ((weights * similarity).sum(axis=1).sum() for weights in (before, after))
        stated = stated / before.sum() if before.sum() > _MIN_WEIGHT else 0.0
        gains.append(float(there / after.sum() - stated))
    return max(gains)


def median_gain(evidence: Evidence, move: Move) -> float:
    """Return the increase of the `agreement` of the median sensor that a move displaces.

    Without neighbours, agreement is 0; sensors without any before and after do not count. If two
    sensors are in the middle, the one that gains less counts.
    """
    here = evidence.positions[move.sensors]
    before, after = (agreement(evidence, move.sensors, places) for places in (here, move.places))
    counted = (move.places != here).any(axis=1) & (np.isfinite(before) | np.isfinite(after))
    gains = np.sort((np.nan_to_num(after) - np.nan_to_num(before))[counted])
    return float(gains[(gains.size - 1) // 2]) if gains.size else 0.0


def own_agreement(evidence: Evidence) -> NDArray[np.float64]:
    """Return the `agreement` of each sensor alone at its position, shape (n,)."""
    weights: Any = neighbour_weights(evidence)
    sums = weights.multiply(np.asarray(evidence.similarity, dtype=np.float64)).sum(axis=1)
    return _means(np.asarray(sums), weights)


def _weights_around(
    evidence: Evidence, sensors: NDArray[np.intp], places: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Mark the usable sensors but some, and return their weights around places of these."""
    others = evidence.usable.copy()
    others[sensors] = False
    weights = _weights(evidence, cdist(places, evidence.positions[others]))
    weights *= evidence.usable[sensors][:, None]
    return others, weights


def neighbour_weights(evidence: Evidence) -> Any:
    """Return the weights of the usable sensors around each position, without its own sensor."""
    weights = _weights(evidence, cdist(evidence.positions, evidence.positions))
    weights *= evidence.usable
    np.fill_diagonal(weights, 0)
    return csr_array(weights)


def _weights(evidence: Evidence, distances: NDArray[np.float64]) -> NDArray[np.float64]:
    spacings = distances / evidence.falloff.spacing
    return np.where(spacings <= REACH, np.exp(-((spacings / _WIDTH) ** 2) / 2), 0.0)


def _means(sums: NDArray[np.float64], weights: Any) -> NDArray[np.float64]:
    """Divide sums by those of their weights; NaN where these are small."""
    total = np.asarray(weights.sum(axis=1))
    unknown = np.full(sums.shape, np.nan)
    return np.asarray(np.divide(sums, total, out=unknown, where=total > _MIN_WEIGHT))


def _free_gains(shifted: Reals, weights: Any, evidence: Evidence) -> NDArray[np.float64]:
    """Return the gain of each sensor by the free choice of a place, shape (n,)."""
    others = np.array(shifted, dtype=np.float64)
    np.fill_diagonal(others, 0.0)
    sums = np.asarray(weights @ others.T).T
    # A sensor is not among its own neighbours at any place.
    total = np.asarray(weights.sum(axis=1))[None, :] - weights.T.toarray()
    mean = np.divide(sums, total, out=np.full(sums.shape, np.nan), where=total > _MIN_WEIGHT)
    best = np.where(np.isnan(mean), -np.inf, mean).max(axis=1)
    known = evidence.usable & np.isfinite(best)
    return np.where(known, best - np.nan_to_num(np.diag(mean)), np.nan)
