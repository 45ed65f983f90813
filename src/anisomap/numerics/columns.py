"""What each sensor read, sensor by sensor, of readings that are kept frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

TOGETHER = 64
"""Sensors that are taken out of all frames together: one at a time, each frame would be fetched
from memory for the sake of one number."""

_SAMPLED = 63


def columns(readings: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Give the readings of each sensor, shape (T,), of an array of shape (T, N)."""
    for begin in range(0, readings.shape[1], TOGETHER):
        yield from np.ascontiguousarray(readings[:, begin : begin + TOGETHER].T)


def count_values(column: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Give the distinct values of finite readings, in increasing order, and how often they occur.

    Parameters
    ----------
    column : ndarray of shape (T,)
        T >= 1.

    Returns
    -------
    values : ndarray
    counts : ndarray of int64

    Notes
    -----
    As ``numpy.unique`` would; but a sensor mostly reads one value, and the others are quickly
    sorted.
    """
    sample = np.sort(column[:: max(1, column.size // _SAMPLED)])
    usual = sample[sample.size // 2]
    unusual = column[column != usual]
    values, counts = np.unique(unusual, return_counts=True)
    place = np.searchsorted(values, usual)
    return (
        np.insert(values, place, usual),
        np.insert(counts.astype(np.int64), place, column.size - unusual.size),
    )
