"""Iteration over the readings of single sensors, their distinct values and their ranks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

_SAMPLE_FRAMES = 63  # frames from which the most frequent value is guessed
_MAX_TABLE = 4096  # whole numbers counted in a table: of 12 bits, far fewer than usual frames
_GREATEST_WHOLE = 2**23  # whole numbers up to it are exact in float32
_SENSORS_AT_ONCE = 64


def columns(readings: NDArray[Any], n_at_once: int = _SENSORS_AT_ONCE) -> Iterator[NDArray[Any]]:
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
    Equal to ``numpy.unique(column, return_counts=True)``, but faster: whole numbers in a small
    range are counted in a table, and otherwise only readings that differ from a frequent value
    are sorted.
    """
    whole = whole_numbers(column)
    if whole is not None:
        codes, lowest = whole
        table = np.bincount(codes)
        found = np.flatnonzero(table)
        return (found + lowest).astype(column.dtype), table[found].astype(np.int64)
    usual = _usual(column)
    unusual = column[column != usual]
    unusual.sort()
    begins, counts = _ties(unusual)
    values = unusual[begins]
    place = values.searchsorted(usual)
    return (
        np.concatenate([values[:place], [usual], values[place:]]),
        np.concatenate([counts[:place], [column.size - unusual.size], counts[place:]]),
    )


def mean_ranks(column: NDArray[Any]) -> NDArray[np.float64]:
    """Rank the readings of one sensor.

    Parameters
    ----------
    column : ndarray of shape (T,)
        Finite readings, T >= 1.

    Returns
    -------
    ndarray of shape (T,)
        Ranks from 1 to T; ties share their mean rank.

    Notes
    -----
    Equal to ``scipy.stats.rankdata(column)``, but faster, as `count_values`.
    """
    whole = whole_numbers(column)
    if whole is not None:
        table = np.bincount(whole[0])
        # Ranks of a value are those after all lower values; ties share the mean.
        return np.asarray((np.cumsum(table) - (table - 1) / 2)[whole[0]])
    usual = _usual(column)
    at = (column != usual).nonzero()[0]
    at = at[column[at].argsort()]
    unusual = column[at]
    begins, counts = _ties(unusual)
    n_usual, n_below = column.size - at.size, np.count_nonzero(unusual < usual)
    ranks = np.full(column.size, n_below + (n_usual + 1) / 2)
    ranks[at] = np.repeat(begins + (counts + 1) / 2, counts)
    ranks[at[n_below:]] += n_usual
    return ranks


def rank_columns(sensors: Iterable[NDArray[Any]], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Rank the readings of each sensor by `mean_ranks`.

    Parameters
    ----------
    sensors : iterable of ndarray of shape (T,)
        N sensors, as from `columns`.
    shape : tuple of int
        (T, N).

    Returns
    -------
    ndarray of shape (T, N)
    """
    return join_columns(map(mean_ranks, sensors), shape)


def join_columns(sensors: Iterator[NDArray[Any]], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Join columns of shape (T,) to an array of shape (T, N), several at a time, as `columns`."""
    joined = np.empty(shape)
    for begin in range(0, shape[1], _SENSORS_AT_ONCE):
        part = np.array(list(islice(sensors, _SENSORS_AT_ONCE)))
        joined[:, begin : begin + _SENSORS_AT_ONCE] = part.T
    return joined


def whole_numbers(column: NDArray[Any]) -> tuple[NDArray[np.intp], int] | None:
    """Return readings less the lowest as indices, and the lowest, if they are few whole numbers.

    Parameters
    ----------
    column : ndarray of shape (T,)
        Finite readings, T >= 1.

    Returns
    -------
    codes : ndarray of int, shape (T,)
    lowest : int
        Or None, if some reading is no whole number, or the range is 4,096 or more.
    """
    if column.dtype.kind == "f":
        sample = column[:: max(1, column.size // _SAMPLE_FRAMES)]
        if not np.array_equal(sample, np.rint(sample)):
            return None
    lowest, highest = column.min(), column.max()
    if not float(highest) - float(lowest) < _MAX_TABLE or abs(float(lowest)) > _GREATEST_WHOLE:
        return None
    if column.dtype.kind == "f":
        codes = (column - lowest).astype(np.intp)
        return (codes, int(lowest)) if np.array_equal(codes + lowest, column) else None
    return column.astype(np.intp) - int(lowest), int(lowest)


def _usual(column: NDArray[Any]) -> Any:
    """Estimate the most frequent reading by the median of some frames."""
    sample = column[:: max(1, column.size // _SAMPLE_FRAMES)].copy()
    sample.sort()
    return sample[sample.size // 2]


def _ties(ordered: NDArray[Any]) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Return where each distinct value of a sorted array begins, and how often it occurs."""
    new = np.ones(ordered.size + 1, dtype=bool)
    np.not_equal(ordered[1:], ordered[:-1], out=new[1:-1])
    bounds = new.nonzero()[0]
    return bounds[:-1], bounds[1:] - bounds[:-1]
