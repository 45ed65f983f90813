"""Chunks of frames: their size, missing values, an excerpt, and what is known after all of them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from mmap import mmap
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.health import SensorHealth, weaknesses
from anisomap.numerics.gaps import (
    CompleteChunks,
    check_chunks,
    drop_incomplete_frames,
    interpolate_gaps,
    require_no_gaps,
)
from anisomap.recording import MissingPolicy, Recording
from anisomap.sensor_map import SensorMap

# Chosen by hand.
CHUNK_READINGS = 1 << 23  # per chunk, unless that is fewer than `CHUNK_FRAMES`
CHUNK_FRAMES = 4096  # with fewer per chunk, merging results costs more than computing them
MAX_CHUNK_READINGS = 1 << 27  # per chunk, for any number of sensors; bounds the memory
EXCERPT_READINGS = 1 << 22  # from which sensor health is assessed
SEGMENT_FRAMES = 512  # consecutive frames in each segment of an excerpt

Chunks: TypeAlias = Callable[[], Iterable[ArrayLike]]
"""Returns an iterator over all frames, from the first, as arrays of shape (t, N)."""


def chunk_frames(n_sensors: int) -> int:
    """Return the number of frames per chunk for `n_sensors` sensors."""
    fewest = min(CHUNK_FRAMES, MAX_CHUNK_READINGS // n_sensors)
    return max(1, CHUNK_READINGS // n_sensors, fewest)


def split_array(readings: NDArray[Any]) -> Chunks:
    """Split an array of shape (T, N) into chunks, which are views or memory maps."""
    if readings.ndim != 2 or 0 in readings.shape:
        raise InputError(
            f"readings must be of shape (T, N) (frames x sensors) and not empty, got shape "
            f"{readings.shape}"
        )
    n_frames = chunk_frames(readings.shape[1])
    starts = range(0, len(readings), n_frames)
    if isinstance(readings, np.memmap) and isinstance(readings.base, mmap):
        return lambda: (_remapped(readings, start, n_frames) for start in starts)
    return lambda: (readings[start : start + n_frames] for start in starts)


def _remapped(whole: np.memmap[Any, Any], start: int, n_frames: int) -> NDArray[Any]:
    """Map some frames separately, since pages read through one large map stay in memory."""
    # Changes of a copy-on-write map are not in the file.
    if whole.mode == "c" or whole.filename is None or not whole.flags.c_contiguous:
        return whole[start : start + n_frames]
    shape = (min(n_frames, len(whole) - start), whole.shape[1])
    offset = whole.offset + start * whole.strides[0]
    return np.memmap(whole.filename, whole.dtype, "r", offset, shape)


def complete_chunks(chunks: Chunks, missing: MissingPolicy = "error") -> CompleteChunks:
    """Apply a policy on missing readings chunk by chunk, as `Recording.complete` does."""
    checked = partial(check_chunks, chunks)
    if missing == "interpolate":
        return interpolate_gaps(checked, CHUNK_READINGS)
    if missing == "drop-frames":
        return drop_incomplete_frames(checked)
    if missing != "error":
        raise InputError(
            f"missing must be 'error', 'drop-frames' or 'interpolate', got {missing!r}"
        )
    return require_no_gaps(checked)


class Excerpt:
    """Equally spaced segments of `segment` frames each, of about `n_readings` readings together."""

    def __init__(self, n_readings: int = 0, segment: int = 0) -> None:
        self._n_readings = n_readings or EXCERPT_READINGS
        self._segment = segment or SEGMENT_FRAMES
        self.reset()

    def reset(self) -> None:
        """Discard all frames."""
        self._parts: list[tuple[NDArray[np.intp], NDArray[Any]]] = []
        self._stride, self.n_frames = 1, 0

    def add(self, chunk: NDArray[Any]) -> None:
        """Add the next frames, shape (t, N); only some segments are stored."""
        numbers = np.arange(self.n_frames, self.n_frames + len(chunk)) // self._segment
        self.n_frames += len(chunk)
        self._parts += self._kept([(numbers, chunk)])
        # With very many sensors, a chunk is shorter than a segment.
        max_frames = max(2 * self._segment, self._n_readings // chunk.shape[1])
        while sum(len(frames) for _, frames in self._parts) > max_frames:
            self._stride *= 2
            self._parts = self._kept(self._parts)

    def _kept(
        self, parts: Iterable[tuple[NDArray[np.intp], NDArray[Any]]]
    ) -> list[tuple[NDArray[np.intp], NDArray[Any]]]:
        chosen = ((held % self._stride == 0, held, frames) for held, frames in parts)
        return [(held[kept], frames[kept]) for kept, held, frames in chosen if kept.any()]

    @property
    def readings(self) -> NDArray[Any]:
        """Readings of the excerpt, at least one frame."""
        return np.concatenate([frames for _, frames in self._parts])

    def recording(self, like: Recording | Sequence[str]) -> Recording:
        """Return the excerpt as a recording, with metadata of another or with sensor names."""
        if isinstance(like, Recording):
            return replace(like, readings=self.readings, times=None)
        return Recording(self.readings, names=tuple(like))


SAMPLE_FRAMES = 16384
"""Number of frames in a sample that follows a recording while it grows."""

_SAMPLE_READINGS, _MIN_SAMPLE = 1 << 23, 256  # of many sensors, fewer frames: 32 MiB


def sample_of(n_sensors: int) -> Excerpt:
    """Return an empty sample of frames that are evenly spread over a recording."""
    n_frames = max(_MIN_SAMPLE, min(SAMPLE_FRAMES, _SAMPLE_READINGS // n_sensors))
    return Excerpt(n_frames * n_sensors, segment=1)


@dataclass(frozen=True, eq=False)
class ReadInChunks:
    """What is known of a recording that was read in chunks.

    n_frames: Number of frames.
    varying: Mask of the sensors that vary, (N,).
    excerpt: Segments of frames from the whole recording; all frames if they are few.
    health: Assessed from the excerpt; numbers of contacts are those of all frames.
    """

    n_frames: int
    varying: NDArray[np.bool_]
    excerpt: Recording
    health: tuple[SensorHealth, ...]

    def complete(
        self, made: SensorMap, notes: Iterable[str], dropped: NDArray[np.bool_]
    ) -> SensorMap:
        """Add health, origin and notes to a map, and issue the notes as warnings."""
        kept = [sensor for sensor, out in zip(self.health, dropped, strict=True) if not out]
        told = [*weaknesses(self.excerpt, kept), *notes]
        if self.excerpt.n_frames < self.n_frames:
            share = f"{self.excerpt.n_frames} of {self.n_frames}"
            told.append(f"sensor health was assessed from {share} frames")
        for note in told:
            warnings.warn(note, AnisomapWarning, stacklevel=3)
        return replace(
            made,
            health=tuple(sensor.status for sensor in self.health),
            notes=(*told, *made.notes),
            provenance={
                "source": self.excerpt.source,
                "frames": self.n_frames,
                **made.provenance,
            },
        )
