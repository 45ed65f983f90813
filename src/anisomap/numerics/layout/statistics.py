"""Similarities of all sensors, of halves of the frames, and after circular shifts in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.split_half import split_blocks
from anisomap.numerics.similarity.correlation import scale_extremes
from anisomap.numerics.similarity.rest import ranks_of_depths

N_SHIFTS = 19
"""Number of circular shifts: an unrelated sensor exceeds all of them with probability 1/20."""

MIN_FRAMES = 40
"""Minimum number of frames: 2 in each of the 20 blocks of `split_blocks`."""

_MIN_SHIFT = 0.05  # of the recording: shorter shifts leave contacts correlated; chosen by hand
_N_BEST = 3  # most similar sensors that show that a sensor says something; chosen by hand


@dataclass(frozen=True, eq=False)
class ReadingStatistics:
    """Similarities of n sensors, and how similar they are by chance.

    Attributes
    ----------
    similarity : ndarray of float32, shape (n, n)
        Correlation of the ranks of the depths beyond rest.
    halves : ndarray of float32, shape (2, n, n)
        The same for two halves of alternating blocks of frames.
    shifted : ndarray of float32, shape (s, n, n)
        The same after s circular shifts of sensor i, the row, against all others.
    tested : ndarray of bool, shape (n,)
        Sensors whose similarity to the 3 most similar sensors exceeds that after every shift.
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
    whole = _standardised(ranks)
    similarity = _symmetric(whole.T @ whole)
    halves = []
    for frames in split_blocks(n_frames):
        half = _standardised(ranks[frames])
        halves.append(_symmetric(half.T @ half))
    least = max(1, int(_MIN_SHIFT * n_frames))
    lags = rng.integers(least, n_frames - least, size=n_shifts, endpoint=True)
    shifted = np.stack([_shifted_product(whole, int(lag)) for lag in lags])
    strength = _strength(similarity)
    chance = np.stack([_strength(one) for one in shifted])
    tested = (strength > chance.max(axis=0)) & (strength > 0)
    return ReadingStatistics(similarity, np.stack(halves), shifted, tested)


def _standardised(ranks: NDArray[np.float64]) -> NDArray[np.float32]:
    """Centre columns and scale them to unit length; constant columns are 0."""
    centred = ranks - ranks.mean(axis=0)
    length = np.sqrt(np.einsum("tn,tn->n", centred, centred))
    scale = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0)
    return np.asarray(centred * scale, dtype=np.float32)


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
