"""Recordings as they come: blocks of frames, and how a recording is made of them.

A reader never holds a file: it says what the sensors are called, and then yields blocks. What is
made of the blocks is no matter of the reader: `assemble` collects them, a caller with little
memory takes them one by one.
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
from anisomap.io.parsing.foreign import DamagedError, reason_of
from anisomap.io.parsing.frames import increasing
from anisomap.recording import Recording, Scalar

BLOCK_FRAMES = 8192
"""Frames in a block for those who ask for blocks, unless they say otherwise."""

_GROWTH = 0.25
_WORTH_TELLING = 0.005


@dataclass(frozen=True)
class ReadOptions:
    """What a reader cannot find out by itself.

    Parameters
    ----------
    select : str
        Which of several recordings in the file: a dataset, a column, a port, or a topic with its
        field (``/skin:data``). Ports and topics may be several, between commas.
    grid : (int, int), optional
        Rows and columns of a rectangular array, sensors in row-major order: gives true positions.
    definitions : tuple of pathlib.Path
        Message definitions (``.msg``) of a bag that holds none.
    preset : str
        A robot whose numbering of sensors is known: see `anisomap.io.recordings.presets`.
    """

    select: str = ""
    grid: tuple[int, int] | None = None
    definitions: tuple[Path, ...] = ()
    preset: str = ""


@dataclass(frozen=True, eq=False)
class Block:
    """Some consecutive frames.

    Parameters
    ----------
    readings : ndarray of shape (t, N)
        Of real numbers, of any type.
    share : float
        How much of the file has been read when the block is there, from 0 to 1.
    times : ndarray of shape (t,), optional
        Seconds, as the file has them.
    receipts : ndarray of shape (t,), optional
        Seconds of another clock, which steps in if `times` do not increase.
    """

    readings: NDArray[Any]
    share: float
    times: NDArray[np.float64] | None = None
    receipts: NDArray[np.float64] | None = None

    def part(self, start: int, stop: int | None = None) -> Block:
        """Keep some of the frames."""
        frames = slice(start, stop)
        return replace(
            self,
            readings=self.readings[frames],
            times=None if self.times is None else self.times[frames],
            receipts=None if self.receipts is None else self.receipts[frames],
        )


@dataclass(frozen=True, eq=False)
class Stream:
    """A recording that is read block by block, and what is known of it before.

    Parameters
    ----------
    path : pathlib.Path
        The file, for messages.
    n_sensors : int
        N, of every block.
    blocks : iterator of Block
        Can be gone through once.
    names, rate_hz, positions, normals, surface_distances, units, source, metadata
        As for `Recording`.
    from_zero : bool
        Whether times count from the first frame on, whatever the file has.
    locate : callable, optional
        Says where in the file a frame stands, such as ``"line 12"``.
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


def assemble(stream: Stream, progress: Callable[[float], None] | None = None) -> Recording:
    """Make a recording of a stream; takes hardly more memory than the recording.

    Parameters
    ----------
    stream : Stream
    progress : callable, optional
        Called now and then with the share of the file that has been read, from 0 to 1.

    Returns
    -------
    Recording
        Without times, and with a warning, if those of the file do not increase.

    Raises
    ------
    FileError
        If there is no frame.
    """
    readings, times, receipts = _Pile(), _Pile(), _Pile()
    for block in stream.blocks:
        readings.add(block.readings)
        for pile, clock in ((times, block.times), (receipts, block.receipts)):
            if clock is not None:
                pile.add(clock, np.float64)
        if progress:
            progress(min(block.share, 1.0))
    if not readings.n_rows:
        raise FileError(f"{stream.path} holds no frame")
    return Recording(
        readings.array(),
        names=stream.names,
        times=_best_clock(stream, [p.array() for p in (times, receipts) if p.n_rows]),
        rate_hz=stream.rate_hz,
        positions=stream.positions,
        normals=stream.normals,
        surface_distances=stream.surface_distances,
        units=stream.units,
        source=stream.source,
        metadata=stream.metadata,
    )


def recut(blocks: Iterator[Block], n_frames: int) -> Iterator[Block]:
    """Cut blocks anew, so that each but the last has `n_frames` frames."""
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


def salvaged(
    blocks: Iterator[Block], path: Path, damage: tuple[type[Exception], ...] = (DamagedError,)
) -> Iterator[Block]:
    """Give the blocks before the damage, and warn of what is lost; an error if there are none.

    Parameters
    ----------
    blocks : iterator of Block
    path : pathlib.Path
        The file to name.
    damage : tuple of exception types
        What reading a damaged file raises.
    """
    n_frames, share = 0, 0.0
    try:
        for block in blocks:
            n_frames, share = n_frames + len(block.readings), block.share
            yield block
    except damage as error:
        if not n_frames:
            raise
        told = reason_of(error.__cause__ or error)
        lost = f", about {1 - share:.0%} of the file" if 1 - share > _WORTH_TELLING else ""
        warnings.warn(
            f"{path} is damaged or cut short ({told}): the {n_frames} frames before that are "
            f"whole, what follows is lost{lost}",
            AnisomapWarning,
            stacklevel=2,
        )


class _Pile:
    """An array that grows at its end without ever standing in memory twice."""

    def __init__(self) -> None:
        self._array: NDArray[Any] | None = None
        self.n_rows = 0

    def add(self, rows: NDArray[Any], dtype: type[np.floating] = np.float32) -> None:
        needed = self.n_rows + len(rows)
        wanted = np.float32 if _fits(rows.dtype, dtype) else np.float64
        if self._array is None:
            self._array = np.empty(rows.shape, wanted)
        elif self._array.dtype == np.float32 and wanted == np.float64:
            self._array = self._array.astype(np.float64)
        if needed > len(self._array):
            capacity = max(needed, int(len(self._array) * (1 + _GROWTH)))
            # Moves pages instead of copying them; nobody else has seen this array yet.
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
        last.share,
        _concatenated([block.times for block in blocks]),
        _concatenated([block.receipts for block in blocks]),
    )


def _concatenated(parts: list[NDArray[np.float64] | None]) -> NDArray[np.float64] | None:
    there = [part for part in parts if part is not None]
    return np.concatenate(there) if there else None


def _best_clock(stream: Stream, clocks: list[NDArray[np.float64]]) -> NDArray[np.float64] | None:
    """Take the first clock that increases, or warn of where the first does not."""
    if not clocks:
        return None
    for times in clocks:
        with np.errstate(invalid="ignore"):
            if np.isfinite(times).all() and (np.diff(times) > 0).all():
                return times - times[0] if stream.from_zero else times
    return increasing(clocks[0], stream.path, stream.locate)
