"""Missing readings (NaN, infinite): filled or left out, in chunks of frames as in one array."""

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
"""Opens chunks of frames of the same sensors, from the first on, each time that it is called."""

CompleteChunks: TypeAlias = Callable[[], Iterator[Readings]]
"""The same, of chunks in which no reading is missing."""


@dataclass(frozen=True, eq=False)
class Neighbours:
    """The next known reading of each of N sensors on one side of some frames.

    Attributes
    ----------
    frame : ndarray of shape (N,)
        In which frame it is; NaN where there is none.
    value : ndarray of shape (N,)
        What it is.
    """

    frame: NDArray[np.float64]
    value: NDArray[np.float64]

    @classmethod
    def none(cls, n_sensors: int) -> Neighbours:
        """Give those of frames that nothing comes before, or after."""
        return cls(np.full(n_sensors, np.nan), np.full(n_sensors, np.nan))


def fill_gaps(
    readings: Readings,
    start: int = 0,
    before: Neighbours | None = None,
    after: Neighbours | None = None,
) -> Readings:
    """Fill gaps linearly between each sensor's neighbours in time.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
        Missing readings are NaN or infinite.
    start : int
        The number of the first of these frames.
    before, after : Neighbours, optional
        Of all of these frames.

    Returns
    -------
    ndarray of shape (T, N)
        Before the first known reading, that one, and after the last, that one; zeros where a
        sensor has none at all. The readings themselves if none is missing.
    """
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
        of = np.concatenate([first.value[one], readings[~missing, sensor], last.value[one]])
        known = ~np.isnan(at)
        result[missing, sensor] = (
            np.interp(frames[missing], at[known], of[known]) if known.any() else 0.0
        )
    return result


def interpolate_gaps(chunks: Chunks, window: int) -> CompleteChunks:
    """Fill gaps in a recording that comes in chunks, as `filled` does in all frames at once.

    Parameters
    ----------
    chunks : callable
        Opens the chunks.
    window : int
        How many readings are looked ahead for the ends of gaps; more memory than twice as many
        take (or than two chunks, if these are larger) is never needed. Chunks are gone through
        once more if a gap is longer.

    Returns
    -------
    callable
        Opens chunks without gaps.
    """
    far = cache(lambda: _far_ends(chunks(), window))

    def opened() -> Iterator[Readings]:
        windows = _joined(chunks(), window)
        here, start = next(windows, None), 0
        before = None if here is None else Neighbours.none(here.shape[1])
        while here is not None and before is not None:
            ahead, stop = next(windows, None), start + len(here)
            yield fill_gaps(here, start, before, _after(here, ahead, stop, far))
            before = _last_known(here, start, before)
            here, start = ahead, stop

    return opened


def drop_incomplete_frames(chunks: Chunks) -> CompleteChunks:
    """Leave out every frame that misses a reading of a sensor that has any.

    Parameters
    ----------
    chunks : callable
        Opens the chunks.

    Returns
    -------
    callable
        Opens chunks without gaps. A sensor with no finite reading in any frame is zero in all.
        They raise `InputError` if no frame is left.
    """
    silent = cache(lambda: _silent(chunks()))

    def opened() -> Iterator[Readings]:
        lost = kept = 0
        for chunk in chunks():
            gaps = _missing(chunk)
            if not gaps.any():
                kept += len(chunk)
                yield chunk
                continue
            whole = ~gaps[:, ~silent()].any(axis=1)
            kept, lost = kept + int(whole.sum()), lost + int((~whole).sum())
            if whole.any():
                yield np.where(gaps, 0, chunk)[whole]
        if lost and not kept:
            raise InputError(
                "every frame misses a reading, so dropping such frames leaves none; "
                "interpolate instead (--nan interpolate), or drop the sensors that are to blame"
            )

    return opened


def require_no_gaps(chunks: Chunks) -> CompleteChunks:
    """Give chunks on, and raise `InputError` at the first reading that is missing."""

    def opened() -> Iterator[Readings]:
        done = 0
        for chunk in chunks():
            gaps = _missing(chunk)
            if gaps.any():
                frame, sensor = np.argwhere(gaps)[0]
                raise InputError(
                    f"readings are NaN or infinite, the first of sensor {sensor} in frame "
                    f"{done + frame}; choose what to do about them: drop-frames or interpolate "
                    "(--nan)"
                )
            done += len(chunk)
            yield chunk

    return opened


def check_chunks(chunks: Callable[[], Iterable[ArrayLike]]) -> Iterator[Readings]:
    """Give chunks on as arrays, empty ones left out; `InputError` if they do not fit together."""
    n_sensors, done = None, 0
    for chunk in chunks():
        array = np.asarray(chunk)
        if array.dtype.kind == "f" and array.dtype.itemsize > np.dtype(np.float64).itemsize:
            array = array.astype(np.float64)
        if array.dtype.kind not in "biuf" or array.ndim != 2:
            raise InputError(
                f"a chunk of readings is of type {array.dtype} and shape {array.shape}; it must "
                "be of real numbers, frames x sensors"
            )
        if array.shape[1] != (n_sensors or array.shape[1]) or not array.shape[1]:
            raise InputError(
                f"from frame {done} on there are {array.shape[1]} sensors, but {n_sensors} before"
            )
        n_sensors, done = array.shape[1], done + len(array)
        if len(array):
            yield array


def _missing(readings: Readings) -> NDArray[np.bool_]:
    if readings.dtype.kind != "f":
        return np.zeros((1, readings.shape[1]), dtype=bool)
    return np.asarray(~np.isfinite(readings))


def _joined(chunks: Iterable[Readings], window: int) -> Iterator[Readings]:
    """Put chunks together until they have so many readings."""
    held: list[Readings] = []
    size = 0
    for chunk in chunks:
        held.append(chunk)
        size += chunk.size
        if size >= window:
            yield held[0] if len(held) == 1 else np.concatenate(held)
            held, size = [], 0
    if held:
        yield np.concatenate(held)


def _last_known(readings: Readings, start: int, before: Neighbours) -> Neighbours:
    backwards = _first_known(readings[::-1])
    seen = backwards >= 0
    row = len(readings) - 1 - backwards
    return Neighbours(
        np.where(seen, start + row, before.frame),
        np.where(seen, _picked(readings, row), before.value),
    )


def _first_known(readings: Readings) -> NDArray[np.intp]:
    """Tell in which row each sensor has a known reading for the first time; -1 if in none."""
    if readings.dtype.kind != "f" or np.isfinite(readings[0]).all():
        return np.zeros(readings.shape[1], dtype=np.intp)
    known = np.isfinite(readings)
    return np.where(known.any(axis=0), known.argmax(axis=0), -1)


def _picked(readings: Readings, rows: NDArray[np.intp]) -> NDArray[np.float64]:
    inside = np.minimum(rows, len(readings) - 1)
    return readings[inside, np.arange(readings.shape[1])].astype(np.float64)


_FarEnds: TypeAlias = list[list[tuple[int, float]]]


def _after(
    here: Readings, ahead: Readings | None, stop: int, far: Callable[[], _FarEnds]
) -> Neighbours:
    """Find the next known reading after a window: in the one that follows, or far away."""
    after = Neighbours.none(here.shape[1])
    if ahead is None:
        return after
    row = _first_known(ahead)
    seen = row >= 0
    after.frame[seen] = stop + row[seen]
    after.value[seen] = _picked(ahead, row)[seen]
    for sensor in np.flatnonzero(~seen & _missing(here[-1:])[0]):
        ends = far()[sensor]
        place = bisect_right(ends, (stop, np.inf))
        if place < len(ends):
            after.frame[sensor], after.value[sensor] = ends[place]
    return after


def _far_ends(chunks: Iterable[Readings], window: int) -> _FarEnds:
    """List for each sensor the known readings that come after gaps longer than a window."""
    ends: _FarEnds = []
    last, start = np.empty(0), 0
    for chunk in chunks:
        if not ends:
            ends = [[] for _ in range(chunk.shape[1])]
            last = np.full(chunk.shape[1], -1.0)
        row = _first_known(chunk)
        far = (row >= 0) & ((start + row - last) * chunk.shape[1] >= window)
        for sensor in np.flatnonzero(far):
            ends[sensor].append((start + int(row[sensor]), float(chunk[row[sensor], sensor])))
        last = _last_known(chunk, start, Neighbours(last, last)).frame
        start += len(chunk)
    return ends


def _silent(chunks: Iterable[Readings]) -> NDArray[np.bool_]:
    """Tell which sensors have no finite reading; only as many frames are read as that takes."""
    silent = np.array(True)
    for chunk in chunks:
        silent = silent & _missing(chunk).all(axis=0)
        if not silent.any():
            break
    return silent
