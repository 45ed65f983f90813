"""Recordings as streams of blocks of frames.

A reader returns a `Stream`: the metadata of the recording, and an iterator of blocks. `assemble`
collects the blocks into a `Recording`; callers with little memory iterate over them.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, FileError
from anisomap.io.parsing.frames import increasing_times
from anisomap.io.parsing.libraries import DamagedError, error_reason
from anisomap.recording import Recording, Scalar

BLOCK_FRAMES = 8192
"""Default number of frames per block of `open_stream`."""

BLOCK_BYTES = 1 << 22
"""Size of the blocks in which readers hand on readings, of at least one frame: small for any
memory, and large enough that the work of a block does not count."""

_GROWTH = 0.25
_MIN_REPORTED_LOSS = 0.005


@dataclass(frozen=True)
class ReadOptions:
    """Information for a reader that the file lacks.

    Parameters
    ----------
    select : str
        Recording to read from a file that holds several: a dataset, column, port, or topic with
        field (``/skin:data``). Several ports or topics are separated by commas. Must be empty for
        formats that hold a single recording.
    grid : (int, int), optional
        Rows and columns of a rectangular array with sensors in row-major order; sets positions.
    definitions : tuple of pathlib.Path
        Message definitions (``.msg``) for a bag without them.
    preset : str
        A robot with a known numbering of sensors: see `anisomap.io.recordings.presets`.
    positions : pathlib.Path, optional
        File of true positions of the sensors, in any format of maps. Sensors match by name, or by
        the numbers at the ends of the names.
    bin_s : float, optional
        Width in seconds of the bins in which events are counted; for recordings of events only.
    """

    select: str = ""
    grid: tuple[int, int] | None = None
    definitions: tuple[Path, ...] = ()
    preset: str = ""
    positions: Path | None = None
    bin_s: float | None = None


@dataclass(frozen=True, eq=False)
class Block:
    """Consecutive frames of a recording.

    Parameters
    ----------
    readings : ndarray of shape (t, N)
        Of any real dtype.
    fraction : float
        Fraction of the file read so far, from 0 to 1.
    times : ndarray of shape (t,), optional
        In seconds, as stored in the file.
    receive_times : ndarray of shape (t,), optional
        In seconds of the receiver's clock; used if `times` do not increase.
    """

    readings: NDArray[Any]
    fraction: float
    times: NDArray[np.float64] | None = None
    receive_times: NDArray[np.float64] | None = None

    def part(self, start: int, stop: int | None = None) -> Block:
        """Return the frames from `start` up to, but not including, `stop`."""
        frames = slice(start, stop)
        return replace(
            self,
            readings=self.readings[frames],
            times=None if self.times is None else self.times[frames],
            receive_times=None if self.receive_times is None else self.receive_times[frames],
        )


@dataclass(frozen=True, eq=False)
class Stream:
    """A recording that is read block by block, with its metadata.

    Parameters
    ----------
    path : pathlib.Path
        The file, for messages.
    n_sensors : int
        Number of sensors, N, in every block.
    blocks : iterator of Block
        Can be iterated once.
    names, rate_hz, positions, normals, surface_distances, units, source, metadata
        As for `Recording`.
    from_zero : bool
        Whether to shift times so that the first frame is at 0.
    locate : callable, optional
        Maps a frame index to its place in the file, such as ``"line 12"``.
    silent_are_zero : bool
        Whether the file lists events, so that a sensor it does not mention was never active.
    """

    path: Path
    n_sensors: int
    blocks: Iterator[Block]
    names: tuple[str, ...] = ()
    rate_hz: float | None = None
    positions: NDArray[np.float64] | None = None
    normals: NDArray[np.float64] | None = None
    surface_distances: NDArray[np.float64] | None = None
    units: str = ""
    source: str = ""
    metadata: Mapping[str, Scalar] = field(default_factory=dict)
    from_zero: bool = False
    locate: Callable[[int], str] | None = None
    silent_are_zero: bool = False


def assemble(stream: Stream, progress: Callable[[float], None] | None = None) -> Recording:
    """Collect a stream into a recording, without copying the readings.

    Parameters
    ----------
    stream : Stream
    progress : callable, optional
        Called after each block with the fraction of the file read so far, from 0 to 1.

    Returns
    -------
    Recording
        Without times, and with a warning, if the times in the file do not increase.

    Raises
    ------
    FileError
        If the stream has no frame.
    """
    readings, times, receive_times = _GrowingArray(), _GrowingArray(), _GrowingArray()
    for block in stream.blocks:
        readings.append(block.readings)
        for array, clock in ((times, block.times), (receive_times, block.receive_times)):
            if clock is not None:
                array.append(clock, np.float64)
        if progress:
            progress(min(block.fraction, 1.0))
    if not readings.n_rows:
        raise FileError(f"{stream.path} holds no frame")
    return Recording(
        readings.array(),
        names=stream.names,
        times=_best_clock(stream, [p.array() for p in (times, receive_times) if p.n_rows]),
        rate_hz=stream.rate_hz,
        positions=stream.positions,
        normals=stream.normals,
        surface_distances=stream.surface_distances,
        units=stream.units,
        source=stream.source,
        metadata=stream.metadata,
    )


def rechunk(blocks: Iterator[Block], n_frames: int) -> Iterator[Block]:
    """Regroup blocks so that each but the last has `n_frames` frames."""
    held: list[Block] = []
    for block in blocks:
        held.append(block)
        if sum(len(part.readings) for part in held) < n_frames:
            continue
        joined = _joined(held)
        whole = len(joined.readings) // n_frames * n_frames
        for start in range(0, whole, n_frames):
            yield joined.part(start, start + n_frames)
        held = [joined.part(whole)] if whole < len(joined.readings) else []
    if held:
        yield _joined(held)


def salvage(
    blocks: Iterator[Block], path: Path, damage: tuple[type[Exception], ...] = (DamagedError,)
) -> Iterator[Block]:
    """Yield the blocks before the first damage, and warn about the lost rest.

    Parameters
    ----------
    blocks : iterator of Block
    path : pathlib.Path
        The file, for messages.
    damage : tuple of exception types
        Exceptions that indicate a damaged file. They are raised again if no frame precedes them.
    """
    n_frames, fraction = 0, 0.0
    try:
        for block in blocks:
            n_frames, fraction = n_frames + len(block.readings), block.fraction
            yield block
    except damage as error:
        if not n_frames:
            raise
        reason = error_reason(error.__cause__ or error)
        loss = 1 - fraction
        lost = f" (about {loss:.0%} of the file)" if loss > _MIN_REPORTED_LOSS else ""
        warnings.warn(
            f"{path} is damaged or cut short ({reason}): read the {n_frames} frames before the "
            f"damage, lost the rest{lost}",
            AnisomapWarning,
            stacklevel=2,
        )


class _GrowingArray:
    """An array that grows in place, so that appending never needs twice its memory."""

    def __init__(self) -> None:
        self._array: NDArray[Any] | None = None
        self.n_rows = 0

    def append(self, rows: NDArray[Any], dtype: type[np.floating] = np.float32) -> None:
        needed = self.n_rows + len(rows)
        wanted = np.float32 if _fits(rows.dtype, dtype) else np.float64
        if self._array is None:
            self._array = np.empty(rows.shape, wanted)
        elif self._array.dtype == np.float32 and wanted == np.float64:
            self._array = self._array.astype(np.float64)
        if needed > len(self._array):
            capacity = max(needed, int(len(self._array) * (1 + _GROWTH)))
            # realloc moves pages instead of copying; no other reference to the array exists yet.
            self._array.resize((capacity, *rows.shape[1:]), refcheck=False)
        self._array[self.n_rows : needed] = rows
        self.n_rows = needed

    def array(self) -> NDArray[Any]:
        if self._array is None:
            return np.empty(0)
        self._array.resize((self.n_rows, *self._array.shape[1:]), refcheck=False)
        self._array.setflags(write=False)
        return self._array


def _fits(held: np.dtype[Any], wanted: type[np.floating]) -> bool:
    return bool(np.can_cast(held, np.float32)) and wanted == np.float32


def _joined(blocks: list[Block]) -> Block:
    if len(blocks) == 1:
        return blocks[0]
    last = blocks[-1]
    return Block(
        np.concatenate([block.readings for block in blocks]),
        last.fraction,
        _concatenated([block.times for block in blocks]),
        _concatenated([block.receive_times for block in blocks]),
    )


def _concatenated(parts: list[NDArray[np.float64] | None]) -> NDArray[np.float64] | None:
    known = [part for part in parts if part is not None]
    return np.concatenate(known) if known else None


def _best_clock(stream: Stream, clocks: list[NDArray[np.float64]]) -> NDArray[np.float64] | None:
    """Return the first clock that increases strictly, or warn that none does."""
    if not clocks:
        return None
    for times in clocks:
        with np.errstate(invalid="ignore"):
            if np.isfinite(times).all() and (np.diff(times) > 0).all():
                return times - times[0] if stream.from_zero else times
    return increasing_times(clocks[0], stream.path, stream.locate)
