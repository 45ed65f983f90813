"""Agreement of sensors with those around a place, and its gain by chance after shifts in time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.spatial.distance import cdist

from anisomap.base.defaults import N_SHIFTS
from anisomap.errors import InputError
from anisomap.numerics.layout.evidence import REACH, Evidence, Move
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.split_half import split_blocks
from anisomap.numerics.signals import unit_rows
from anisomap.numerics.similarity.correlation import scale_extremes
from anisomap.numerics.similarity.rest import ranks_of_depths

N_PERMUTATIONS = 199
"""Number of shuffled layouts that a layout is compared with."""

MIN_FRAMES = 40
"""Minimum number of frames: 2 in each of the 20 blocks of `split_blocks`."""

_MIN_SHIFT = 0.05  # of the recording: shorter shifts leave contacts correlated; chosen by hand
_N_BEST = 3  # most similar sensors that show that a sensor says something; chosen by hand


@dataclass(frozen=True, eq=False)
class ReadingStatistics:
    """Similarities of n sensors, and how similar they are by chance.

    similarity: Correlation of the ranks of the depths beyond rest.
    halves: The same for two halves of alternating blocks of frames.
    shifted: The same after s circular shifts of sensor i, the row, against all others.
    tested: Sensors whose similarity to the 3 most similar sensors exceeds that after every shift.
    """

    similarity: Reals
    halves: Reals
    shifted: Reals
    tested: NDArray[np.bool_]

    def select(self, sensors: NDArray[np.intp]) -> ReadingStatistics:
        """Return the statistics of some sensors, given as indices, in that order."""
        if np.array_equal(sensors, np.arange(len(self.tested))):
            return self
        inside = np.ix_(sensors, sensors)
        return ReadingStatistics(
            self.similarity[inside],
            np.stack([half[inside] for half in self.halves]),
            np.stack([one[inside] for one in self.shifted]),
            self.tested[sensors],
        )


def reading_statistics(
    readings: ArrayLike, rng: np.random.Generator, *, n_shifts: int = N_SHIFTS
) -> ReadingStatistics:
    """Compute the similarities of all pairs of sensors, and their null distribution.

    Parameters
    ----------
    readings : array_like of shape (T, n)
        Finite readings.
    rng : numpy.random.Generator
        Draws the shifts.
    n_shifts : int
        At least 1.

    Returns
    -------
    ReadingStatistics

    Raises
    ------
    InputError
        If there are fewer than 40 frames.
    """
    values = scale_extremes(readings)
    n_frames = len(values)
    if n_frames < MIN_FRAMES:
        raise InputError(f"a check needs at least {MIN_FRAMES} frames, got {n_frames}")
    ranks = ranks_of_depths(values)
    whole = unit_rows(ranks).T
    similarity = _symmetric(whole.T @ whole)
    halves = []
    for frames in split_blocks(n_frames):
        half = unit_rows(ranks[frames]).T
        halves.append(_symmetric(half.T @ half))
    least = max(1, int(_MIN_SHIFT * n_frames))
    lags = rng.integers(least, n_frames - least, size=n_shifts, endpoint=True)
    shifted = np.stack([_shifted_product(whole, int(lag)) for lag in lags])
    strength = _strength(similarity)
    chance = np.stack([_strength(one) for one in shifted])
    tested = (strength > chance.max(axis=0)) & (strength > 0)
    return ReadingStatistics(similarity, np.stack(halves), shifted, tested)


def _symmetric(product: NDArray[np.float32]) -> NDArray[np.float32]:
    mean = (product + product.T) / 2
    return np.clip(mean, -1, 1)


def _shifted_product(values: NDArray[np.float32], lag: int) -> NDArray[np.float32]:
    """Correlate each sensor, shifted circularly by `lag` frames, with all others."""
    return np.asarray(values[:-lag].T @ values[lag:] + values[-lag:].T @ values[:lag])


def _strength(similarity: Reals) -> NDArray[np.float32]:
    """Return the mean similarity of each sensor to its most similar others."""
    others = np.array(similarity)
    np.fill_diagonal(others, -1)
    n_best = min(_N_BEST, len(others) - 1)
    best = np.partition(others, len(others) - n_best, axis=1)[:, len(others) - n_best :]
    return np.asarray(best.mean(axis=1))


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
        weights: Any = _neighbour_weights(evidence)
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

    Without neighbours, agreement is 0; sensors without any before and after do not count. Of two
    sensors in the middle, it is the one that gains less.
    """
    here = evidence.positions[move.sensors]
    before, after = (agreement(evidence, move.sensors, places) for places in (here, move.places))
    counted = (move.places != here).any(axis=1) & (np.isfinite(before) | np.isfinite(after))
    gains = np.sort((np.nan_to_num(after) - np.nan_to_num(before))[counted])
    return float(gains[(gains.size - 1) // 2]) if gains.size else 0.0


def own_agreement(evidence: Evidence) -> NDArray[np.float64]:
    """Return the `agreement` of each sensor alone at its position, shape (n,)."""
    weights: Any = _neighbour_weights(evidence)
    sums = weights.multiply(np.asarray(evidence.similarity, dtype=np.float64)).sum(axis=1)
    return _means(np.asarray(sums), weights)


def agreement_as_a_whole(
    evidence: Evidence, rng: np.random.Generator, *, n_permutations: int = N_PERMUTATIONS
) -> tuple[float, float]:
    """Return how well a layout explains the similarities as a whole: its p, and its share.

    p: Of a layout whose sensors are shuffled.
    share: Agreement beyond that of shuffled layouts, over that of each sensor with the others that
        it resembles most, as many as it has neighbours. If a share s of the sensors is shuffled, it
        is (1 - s)^2 of that of the right layout, since both sensors of a pair must be right.
    """
    usable = np.flatnonzero(evidence.usable)
    weights: Any = _neighbour_weights(evidence)[usable][:, usable]
    similarity = np.array(evidence.similarity[np.ix_(usable, usable)], dtype=np.float64)
    np.fill_diagonal(similarity, 0)
    first, second = weights.nonzero()
    if not first.size:
        return 1.0, 0.0
    values = weights[first, second]

    def total(order: NDArray[np.intp]) -> float:
        return float(values @ similarity[order[first], order[second]])

    stated = total(np.arange(usable.size))
    shuffled = np.array([total(rng.permutation(usable.size)) for _ in range(n_permutations)])
    p = (1 + np.count_nonzero(shuffled >= stated)) / (1 + n_permutations)
    by_sensor = np.lexsort((-values, first))
    rank = np.arange(first.size) - np.searchsorted(first[by_sensor], first[by_sensor])
    highest = -np.sort(-similarity, axis=1)
    best = float(values[by_sensor] @ highest[first[by_sensor], rank])
    expected = float(shuffled.mean())
    return p, (stated - expected) / max(best - expected, 1e-12)


def _weights_around(
    evidence: Evidence, sensors: NDArray[np.intp], places: NDArray[np.float64]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Mark the usable sensors but some, and return their weights around places of these."""
    others = evidence.usable.copy()
    others[sensors] = False
    weights = _weights(evidence, cdist(places, evidence.positions[others]))
    weights *= evidence.usable[sensors][:, None]
    return others, weights


def _neighbour_weights(evidence: Evidence) -> Any:
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
