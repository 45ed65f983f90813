"""Recordings as streams of blocks of frames.

A reader returns a `Stream`: the metadata of the recording, and an iterator of blocks. `assemble`
collects the blocks into a `Recording`, or an even sample of their frames, `choose` selects the
recording in files that contain several, and `join_streams` joins parts of one skin that were
recorded simultaneously. `open_isolated` reads a recording in another process: see
`anisomap.files.reader_process`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anisomap.base.columns import AXES
from anisomap.base.wording import join_items, printable
from anisomap.errors import DamagedError, FileError, InputError
from anisomap.files import reader_process
from anisomap.io.parsing.source import batches, warn, warn_of_loss
from anisomap.names import default_names
from anisomap.numerics.sampling import EvenSample
from anisomap.recording import Recording, Scalar


def increasing_times(
    times: NDArray[np.floating],
    path: Path,
    locate: Callable[[int], str] | None = None,
    every: int = 1,
) -> NDArray[np.float64] | None:
    """Return times, (T,), if they are finite and strictly increase; else warn and return None.

    every: k if only every k-th frame is given.
    """
    values = np.asarray(times, dtype=np.float64)
    if values.ndim != 1:
        raise FileError(f"{path}: times must have shape (T,), got {values.shape}")
    valid = _increase(values)
    if valid.all():
        return values
    frame = int(np.argmin(valid))
    where = f" ({locate(frame * every)})" if locate else ""
    after = f" after {float(values[frame - 1])!r}" if frame else ""
    place = f"frame {frame * every}{where} is at {float(values[frame])!r}{after}"
    warn(path, f"times must strictly increase, but {place}; the times are ignored")
    return None


def _increase(times: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Return which times are finite and follow an earlier one, (T,)."""
    valid: NDArray[np.bool_] = np.isfinite(times)
    with np.errstate(invalid="ignore"):
        valid[1:] &= np.diff(times) > 0
    return valid


def to_float32_if_exact(readings: NDArray[Any]) -> NDArray[Any]:
    """Convert readings to float32 if it is exact, which halves the memory of most recordings."""
    with np.errstate(all="ignore"):
        single = readings.astype(np.float32)
    return single if np.array_equal(single, readings, equal_nan=True) else readings


_MAX_LISTED = 12
_MIN_TURNED = 8  # frames


class ChoiceError(FileError):
    """The file contains several possible recordings, and none was selected."""


@dataclass(frozen=True)
class Content:
    """One item in a file: a dataset, topic or port.

    Parameters
    ----------
    name : str
        Name to select it by.
    summary : str
        Type and size, for display.
    usable : bool
        Whether it can be a recording.
    """

    name: str
    summary: str
    usable: bool = True


def choose(path: Path, contents: Sequence[Content], select: str, noun: str) -> Content:
    """Select the recording by name, or the only usable item."""
    usable = [content for content in contents if content.usable]
    if select:
        named = [content for content in contents if content.name == select] or [
            content for content in usable if f"/{select.strip('/')}/" in f"/{content.name}/"
        ]
        if len(named) != 1:
            problem = f"several {noun}s match" if named else f"there is no {noun}"
            raise FileError(f"{path}: {problem} {select!r}; it holds {_listed(named or contents)}")
        return named[0]
    if len(usable) > 1:
        raise ChoiceError(
            f"{path} holds {len(usable)} possible recordings ({noun}s): {_listed(usable)}; "
            "choose one with --select"
        )
    if not usable:
        listing = f"; it holds {_listed(contents)}" if contents else ""
        raise FileError(f"{path} holds no {noun} that can be a recording{listing}")
    return usable[0]


def refuse_selection(described: object, select: str) -> None:
    """Raise a `FileError` if a recording is selected in a file with a single recording."""
    if select:
        raise FileError(f"{described} holds a single recording; leave out --select {select}")


def _listed(contents: Sequence[Content]) -> str:
    return join_items([f"{printable(one.name)} ({one.summary})" for one in contents], _MAX_LISTED)


BLOCK_FRAMES = 8192
"""Default number of frames per block of `open_stream`."""

BLOCK_BYTES = 1 << 22
"""Size of the blocks of readers, with at least one frame: small compared to memory, and large
enough that the overhead of a block is negligible."""


@dataclass(frozen=True)
class ReadOptions:
    """Information for a reader that the file lacks.

    Parameters
    ----------
    select : str
        Recording to read from a file with several: a dataset, port, or topic with field
        (``/skin:data``). Several ports or topics are separated by commas. Must be empty for formats
        with a single recording.
    grid : (int, int), optional
        Rows and columns of a rectangular array with sensors in row-major order; sets positions.
    definitions : tuple of pathlib.Path
        Message definitions (``.msg``) for a bag without them.
    preset : str
        A robot with a known numbering of sensors: see `anisomap.io.presets`.
    positions : pathlib.Path, optional
        File of true positions of the sensors, in any format of maps. Sensors match by name, or by
        the numbers at the ends of the names.
    axis : {"z", "norm", "x", "y", "all"}
        Axis of taxels with three axes: one axis, the distance of the reading from its value at rest
        (``"norm"``), or each axis as a sensor.
    keep : tuple of str
        Columns that are sensors: names, indices, ranges (``c0-c35``) or patterns (``*_z``). By
        default, all columns that are not recognised as something else.

    Raises
    ------
    InputError
        If `grid` or `axis` is out of range.
    """

    select: str = ""
    grid: tuple[int, int] | None = None
    definitions: tuple[Path, ...] = ()
    preset: str = ""
    positions: Path | None = None
    axis: str = "z"
    keep: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        sizes = self.grid if isinstance(self.grid, tuple | list) else ()
        whole = [isinstance(n, int | np.integer) and n >= 1 for n in sizes]
        if self.grid is not None and whole != [True, True]:
            raise InputError(f"grid must be numbers of rows and columns, got {self.grid!r}")
        if self.axis not in AXES:
            raise InputError(f"axis must be one of {', '.join(AXES)}, got {self.axis!r}")


@dataclass(frozen=True, eq=False)
class Block:
    """Consecutive frames of a recording: readings (t, N) of any real type, and times (t,).

    fraction: Fraction of the file read so far, from 0 to 1.
    times: In seconds, as stored in the file.
    receive_times: Times of the receiver's clock, used if `times` do not increase.
    """

    readings: NDArray[Any]
    fraction: float
    times: NDArray[np.float64] | None = None
    receive_times: NDArray[np.float64] | None = None

    @property
    def arrays(self) -> dict[str, Any]:
        """The existing arrays by name."""
        return {name: each for name, each in vars(self).items() if isinstance(each, np.ndarray)}

    def part(self, start: int, stop: int | None = None) -> Block:
        """Return the frames from `start` up to, but not including, `stop`."""
        return replace(self, **{name: each[start:stop] for name, each in self.arrays.items()})


@dataclass(frozen=True, eq=False)
class Stream:
    """A recording that is read block by block, with its metadata.

    path: The file, for messages.
    n_sensors: In every block.
    blocks: Can be iterated once.
    names, ..., metadata: See `Recording`.
    from_zero: Whether to shift times so that the first frame is at 0.
    locate: Maps a frame index to its place in the file, such as ``"line 12"``.
    raw_columns: Whether columns may be axes of sensors, or not sensors.
    columns: Places of the sensors among the columns of a table, from 0.
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
    raw_columns: bool = False
    columns: tuple[int, ...] = ()

    def of_others(
        self, names: tuple[str, ...], blocks: Iterator[Block], rate_hz: float | None
    ) -> Stream:
        """Return a stream of other sensors, whose places are unknown."""
        facts: dict[str, Any] = dict.fromkeys(
            ("positions", "normals", "surface_distances", "locate")
        )
        facts |= {"n_sensors": len(names), "names": names, "blocks": blocks, "rate_hz": rate_hz}
        return replace(self, **facts)


FRAMES_SAMPLED = "frames_sampled_every"
"""Key of the metadata of a recording of which every k-th frame was kept; the value is k."""


def sampled_every(metadata: Mapping[str, Scalar]) -> int:
    """Return k if only every k-th frame of a recording was kept, by its metadata, else 1."""
    every = metadata.get(FRAMES_SAMPLED)
    return max(every, 1) if isinstance(every, int) else 1


def _sampled(metadata: Mapping[str, Scalar], step: int) -> Mapping[str, Scalar]:
    """Return metadata after every `step`-th frame was kept."""
    if step == 1:
        return metadata
    return {**metadata, FRAMES_SAMPLED: step * sampled_every(metadata)}


def assemble(
    stream: Stream, progress: Callable[[float], None] | None = None, max_readings: float = math.inf
) -> Recording:
    """Collect a stream into a recording, without copying the readings.

    max_readings: Every k-th frame of a longer recording is kept, k a power of 2.
    """
    sample, clocks = EvenSample(max_readings), dict[str, list[NDArray[np.float64]]]()
    for block in stream.blocks:
        every, kept = sample.every, sample.next_kept
        sample.add(block.readings)
        for name in ("times", "receive_times"):
            if name in block.arrays:
                clocks.setdefault(name, []).append(block.arrays[name][kept])
        if sample.every > every:
            step = sample.every // every
            clocks = {name: [np.concatenate(held)[::step]] for name, held in clocks.items()}
        if progress:
            progress(min(block.fraction, 1.0))
    if progress:
        progress(1.0)
    if not sample.n_frames:
        raise FileError(f"{stream.path} holds no frame")
    if doubt := doubt_of_rows(stream, sample.n_frames):
        warn(stream.path, doubt)
    every = sample.every
    return Recording(
        sample.take(),
        names=stream.names,
        times=_best_clock(stream, list(map(np.concatenate, clocks.values())), every),
        rate_hz=None if stream.rate_hz is None else stream.rate_hz / every,
        positions=stream.positions,
        normals=stream.normals,
        surface_distances=stream.surface_distances,
        units=stream.units,
        source=stream.source,
        metadata=_sampled(stream.metadata, every),
    )


def doubt_of_rows(stream: Stream, n_frames: int) -> str:
    """Return a warning if the rows of a table without names may be sensors; else empty."""
    if not (stream.raw_columns and _MIN_TURNED <= n_frames < stream.n_sensors / 4) or stream.names:
        return ""
    size = f"{n_frames} frames of {stream.n_sensors} sensors without names"
    return f"{size}: if rows are sensors, transpose the table"


def thin(recording: Recording, step: int) -> Recording:
    """Keep every `step`-th frame of a recording."""
    if step == 1:
        return recording
    times, rate_hz = recording.times, recording.rate_hz
    return replace(
        recording,
        readings=np.ascontiguousarray(recording.readings[::step]),
        times=None if times is None else times[::step],
        rate_hz=None if rate_hz is None else rate_hz / step,
        metadata=_sampled(recording.metadata, step),
    )


def rechunk(blocks: Iterator[Block], n_frames: int) -> Iterator[Block]:
    """Regroup blocks so that each but the last has `n_frames` frames."""
    held: list[Block] = []
    for block in blocks:
        held.append(block)
        if sum(len(part.readings) for part in held) < n_frames:
            continue
        joined = join_blocks(held)
        whole = len(joined.readings) // n_frames * n_frames
        for start in range(0, whole, n_frames):
            yield joined.part(start, start + n_frames)
        held = [joined.part(whole)] if whole < len(joined.readings) else []
    if held:
        yield join_blocks(held)


def read_in_blocks(
    read: Callable[[int, int], NDArray[Any]],
    n_frames: int,
    frame_bytes: int,
    *,
    times: NDArray[np.float64] | None = None,
    multiple: int = 1,
) -> Iterator[Block]:
    """Read frames in blocks of a multiple of frames; ``read(start, stop)`` returns readings."""
    step = -(-max(1, BLOCK_BYTES // frame_bytes) // multiple) * multiple
    for start in range(0, n_frames, step):
        stop = min(start + step, n_frames)
        at = None if times is None else times[start:stop]
        yield Block(read(start, stop), stop / n_frames, at)


def salvage(blocks: Iterator[Block], path: Path) -> Iterator[Block]:
    """Yield the blocks before the first damage, and warn about lost blocks."""
    n_frames, fraction = 0, 0.0
    try:
        for block in blocks:
            n_frames, fraction = n_frames + len(block.readings), block.fraction
            yield block
    except DamagedError as error:
        if not n_frames:
            raise
        warn_of_loss(path, error.__cause__ or error, f"{n_frames} frames", fraction)


class Frame(NamedTuple):
    """Readings, shape (N,), the fraction of the file read so far, and two times as in a `Block`."""

    readings: NDArray[Any]
    fraction: float
    time: float | None = None
    receive_time: float | None = None


def stack_frames(frames: Iterator[Frame]) -> Iterator[Block]:
    """Collect frames in blocks, without times if some lack them; yield frames before an error."""
    for held in batches(frames, lambda frame: frame.readings.nbytes, BLOCK_BYTES):
        readings, fractions, *clocks = zip(*held, strict=True)
        times = (None if None in clock else np.array(clock) for clock in clocks)
        yield Block(to_float32_if_exact(np.array(readings)), fractions[-1], *times)


def join_blocks(blocks: list[Block]) -> Block:
    """Join consecutive blocks."""
    if len(blocks) == 1:
        return blocks[0]
    parts = [block.arrays for block in blocks]
    names = [name for name in parts[0] if all(name in part for part in parts)]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in names}
    return Block(fraction=blocks[-1].fraction, **joined)


def _best_clock(
    stream: Stream, clocks: list[NDArray[np.float64]], every: int
) -> NDArray[np.float64] | None:
    """Return the first clock that increases strictly, or warn that none does."""
    for times in clocks:
        if _increase(times).all():
            return times - times[0] if stream.from_zero else times
    return increasing_times(clocks[0], stream.path, stream.locate, every) if clocks else None


def join_streams(streams: Mapping[str, Stream]) -> Stream:
    """Join the sensors of several streams at the times of the first; a single one is unchanged.

    All streams except the first are read as a whole.
    """
    (_, leader), *followers = streams.items()
    if not followers:
        return leader
    names = tuple(
        f"{part}/{name}"
        for part, stream in streams.items()
        for name in stream.names or default_names(stream.n_sensors)
    )
    return leader.of_others(names, _joined_blocks(leader, followers, [*streams]), leader.rate_hz)


def _joined_blocks(
    leader: Stream, followers: Sequence[tuple[str, Stream]], parts: Sequence[str]
) -> Iterator[Block]:
    latest, overlap = [_whole(*follower) for follower in followers], False
    for block in leader.blocks:
        if block.times is None:
            raise FileError(f"{leader.path} has no times; joining recordings requires them")
        rows, covered = [block.readings], np.ones(len(block.readings), dtype=bool)
        for times, readings in latest:
            last = np.searchsorted(times, block.times, side="right") - 1
            rows.append(readings[last.clip(0)])
            covered &= (last >= 0) & (block.times <= times[-1])
        if covered.any():
            overlap = True
            yield Block(np.hstack(rows)[covered], block.fraction, block.times[covered])
    if not overlap:
        raise FileError(f"{leader.path}: the recordings {join_items(parts)} do not overlap in time")


def _whole(name: str, stream: Stream) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """Read all times, (T,), and readings, (T, N), of a stream; decreasing times are held."""
    blocks = list(stream.blocks)
    if not blocks:
        raise FileError(f"{stream.path}: {name} has no frame")
    times = [block.times for block in blocks if block.times is not None]
    if len(times) < len(blocks):
        raise FileError(f"{stream.path}: {name} has no times; joining recordings requires them")
    readings = np.concatenate([block.readings for block in blocks])
    return np.fmax.accumulate(np.concatenate(times)), readings


@contextmanager
def open_isolated(
    function: Callable[..., Any], path: Path, options: ReadOptions
) -> Iterator[Stream]:
    """Open a recording by the function of a format, and read it in another process."""
    with reader_process.opened(_recording, path, *_sent(function, options)) as parts:
        facts = next(parts)
        path, names = Path(facts.pop("path")), tuple(facts.pop("names"))
        blocks = salvage((Block(**block) for block in parts), path)
        yield Stream(path, blocks=blocks, names=names, **facts)


def contents_isolated(
    function: Callable[..., Any], path: Path, options: ReadOptions
) -> tuple[Content, ...]:
    """List the content of a file by the function of a format, in another process."""
    with reader_process.opened(_contents, path, *_sent(function, options)) as parts:
        return tuple(Content(**each) for each in next(parts))


def _sent(function: Callable[..., Any], options: ReadOptions) -> tuple[Any, ...]:
    definitions = [os.fspath(each) for each in options.definitions]
    return (*(function.__module__, function.__name__), *(options.select, definitions, options.keep))


def _called(path: Path, *sent: Any) -> Any:
    module, name, select, paths, keep = sent
    definitions = tuple(map(Path, paths))
    options = ReadOptions(select, definitions=definitions, keep=tuple(keep))
    return getattr(import_module(module), name)(path, options)


def _recording(path: Path, *sent: Any) -> Iterator[dict[str, Any]]:
    """Yield the facts of a stream, and its blocks."""
    with _called(path, *sent) as stream:
        facts = {**vars(stream), "path": os.fspath(stream.path)}
        blocks = facts.pop("blocks")
        yield {**facts, "metadata": dict(stream.metadata)}
        for block in blocks:
            yield vars(block)


def _contents(path: Path, *sent: Any) -> Iterator[list[dict[str, Any]]]:
    yield [vars(each) for each in _called(path, *sent)]
