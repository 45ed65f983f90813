"""Iteration over the readings of single sensors, and counts of their distinct values."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

_SAMPLE_FRAMES = 63  # frames from which the most frequent value is guessed


def columns(readings: NDArray[Any], n_at_once: int = 64) -> Iterator[NDArray[Any]]:
    """Iterate over the readings of each sensor.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
    n_at_once : int
        Number of sensors copied at a time. Copying single columns would load every row of
        `readings` from memory for one number.

    Yields
    ------
    ndarray of shape (T,)
        Contiguous.
    """
    for begin in range(0, readings.shape[1], n_at_once):
        yield from np.ascontiguousarray(readings[:, begin : begin + n_at_once].T)


def count_values(column: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Count the distinct values of one sensor.

    Parameters
    ----------
    column : ndarray of shape (T,)
        Finite readings, T >= 1.

    Returns
    -------
    values : ndarray
        Distinct values in increasing order.
    counts : ndarray of int64

    Notes
    -----
    Equal to ``numpy.unique(column, return_counts=True)``, but faster: bytes are counted in a table,
    and otherwise only readings that differ from a frequent value are sorted.
    """
    if column.dtype.kind in "biu" and column.dtype.itemsize == 1:
        lowest = int(column.min())
        table = np.bincount(column.astype(np.intp) - lowest)
        found = np.flatnonzero(table)
        return (found + lowest).astype(column.dtype), table[found].astype(np.int64)
    sample = np.sort(column[:: max(1, column.size // _SAMPLE_FRAMES)])
    usual = sample[sample.size // 2]
    unusual = column[column != usual]
    values, counts = np.unique(unusual, return_counts=True)
    place = np.searchsorted(values, usual)
    return (
        np.insert(values, place, usual),
        np.insert(counts.astype(np.int64), place, column.size - unusual.size),
    )
