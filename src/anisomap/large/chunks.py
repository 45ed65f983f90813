"""Frames by the chunk: how many at a time, without gaps, and an excerpt of them all."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from mmap import mmap
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.gaps import (
    CompleteChunks,
    check_chunks,
    drop_incomplete_frames,
    interpolate_gaps,
    require_no_gaps,
)
from anisomap.recording import MissingPolicy, Recording

CHUNK_READINGS = 1 << 23
"""Readings that are taken at a time,"""

CHUNK_FRAMES = 4096
"""or so many frames of many sensors: merging what was counted takes longer then than counting,"""

MAX_CHUNK_READINGS = 1 << 27
"""but never more readings than this."""

EXCERPT_READINGS = 1 << 22
"""Readings that sensor health is judged from, in pieces from all over the recording."""

PIECE_FRAMES = 512
"""Consecutive frames of a piece."""

Chunks: TypeAlias = Callable[[], Iterable[ArrayLike]]
"""Opens the readings from the first frame on, each time that it is called: arrays (t, N)."""


def chunk_frames(n_sensors: int) -> int:
    """Tell how many frames of so many sensors are taken at a time."""
    few = min(CHUNK_FRAMES, MAX_CHUNK_READINGS // n_sensors)
    return max(1, CHUNK_READINGS // n_sensors, few)


def split_array(readings: NDArray[Any]) -> Chunks:
    """Give an array of shape (T, N) in chunks; one that is mapped from a file, without keeping it.

    Raises
    ------
    InputError
        If it holds no frames or no sensors, or is of another shape.
    """
    if readings.ndim != 2 or 0 in readings.shape:
        raise InputError(
            f"readings have shape {readings.shape}; they must be frames x sensors, shape (T, N)"
        )
    n_frames = chunk_frames(readings.shape[1])
    starts = range(0, len(readings), n_frames)
    if isinstance(readings, np.memmap) and isinstance(readings.base, mmap):
        return lambda: (_remapped(readings, start, n_frames) for start in starts)
    return lambda: (readings[start : start + n_frames] for start in starts)


def _remapped(whole: np.memmap[Any, Any], start: int, n_frames: int) -> NDArray[Any]:
    """Map some frames by themselves: what one large map has touched stays in memory.

    What was changed in memory alone, as "copy on write" allows, is not in the file.
    """
    if whole.mode == "c" or whole.filename is None or not whole.flags.c_contiguous:
        return whole[start : start + n_frames]
    shape = (min(n_frames, len(whole) - start), whole.shape[1])
    offset = whole.offset + start * whole.strides[0]
    return np.memmap(whole.filename, whole.dtype, "r", offset, shape)


def complete_chunks(chunks: Chunks, missing: MissingPolicy = "error") -> CompleteChunks:
    """Settle what to do about readings that are NaN or infinite, as `Recording.complete` does.

    Parameters
    ----------
    chunks : callable
        Opens the readings of one recording.
    missing : {"error", "drop-frames", "interpolate"}
        Gaps of any length are filled, in memory for two chunks. Only where a gap is longer than a
        chunk, or a sensor has no reading at all, frames are gone through once more to find where
        it ends.

    Returns
    -------
    callable
        Opens the readings without gaps, in chunks that may be cut otherwise.

    Raises
    ------
    InputError
        If there is no such policy; once opened, under "error" if a reading is missing, under
        "drop-frames" if no frame is left, and if chunks are not all of the same sensors.
    """
    checked = partial(check_chunks, chunks)
    if missing == "interpolate":
        return interpolate_gaps(checked, CHUNK_READINGS)
    if missing == "drop-frames":
        return drop_incomplete_frames(checked)
    if missing != "error":
        raise InputError(f"unknown policy {missing!r}: use error, drop-frames or interpolate")
    return require_no_gaps(checked)


class Excerpt:
    """Every so many-th piece of consecutive frames, however many come.

    Parameters
    ----------
    n_readings : int
        About how many readings to keep: `EXCERPT_READINGS` unless given.
    """

    def __init__(self, n_readings: int = 0) -> None:
        self._n_readings = n_readings or EXCERPT_READINGS
        self.complete = False
        self.reset()

    def reset(self) -> None:
        """Begin anew, with the first chunk."""
        self._kept: list[NDArray[Any]] = []
        self._stride, self._seen = 1, 0

    def add(self, chunk: NDArray[Any]) -> None:
        """Take some pieces of the next frames, shape (t, N)."""
        # A chunk of very many sensors is shorter than a piece.
        most = max(2 * PIECE_FRAMES, self._n_readings // chunk.shape[1])
        for start in range(0, len(chunk), PIECE_FRAMES):
            if self._seen % self._stride == 0:
                self._kept.append(np.array(chunk[start : start + PIECE_FRAMES]))
            self._seen += 1
            if sum(map(len, self._kept)) > most:
                self._kept = self._kept[::2]
                self._stride *= 2

    def recording(self, like: Recording | Sequence[str]) -> Recording:
        """Give what was kept as a recording like another, or of sensors with these names."""
        readings = np.concatenate(self._kept)
        if isinstance(like, Recording):
            return replace(like, readings=readings, times=None)
        return Recording(readings, names=tuple(like))
