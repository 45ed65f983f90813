"""HDF5 files, and other files of named arrays: any numeric dataset of frames x sensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import import_extra
from anisomap.files import check_regular
from anisomap.io.parsing.names import is_time, units_per_second
from anisomap.io.recordings.events import SpikeTrains, find_spike_trains, stream_spikes
from anisomap.io.stream import (
    BLOCK_BYTES,
    Block,
    Content,
    ReadOptions,
    Stream,
    choose,
    increasing_times,
)
from anisomap.recording import Scalar

_NUMBERS, _TEXT = "biuf", "SUO"
_MICROMETRES = "epos"  # positions in the retinal wave repository, which defines their unit
_SPAN = "recordingtime"
_POSITIONS = {"positions", "position", "xyz", "coordinates", "taxel_positions", _MICROMETRES}
_RATES = {"rate_hz", "fs", "sample_rate", "sampling_rate"}


@dataclass(frozen=True)
class Dataset:
    """A named array in a file.

    name: Name with groups, such as ``"left/readings"``.
    shape: The first axis of a recording is frames.
    dtype: Data type, for display.
    kind: As `numpy.dtype.kind`.
    read: ``read(start, stop)`` reads a range of frames.
    frames_at_once: Number of frames per compressed chunk.
    """

    name: str
    shape: tuple[int, ...]
    dtype: str
    kind: str
    read: Callable[[int, int], NDArray[Any]]
    frames_at_once: int = 1

    @property
    def key(self) -> str:
        """Name without groups, in lower case."""
        return self.name.rpartition("/")[2].lower()

    @property
    def group(self) -> str:
        """Groups that hold the dataset."""
        return self.name.rpartition("/")[0]

    def whole(self) -> NDArray[Any]:
        """Read the whole array."""
        return self.read(0, self.shape[0])


def contents_of(datasets: Sequence[Dataset]) -> tuple[Content, ...]:
    """List datasets, and whether they, or spike trains made of them, can be a recording."""
    trains = find_spike_trains(datasets)
    in_trains = {name for each in trains for name in each.members}
    # Vectors beside readings may be of any kind.
    readings = any(_usable(each) and each.name not in in_trains for each in datasets)
    return (
        *(
            Content(each.name, f"{each.n_units} spike trains", not readings or bool(each.index))
            for each in trains
        ),
        *(
            Content(
                each.name,
                f"{each.dtype}, {' x '.join(map(str, each.shape))}",
                _usable(each) and each.name not in in_trains,
            )
            for each in datasets
            if each.name not in {train.name for train in trains}
        ),
    )


def stream_of(
    path: Path,
    datasets: Sequence[Dataset],
    options: ReadOptions,
    metadata: Mapping[str, Scalar],
) -> Stream:
    """Create a stream of the selected or only possible recording."""
    name = choose(path, contents_of(datasets), options.select, "dataset").name
    for trains in find_spike_trains(datasets):
        if trains.name == name:
            stream = _stream_of_spikes(path, datasets, trains, options)
            return replace(stream, source=f"{path.name}:{name}")
    chosen = next(each for each in datasets if each.name == name)
    if not _usable(chosen):
        choose(path, contents_of([chosen]), "", "dataset")  # raises FileError
    near = [each for each in datasets if each.group == chosen.group and each is not chosen]
    n_frames, n_sensors = chosen.shape[0], math.prod(chosen.shape[1:])
    return Stream(
        path,
        n_sensors,
        _blocks(chosen, _times(path, near, n_frames)),
        names=_names(near, n_sensors) or _grid_names(chosen.shape[1:]),
        rate_hz=_rate(near),
        positions=_positions(near, n_sensors),
        source=f"{path.name}:{chosen.name}",
        metadata=metadata,
    )


def _stream_of_spikes(
    path: Path, datasets: Sequence[Dataset], trains: SpikeTrains, options: ReadOptions
) -> Stream:
    group = trains.times[0].group
    near = [each for each in datasets if each.group == group and each.name not in trains.members]
    micrometres = any(each.key == _MICROMETRES for each in near)
    names, positions = _names(near, trains.n_units), _positions(near, trains.n_units)
    stream = stream_spikes(
        path, trains, options.bin_s, names=names, positions=positions, span=_span(near)
    )
    return replace(stream, units="um" if micrometres and positions is not None else "")


def _usable(dataset: Dataset) -> bool:
    fits = dataset.kind in _NUMBERS and len(dataset.shape) >= 2 and dataset.shape[0] > 1
    return (
        fits
        and 0 not in dataset.shape
        and dataset.key not in _POSITIONS
        and not _is_time_vector(dataset)
    )


def _is_time_vector(dataset: Dataset) -> bool:
    """Return whether this is a vector of times, which MATLAB stores as a matrix."""
    return len(dataset.shape) == 2 and 1 in dataset.shape and is_time(dataset.key)


def _blocks(dataset: Dataset, times: NDArray[np.float64] | None) -> Iterator[Block]:
    n_frames, frame = dataset.shape[0], dataset.shape[1:]
    step = max(1, BLOCK_BYTES // (8 * math.prod(frame)))
    step = -(-step // dataset.frames_at_once) * dataset.frames_at_once
    for start in range(0, n_frames, step):
        stop = min(start + step, n_frames)
        rows = dataset.read(start, stop).reshape(stop - start, -1)
        yield Block(rows, stop / n_frames, None if times is None else times[start:stop])


def _times(path: Path, near: Sequence[Dataset], n_frames: int) -> NDArray[np.float64] | None:
    clocks = {each.key for each in near if is_time(each.key)}
    key, values = _numbers(near, clocks, n_frames)
    return (
        None if values is None else increasing_times(values / units_per_second(key, values), path)
    )


def _names(near: Sequence[Dataset], n_sensors: int) -> tuple[str, ...]:
    for each in near:
        if each.key != "names" or math.prod(each.shape) != n_sensors:
            continue
        values = each.whole().ravel().tolist() if each.kind in _TEXT else []
        if values and all(isinstance(value, str | bytes) for value in values):
            return tuple(v.decode() if isinstance(v, bytes) else v for v in values)
    return ()


def _grid_names(frame: tuple[int, ...]) -> tuple[str, ...]:
    if len(frame) < 2:
        return ()
    return tuple(".".join(map(str, index)) for index in np.ndindex(*frame))


def _positions(near: Sequence[Dataset], n_sensors: int) -> NDArray[np.float64] | None:
    for each in near:
        if each.key in _POSITIONS and each.kind in _NUMBERS and len(each.shape) == 2:
            values = each.whole().astype(np.float64)
            if values.shape[0] == n_sensors and values.shape[1] in (2, 3):
                return values
            # R and MATLAB store matrices by columns.
            if values.shape[1] == n_sensors and values.shape[0] in (2, 3):
                return np.ascontiguousarray(values.T)
    return None


def _numbers(
    near: Sequence[Dataset], keys: Collection[str], size: int
) -> tuple[str, NDArray[np.float64] | None]:
    """Return the key and values of the first dataset with one of the keys and so many numbers."""
    for each in near:
        if each.key in keys and each.kind in _NUMBERS and math.prod(each.shape) == size:
            return each.key, each.whole().astype(np.float64).ravel()
    return "", None


def _span(near: Sequence[Dataset]) -> tuple[float, float] | None:
    """Return the start and end of a recording of spikes, if the file gives them."""
    _, values = _numbers(near, {_SPAN}, 2)
    start, end = (math.nan, math.nan) if values is None else values.tolist()
    return (start, end) if math.isfinite(start) and start < end < math.inf else None


def _rate(near: Sequence[Dataset]) -> float | None:
    _, values = _numbers(near, _RATES, 1)
    rate = math.nan if values is None else float(values[0])
    return rate if 0 < rate < math.inf else None


EXTRA = "hdf5"

_MAGIC = b"\x89HDF\r\n\x1a\n"


def recognises(path: Path, head: bytes) -> bool:
    """Recognise HDF5 by its signature, which may follow a user block of 512, 1024, ... bytes."""
    offsets = [0, *(512 << i for i in range(7))]
    return any(head[offset : offset + len(_MAGIC)] == _MAGIC for offset in offsets)


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the datasets of a file."""
    with open_datasets(path, EXTRA) as datasets:
        return contents_of(datasets)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open the dataset `options.select`, given with or without groups, or the only possible one."""
    with open_datasets(path, EXTRA) as datasets:
        yield stream_of(path, datasets, options, {"format": "HDF5"})


@contextmanager
def open_datasets(path: Path, extra: str, *, frames_last: bool = False) -> Iterator[list[Dataset]]:
    """Open an HDF5 file and list its datasets, without following links to other files."""
    h5py = import_extra("h5py", "reading HDF5", extra)
    check_regular(path)
    with h5py.File(path, "r") as file:
        found = list[Any]()
        file.visititems(lambda _, item: found.append(item))  # stops at anything but None
        yield [
            _dataset(each, frames_last)
            for each in found
            if isinstance(each, h5py.Dataset) and not each.name.startswith("/#")
        ]


def _dataset(item: Any, frames_last: bool) -> Dataset:
    name = item.name.lstrip("/")
    shape = tuple(item.shape or ())
    chunks = tuple(item.chunks or ())
    if frames_last:
        shape, chunks = shape[::-1], chunks[::-1]

    def read(start: int, stop: int) -> NDArray[Any]:
        if item.external or item.is_virtual:
            raise OSError(f"dataset {name} is stored in other files, which are not opened")
        if not shape:
            return np.asarray(item[()]).reshape(1)
        if not frames_last:
            return np.asarray(item[start:stop])
        return np.asarray(item[..., start:stop]).T

    kind = item.dtype.kind
    return Dataset(name, shape or (1,), str(item.dtype), kind, read, chunks[0] if chunks else 1)
