"""Iteration over the readings of single sensors, their distinct values and their ranks."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_SAMPLE_FRAMES = 63  # frames from which the most frequent value is guessed
_MAX_TABLE = 4096  # whole numbers counted in a table: of 12 bits, far fewer than usual frames
_GREATEST_WHOLE = 2**23  # whole numbers up to it are exact in float32
_SENSORS_AT_ONCE = 64


def columns(readings: NDArray[Any], n_at_once: int = _SENSORS_AT_ONCE) -> Iterator[NDArray[Any]]:
    """Iterate over the readings of each sensor. readings (T, N) -> (T,)."""
    for begin in range(0, readings.shape[1], n_at_once):
        yield from np.ascontiguousarray(readings[:, begin : begin + n_at_once].T)


@dataclass(frozen=True, eq=False)
class Levels:
    """Distinct readings of one sensor, and the frames at them.

    n_frames: T.
    values (m,): Distinct readings in increasing order.
    counts: Number of frames at each.
    usual: Index of a frequent reading.
    frames: Frames at all other readings, increasing.
    codes: Indices of the readings in those frames.
    """

    n_frames: int
    values: NDArray[Any]
    counts: NDArray[np.int64]
    usual: int
    frames: NDArray[np.intp]
    codes: NDArray[np.intp]

    def expand(self, of_levels: NDArray[Any], out: NDArray[Any] | None = None) -> NDArray[Any]:
        """Return the value of each frame's level, shape (T,), from those of the levels, (m,)."""
        expanded = np.empty(self.n_frames, of_levels.dtype) if out is None else out
        expanded.fill(of_levels[self.usual])
        expanded[self.frames] = of_levels[self.codes]
        return expanded


def find_levels(column: NDArray[Any]) -> Levels:
    """Find the distinct readings of one sensor.

    column (T,).

    Only readings that differ from a frequent one are examined; whole numbers in a small range are
    counted in a table, all others are sorted.
    """
    usual = _usual(column)
    frames = (column != usual).nonzero()[0]
    unusual = column[frames]
    whole = whole_numbers(unusual) if unusual.size else None
    if whole is None:
        order = unusual.argsort()
        values, counts = _ties(unusual[order])
        codes = np.empty(unusual.size, dtype=np.intp)
        codes[order] = np.repeat(np.arange(counts.size), counts)
    else:
        table, values, counts = _tabulated(whole, column.dtype)
        codes = (np.cumsum(table > 0) - 1)[whole[0]]
    place, values, counts = _with_usual(values, counts, usual, column.size)
    codes[codes >= place] += 1
    return Levels(column.size, values, counts, place, frames, codes)


def count_values(column: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Count the distinct values of one sensor.

    column (T,).

    Equal to ``numpy.unique(column, return_counts=True)``, but faster: see `find_levels`, which
    takes three times as long to sort.
    """
    usual = _usual(column)
    unusual = column[column != usual]
    whole = whole_numbers(unusual) if unusual.size else None
    if whole is None:
        values, counts = _ties(np.sort(unusual))
    else:
        _, values, counts = _tabulated(whole, column.dtype)
    return _with_usual(values, counts, usual, column.size)[1:]


def mean_ranks(column: NDArray[Any]) -> NDArray[np.float64]:
    """Rank the readings of one sensor.

    column (T,) -> (T,).

    Equal to ``scipy.stats.rankdata(column)``, but faster, as `count_values`.
    """
    levels = find_levels(column)
    return levels.expand(ranks_from_counts(levels.counts))


def ranks_from_counts(counts: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
    """Rank distinct values, shape (m,), in increasing order; ties share their mean rank."""
    return np.asarray(np.cumsum(counts) - (counts - 1) / 2)


def rank_columns(sensors: Iterable[NDArray[Any]], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Rank the readings of each sensor by `mean_ranks`. sensors (T,) -> (T, N)."""
    return join_columns(map(mean_ranks, sensors), shape)


def join_columns(sensors: Iterable[NDArray[Any]], shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Join columns of shape (T,) to an array of shape (T, N), contiguous by column."""
    joined = np.empty(shape[::-1])
    for row, column in zip(joined, sensors, strict=True):
        row[:] = column
    return joined.T


def whole_numbers(column: NDArray[Any]) -> tuple[NDArray[np.intp], int] | None:
    """Return readings less the lowest as indices, and the lowest, if they are few whole numbers.

    column (T,).
    """
    if column.dtype.kind == "f":
        sample = column[:: max(1, column.size // _SAMPLE_FRAMES)]
        if not np.array_equal(sample, np.rint(sample)):
            return None
    lowest, highest = column.min(), column.max()
    if not float(highest) - float(lowest) < _MAX_TABLE or abs(float(lowest)) > _GREATEST_WHOLE:
        return None
    if column.dtype.kind == "f":
        if not np.array_equal(column, np.rint(column)):
            return None
        return (column - lowest).astype(np.intp), int(lowest)
    return column.astype(np.intp) - int(lowest), int(lowest)


def _tabulated(
    whole: tuple[NDArray[np.intp], int], dtype: np.dtype[Any]
) -> tuple[NDArray[np.int64], NDArray[Any], NDArray[np.int64]]:
    """Count `whole_numbers` in a table; return it, the distinct readings and their counts."""
    codes, lowest = whole
    table = np.bincount(codes)
    present = table.nonzero()[0]
    return table, (present + lowest).astype(dtype), table[present]


def _with_usual(
    values: NDArray[Any], counts: NDArray[np.int64], usual: Any, n_frames: int
) -> tuple[int, NDArray[Any], NDArray[np.int64]]:
    """Insert the usual value, which has the remaining frames; return its place as well."""
    place = int(values.searchsorted(usual))
    # numpy.insert takes ten times as long.
    longer, more = np.empty(values.size + 1, values.dtype), np.empty(values.size + 1, np.int64)
    longer[:place], longer[place], longer[place + 1 :] = values[:place], usual, values[place:]
    rest = n_frames - int(counts.sum())
    more[:place], more[place], more[place + 1 :] = counts[:place], rest, counts[place:]
    return place, longer, more


def _usual(column: NDArray[Any]) -> Any:
    """Estimate the most frequent reading by the median of some frames."""
    sample = column[:: max(1, column.size // _SAMPLE_FRAMES)].copy()
    sample.sort()
    return sample[sample.size // 2]


def _ties(ordered: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64]]:
    """Return the distinct values of a sorted array, and how often each occurs."""
    new = np.ones(ordered.size + 1, dtype=bool)
    np.not_equal(ordered[1:], ordered[:-1], out=new[1:-1])
    bounds = new.nonzero()[0]
    return ordered[bounds[:-1]], bounds[1:] - bounds[:-1]
