"""Operations on the readings of each sensor: iterate, transpose, rank, centre and fill gaps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_SENSORS_AT_ONCE = 64
_FRAMES_AT_ONCE = 256  # frames transposed at a time; two such blocks stay in the cache
_CENTRED_AT_ONCE = 32  # sensors whose intermediate arrays stay in the cache


def columns(readings: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """Iterate over the readings of each sensor. readings (T, N) -> (T,)."""
    for begin in range(0, readings.shape[1], _SENSORS_AT_ONCE):
        yield from transposed(readings[:, begin : begin + _SENSORS_AT_ONCE])


def transposed(readings: NDArray[Any], buffer: NDArray[Any] | None = None) -> NDArray[Any]:
    """Transpose readings, contiguous by sensor. readings (T, N) -> (N, T).

    buffer (n, T): Output for n >= N sensors, since allocation takes longer than transposition.
    """
    if readings.flags.f_contiguous:
        return readings.T
    n_frames, n_sensors = readings.shape
    rows = np.empty((n_sensors, n_frames), readings.dtype) if buffer is None else buffer[:n_sensors]
    for begin in range(0, n_frames, _FRAMES_AT_ONCE):
        part = slice(begin, begin + _FRAMES_AT_ONCE)
        rows[:, part] = readings[part].T
    return rows


def ranks_from_counts(counts: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
    """Rank distinct values, shape (m,), in increasing order; ties share their mean rank."""
    return np.asarray(np.cumsum(counts) - (counts - 1) / 2)


def mean_ranks(column: NDArray[Any]) -> NDArray[np.float64]:
    """Rank the readings of one sensor, (T,), three times as fast as `scipy.stats.rankdata`."""
    order = column.argsort()
    ordered = column[order]
    ends = np.append(np.flatnonzero(ordered[1:] != ordered[:-1]), column.size - 1)
    ranks = np.empty(column.size)
    if ends.size == column.size:
        ranks[order] = np.arange(1.0, column.size + 1)
    elif column.size:
        counts = np.diff(ends, prepend=-1)
        ranks[order] = np.repeat(ranks_from_counts(counts), counts)
    return ranks


def ranked(readings: ArrayLike) -> NDArray[np.float64]:
    """Rank the readings of each sensor, (T, N), contiguous by column; ties take the mean rank."""
    values = np.asarray(readings)
    ranks = np.empty(values.shape[::-1])
    for row, column in zip(ranks, columns(values), strict=True):
        row[:] = mean_ranks(column)
    return ranks.T


def centred_rows(readings: NDArray[Any]) -> NDArray[np.float32]:
    """Centre the readings of each sensor, and scale them to [-1, 1]; 0 if constant.

    readings (T, N) -> (N, T).
    """
    rows = np.empty(readings.shape[::-1], np.float32)
    buffer = np.empty((_CENTRED_AT_ONCE, len(readings)), readings.dtype)
    for begin in range(0, len(rows), _CENTRED_AT_ONCE):
        part = transposed(readings[:, begin : begin + _CENTRED_AT_ONCE], buffer)
        # The relative rounding error of a difference of float32 numbers is small.
        part = part if part.dtype == np.float32 else part.astype(np.float64)
        part = part - part[:, :1]  # exactly 0 for constant sensors
        part -= part.mean(axis=1)[:, None]
        # Squares of small readings, such as in a standard deviation, might underflow.
        greatest = np.abs(part).max(axis=1)
        part /= np.where(greatest > 0, greatest, 1)[:, None]
        rows[begin : begin + _CENTRED_AT_ONCE] = part
    return rows


def fill_gaps(readings: NDArray[Any]) -> NDArray[Any]:
    """Interpolate missing readings of each sensor linearly in time. readings (T, N) -> (T, N).

    Gaps before the first or after the last known reading take the value of this reading. All
    readings of a sensor without known readings become 0.
    """
    if readings.dtype.kind != "f":
        return readings
    gaps = ~np.isfinite(readings)
    if not gaps.any():
        return readings
    result = np.array(readings, dtype=np.result_type(readings.dtype, np.float32))
    for sensor in np.flatnonzero(gaps.any(axis=0)):
        missing = gaps[:, sensor]
        known = np.flatnonzero(~missing)
        result[missing, sensor] = (
            np.interp(np.flatnonzero(missing), known, readings[known, sensor])
            if known.size
            else 0.0
        )
    return result
