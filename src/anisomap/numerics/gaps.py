"""Missing readings (NaN or infinite) in chunks of frames.

A chunked recording is a callable that returns an iterable over its chunks, from the first frame.
Results do not depend on the division of frames into chunks.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError

Readings: TypeAlias = NDArray[Any]

Chunks: TypeAlias = Callable[[], Iterable[Readings]]
"""Returns an iterable over all chunks, arrays of shape (t, N), from the first frame."""

CompleteChunks: TypeAlias = Callable[[], Iterator[Readings]]
"""Returns an iterator over chunks without missing readings."""


@dataclass(frozen=True, eq=False)
class Neighbours:
    """Frame and value of the nearest known reading of each of N sensors; NaN if there is none."""

    frame: NDArray[np.float64]
    value: NDArray[np.float64]

    @classmethod
    def none(cls, n_sensors: int) -> Neighbours:
        """Return neighbours without readings, as at the start and the end of a recording."""
        return cls(np.full(n_sensors, np.nan), np.full(n_sensors, np.nan))


def fill_gaps(
    readings: Readings,
    start: int = 0,
    before: Neighbours | None = None,
    after: Neighbours | None = None,
) -> Readings:
    """Interpolate missing readings of each sensor linearly in time. readings (T, N) -> (T, N)."""
    gaps = _missing(readings)
    if not gaps.any():
        return readings
    result = np.array(readings, dtype=np.result_type(readings.dtype, np.float32))
    frames = np.arange(start, start + len(readings), dtype=np.float64)
    none = Neighbours.none(readings.shape[1])
    first, last = before or none, after or none
    for sensor in np.flatnonzero(gaps.any(axis=0)):
        missing = gaps[:, sensor]
        one = slice(sensor, sensor + 1)
        at = np.concatenate([first.frame[one], frames[~missing], last.frame[one]])
        values = np.concatenate([first.value[one], readings[~missing, sensor], last.value[one]])
        known = ~np.isnan(at)
        result[missing, sensor] = (
            np.interp(frames[missing], at[known], values[known]) if known.any() else 0.0
        )
    return result


def interpolate_gaps(chunks: Chunks, window: int) -> CompleteChunks:
    """Interpolate missing readings of a chunked recording, as `fill_gaps` does for an array."""
    distant_ends = cache(lambda: _find_distant_ends(chunks(), window))

    def complete() -> Iterator[Readings]:
        windows = _rechunk(chunks(), window)
        current, start = next(windows, None), 0
        before = None if current is None else Neighbours.none(current.shape[1])
        while current is not None and before is not None:
            following, stop = next(windows, None), start + len(current)
            yield fill_gaps(current, start, before, _after(current, following, stop, distant_ends))
            before = _last_known(current, start, before)
            current, start = following, stop

    return complete


def drop_incomplete_frames(chunks: Chunks) -> CompleteChunks:
    """Drop frames with missing readings; sensors without any finite reading become 0."""
    silent = cache(lambda: _silent_sensors(chunks()))

    def complete() -> Iterator[Readings]:
        n_dropped = n_kept = 0
        for chunk in chunks():
            gaps = _missing(chunk)
            if not gaps.any():
                n_kept += len(chunk)
                yield chunk
                continue
            kept = ~gaps[:, ~silent()].any(axis=1)
            n_kept, n_dropped = n_kept + int(kept.sum()), n_dropped + int((~kept).sum())
            if kept.any():
                yield np.where(gaps, 0, chunk)[kept]
        if n_dropped and not n_kept:
            raise InputError(
                "every frame has a missing reading, so dropping incomplete frames leaves none; "
                "interpolate instead, or drop the sensors with missing readings"
            )

    return complete


def require_no_gaps(chunks: Chunks) -> CompleteChunks:
    """Raise `InputError` at the first missing reading."""

    def complete() -> Iterator[Readings]:
        start = 0
        for chunk in chunks():
            gaps = _missing(chunk)
            if gaps.any():
                frame, sensor = np.argwhere(gaps)[0]
                raise InputError(
                    f"the reading of sensor {sensor} in frame {start + frame} is NaN or infinite; "
                    "drop frames with missing readings, or interpolate them"
                )
            start += len(chunk)
            yield chunk

    return complete


def check_chunks(chunks: Callable[[], Iterable[ArrayLike]]) -> Iterator[Readings]:
    """Convert chunks to arrays, (t, N), skip empty ones, and check that they fit together."""
    n_sensors, start = None, 0
    for chunk in chunks():
        array = np.asarray(chunk)
        if array.dtype.kind == "f" and array.dtype.itemsize > np.dtype(np.float64).itemsize:
            array = array.astype(np.float64)
        if array.dtype.kind not in "biuf" or array.ndim != 2:
            raise InputError(
                f"a chunk of readings has type {array.dtype} and shape {array.shape}; expected "
                "real numbers, (frames, sensors)"
            )
        if array.shape[1] != (n_sensors or array.shape[1]) or not array.shape[1]:
            raise InputError(
                f"from frame {start} on there are {array.shape[1]} sensors, but {n_sensors} before"
            )
        n_sensors, start = array.shape[1], start + len(array)
        if len(array):
            yield array


def _missing(readings: Readings) -> NDArray[np.bool_]:
    if readings.dtype.kind != "f":
        return np.zeros((1, readings.shape[1]), dtype=bool)
    return np.asarray(~np.isfinite(readings))


def _rechunk(chunks: Iterable[Readings], window: int) -> Iterator[Readings]:
    """Concatenate consecutive chunks to at least `window` readings each."""
    pending: list[Readings] = []
    size = 0
    for chunk in chunks:
        pending.append(chunk)
        size += chunk.size
        if size >= window:
            yield pending[0] if len(pending) == 1 else np.concatenate(pending)
            pending, size = [], 0
    if pending:
        yield np.concatenate(pending)


def _last_known(readings: Readings, start: int, before: Neighbours) -> Neighbours:
    row_from_end = _first_known(readings[::-1])
    found = row_from_end >= 0
    row = len(readings) - 1 - row_from_end
    return Neighbours(
        np.where(found, start + row, before.frame),
        np.where(found, _pick(readings, row), before.value),
    )


def _first_known(readings: Readings) -> NDArray[np.intp]:
    """Return the first row with a known reading of each sensor; -1 if there is none."""
    if readings.dtype.kind != "f" or np.isfinite(readings[0]).all():
        return np.zeros(readings.shape[1], dtype=np.intp)
    known = np.isfinite(readings)
    return np.where(known.any(axis=0), known.argmax(axis=0), -1)


def _pick(readings: Readings, rows: NDArray[np.intp]) -> NDArray[np.float64]:
    """Take the reading of each sensor in its own row."""
    inside = np.minimum(rows, len(readings) - 1)
    return readings[inside, np.arange(readings.shape[1])].astype(np.float64)


_DistantEnds: TypeAlias = list[list[tuple[int, float]]]


def _after(
    current: Readings,
    following: Readings | None,
    stop: int,
    distant_ends: Callable[[], _DistantEnds],
) -> Neighbours:
    """Find the first known readings after a window, in the following window or beyond it."""
    after = Neighbours.none(current.shape[1])
    if following is None:
        return after
    row = _first_known(following)
    found = row >= 0
    after.frame[found] = stop + row[found]
    after.value[found] = _pick(following, row)[found]
    for sensor in np.flatnonzero(~found & _missing(current[-1:])[0]):
        ends = distant_ends()[sensor]
        place = bisect_right(ends, (stop, np.inf))
        if place < len(ends):
            after.frame[sensor], after.value[sensor] = ends[place]
    return after


def _find_distant_ends(chunks: Iterable[Readings], window: int) -> _DistantEnds:
    """List, for each sensor, the frame and value of known readings after gaps over a window."""
    ends: _DistantEnds = []
    last, start = np.empty(0), 0
    for chunk in chunks:
        if not ends:
            ends = [[] for _ in range(chunk.shape[1])]
            last = np.full(chunk.shape[1], -1.0)
        row = _first_known(chunk)
        distant = (row >= 0) & ((start + row - last) * chunk.shape[1] >= window)
        for sensor in np.flatnonzero(distant):
            ends[sensor].append((start + int(row[sensor]), float(chunk[row[sensor], sensor])))
        last = _last_known(chunk, start, Neighbours(last, last)).frame
        start += len(chunk)
    return ends


def _silent_sensors(chunks: Iterable[Readings]) -> NDArray[np.bool_]:
    """Find sensors without finite readings; stop reading when every sensor has one."""
    silent = np.array(True)
    for chunk in chunks:
        silent = silent & _missing(chunk).all(axis=0)
        if not silent.any():
            break
    return silent
