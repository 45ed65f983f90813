"""Contiguous readings per sensor, and counts of their distinct values."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

_SAMPLE_FRAMES = 63


def columns(readings: NDArray[Any], n_at_once: int = 64) -> Iterator[NDArray[Any]]:
    """Iterate over the readings of each sensor.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
    n_at_once : int
        Sensors copied together. Copying one column at a time would load every row of `readings`
        from memory for a single number.

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
    and since most readings of a tactile sensor are one value, only the others are sorted.
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
