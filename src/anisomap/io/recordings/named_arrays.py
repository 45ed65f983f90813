"""Files of named arrays: HDF5, and MATLAB versions 4, 5 and 7.3 (with reversed axes).

A recording is any numeric array of frames x sensors, also in a MATLAB structure. Times of spikes,
and cells and structures that list contacts, are refused with advice.

Source: The MathWorks (2024). MAT-File Level 5 File Format.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from anisomap.base.clocks import clock_of, is_time
from anisomap.base.columns import MIN_TAXELS, Frames, frames_of
from anisomap.errors import FileError, import_extra
from anisomap.files.budget import SENSOR_BYTES, Budget, bytes_kept
from anisomap.io.parsing.refusals import FROM_EVENTS
from anisomap.io.parsing.source import quote, read_head, warn
from anisomap.io.stream import (
    Content,
    ReadOptions,
    Stream,
    choose,
    increasing_times,
    read_in_blocks,
)
from anisomap.recording import Scalar

HDF5_EXTRA, _MAGIC = "hdf5", b"\x89HDF\r\n\x1a\n"
MAT_EXTRA = "mat"
MAT_MAGICS = (b"MATLAB 5.0 MAT-file", _MAGIC_73 := b"MATLAB 7.3 MAT-file")
"""First bytes of versions 5 and 7.3; version 4 is recognised only by its suffix."""

_KINDS = {"double": "f", "single": "f", "logical": "u"}
_KINDS |= {f"{sign}int{bits}": sign or "i" for sign in ("", "u") for bits in (8, 16, 32, 64)}
_MAX_DEPTH = 64  # of groups
_WIDE = 10  # columns per row of a matrix that may have channels first

_NUMBERS, _REAL, _TEXT = "biuf", "iuf", "SUO"
_POSITIONS = {"positions", "position", "xyz", "coordinates", "taxel_positions", "epos"}
_RATES = {"rate_hz", "rate", "fs", "fsamp", "srate", "sample_rate", "sampling_rate"}


@dataclass(frozen=True)
class Dataset:
    """A named array in a file; its first axis is frames if it is a recording.

    name: Name with groups, such as ``"left/readings"``.
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
        """Groups that contain the dataset."""
        return self.name.rpartition("/")[0]

    def whole(self) -> NDArray[Any]:
        """Read the whole array."""
        return self.read(0, self.shape[0])


def _contents(datasets: Sequence[Dataset]) -> tuple[Content, ...]:
    """List datasets, and whether they can be a recording."""
    return tuple(Content(each.name, _summary(each), _usable(each)) for each in datasets)


def _summary(dataset: Dataset) -> str:
    size = f"{dataset.dtype}, {' x '.join(map(str, dataset.shape))}"
    many = len(dataset.shape) > 2 and dataset.kind in _NUMBERS and frames_of(dataset.shape) is None
    return f"{size}: time, the longest axis, must be the first or the last" if many else size


def _stream_of(
    path: Path, datasets: Sequence[Dataset], options: ReadOptions, metadata: Mapping[str, Scalar]
) -> Stream:
    """Create a stream of the selected or only possible recording."""
    if not options.select and not any(map(_usable, datasets)) and any(map(_of_events, datasets)):
        raise FileError(f"{path} holds events", FROM_EVENTS)
    chosen = choose(path, _contents(datasets), options.select, "dataset")
    choose(path, [chosen], "", "dataset")  # raises FileError unless it can be a recording
    dataset = next(each for each in datasets if each.name == chosen.name)
    near = [each for each in datasets if each.group == dataset.group and each.name != dataset.name]
    dataset, names = _frames_first(path, dataset, near)
    n_frames, n_sensors = dataset.shape[0], math.prod(dataset.shape[1:])
    least = bytes_kept(np.dtype(np.float32))
    n_bytes = n_sensors * (n_frames * least + SENSOR_BYTES)
    Budget(path).check(n_bytes, "its table of readings")
    return Stream(
        path,
        n_sensors,
        read_in_blocks(
            lambda start, stop: dataset.read(start, stop).reshape(stop - start, -1),
            n_frames,
            8 * n_sensors,
            times=_times(path, near, n_frames),
            multiple=dataset.frames_at_once,
        ),
        names=_names(near, n_sensors) or names,
        rate_hz=_rate(near),
        positions=_positions(near, n_sensors),
        source=f"{path.name}:{chosen.name}",
        metadata=metadata,
        raw_columns=True,
    )


def _of_events(dataset: Dataset) -> bool:
    """Return whether a dataset may list times of spikes, or sensors of contacts."""
    return "spike" in dataset.name.lower() or dataset.dtype in ("cell", "struct")


def _frames_first(
    path: Path, dataset: Dataset, near: Sequence[Dataset]
) -> tuple[Dataset, tuple[str, ...]]:
    """Return a dataset with time as its first axis, and names of its readings."""
    frames = frames_of(dataset.shape)
    if len(dataset.shape) == 2 and (vector := _of_channels(dataset, near)):
        warn(path, f"the rows of {dataset.name} are taken as sensors, since {vector} is as long")
        frames = Frames(1, dataset.shape[:1], ())
    elif frames is None or len(dataset.shape) == 2:
        return dataset, ()
    else:
        warn(path, f"{dataset.name} has {len(dataset.shape)} axes: {frames.said}")
    if frames.time == 0:
        return dataset, frames.names
    n_frames = dataset.shape[-1]

    @functools.cache
    def whole() -> NDArray[Any]:
        return np.ascontiguousarray(np.moveaxis(dataset.whole(), -1, 0))

    moved = replace(dataset, shape=(n_frames, *frames.shape), frames_at_once=1)
    return replace(moved, read=lambda start, stop: whole()[start:stop]), frames.names


def _of_channels(dataset: Dataset, near: Sequence[Dataset]) -> str:
    """Return the name of a vector with a value for each row of a wide matrix beside it."""
    n_rows, n_columns = dataset.shape
    if n_rows < MIN_TAXELS or n_columns < _WIDE * n_rows:
        return ""
    fits = (each for each in near if math.prod(each.shape) == max(each.shape, default=0) == n_rows)
    return next((each.name for each in fits if not is_time(each.key)), "")


def _usable(dataset: Dataset) -> bool:
    shape = dataset.shape
    if dataset.kind not in _NUMBERS or len(shape) < 2 or shape[0] == 1 or 0 in shape:
        return False
    vector = len(shape) == 2 and 1 in shape  # MATLAB stores a vector as a matrix
    return not vector and frames_of(shape) is not None and dataset.key not in _POSITIONS


def _times(path: Path, near: Sequence[Dataset], n_frames: int) -> NDArray[np.float64] | None:
    clocks = {each.key for each in near if is_time(each.key)}
    key, values = _numbers(near, clocks, n_frames)
    if values is None:
        return None
    clock = clock_of(key, values)
    if clock.doubt:
        warn(path, f"{key}: {clock.doubt}")
    return increasing_times(values / clock.per_second, path)


def _names(near: Sequence[Dataset], n_sensors: int) -> tuple[str, ...]:
    for each in near:
        if each.key != "names" or math.prod(each.shape) != n_sensors:
            continue
        values = each.whole().ravel().tolist() if each.kind in _TEXT else []
        if values and all(isinstance(value, str | bytes) for value in values):
            return tuple(v.decode() if isinstance(v, bytes) else v for v in values)
    return ()


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
    """Return key and values of the first dataset with one of the keys and the requested size."""
    for each in near:
        if each.key in keys and each.kind in _NUMBERS and math.prod(each.shape) == size:
            return each.key, each.whole().astype(np.float64).ravel()
    return "", None


def _rate(near: Sequence[Dataset]) -> float | None:
    _, values = _numbers(near, _RATES, 1)
    rate = math.nan if values is None else float(values[0])
    return rate if 0 < rate < math.inf else None


def is_hdf5(path: Path, head: bytes) -> bool:
    """Recognise HDF5 by its signature, which may follow a user block of 512, 1024, ... bytes."""
    offsets = [0, *(512 << i for i in range(7))]
    return any(head[offset : offset + len(_MAGIC)] == _MAGIC for offset in offsets)


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the datasets or variables of a file, and lists within them."""
    with _open(path) as (_, datasets):
        return _contents(datasets)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open the array `options.select`, given with or without groups, or the only one."""
    with _open(path) as (name, datasets):
        yield _stream_of(path, datasets, options, {"format": name})


@contextmanager
def _open(path: Path) -> Iterator[tuple[str, list[Dataset]]]:
    """Open a file: the name of its format, and its arrays."""
    head = read_head(path)
    is_matlab = head.startswith(MAT_MAGICS)
    older = is_matlab or path.suffix.lower() == ".mat"
    if head.startswith(_MAGIC_73) or is_hdf5(path, head) or not older:
        with _open_hdf5(path, transposed=is_matlab) as datasets:
            yield "MATLAB" if is_matlab else "HDF5", datasets
        return
    listed = scipy.io.whosmat(path)
    datasets = [
        Dataset(name, tuple(shape), kind, _KINDS.get(kind, "V"), _reader(path, name))
        for name, shape, kind in listed
    ]
    structures = [name for name, _, kind in listed if kind == "struct"]
    for name, value in (_load(path, structures) if structures else {}).items():
        datasets += _fields_of(name, value)
    yield "MATLAB", datasets


@contextmanager
def _open_hdf5(path: Path, *, transposed: bool) -> Iterator[list[Dataset]]:
    """Open an HDF5 file and list its datasets, without following links to other files."""
    h5py = import_extra("h5py", "reading HDF5", MAT_EXTRA if transposed else HDF5_EXTRA)
    with h5py.File(path, "r") as file:
        found = list[Any]()

        def collect(_: str | bytes, item: Any) -> None:
            # Names of deeper groups would take quadratic time.
            if _name_of(item).count("/") > _MAX_DEPTH + 1:
                raise FileError(f"{path}: groups are more than {_MAX_DEPTH} deep; it is damaged")
            found.append(item)

        file.visititems(collect)
        yield [
            _hdf5_dataset(each, transposed=transposed)
            for each in found
            if isinstance(each, h5py.Dataset) and not _name_of(each).startswith("/#")
        ]


def _name_of(item: Any) -> str:
    """Return the path in the file; h5py returns bytes if it is not UTF-8."""
    return item.name if isinstance(item.name, str) else item.name.decode(errors="replace")


def _hdf5_dataset(item: Any, *, transposed: bool) -> Dataset:
    name, order = _name_of(item).lstrip("/"), -1 if transposed else 1
    shape, chunks = (tuple(sizes or ())[::order] for sizes in (item.shape, item.chunks))

    def read(start: int, stop: int) -> NDArray[Any]:
        if item.external or item.is_virtual:
            raise OSError(f"dataset {name} is stored in other files, which are not opened")
        if not shape:
            return np.asarray(item[()]).reshape(1)
        return np.asarray(item[..., start:stop]).T if transposed else np.asarray(item[start:stop])

    kind = item.dtype.kind
    return Dataset(name, shape or (1,), str(item.dtype), kind, read, chunks[0] if chunks else 1)


def _reader(path: Path, name: str) -> Callable[[int, int], NDArray[Any]]:
    @functools.cache
    def loaded() -> NDArray[Any]:
        found = np.asarray(_load(path, [name])[name])
        if np.iscomplexobj(found):  # not shown in the listing
            raise FileError(f"{path}: variable {quote(name)} is complex; readings are real")
        return found

    return lambda start, stop: loaded()[start:stop]


def _load(path: Path, names: list[str]) -> dict[str, Any]:
    found = scipy.io.loadmat(path, variable_names=names)
    if lost := [name for name in names if name not in found]:
        raise FileError(f"{path} is damaged: it lists the variable {quote(lost[0])}, but lacks it")
    return {name: found[name] for name in names}


def _fields_of(name: str, value: NDArray[Any]) -> Iterator[Dataset]:
    """Yield the arrays of numbers in a single structure."""
    if value.size != 1 or value.dtype.names is None:
        return
    for field in value.dtype.names:
        array = value.ravel()[0][field]
        if isinstance(array, np.ndarray) and array.dtype.kind in _REAL and array.size:
            read = functools.partial(_part, array)
            kind = str(array.dtype)
            yield Dataset(f"{name}/{field}", array.shape, kind, array.dtype.kind, read)


def _part(array: NDArray[Any], start: int, stop: int) -> NDArray[Any]:
    return array[start:stop]
