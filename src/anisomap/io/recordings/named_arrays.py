"""Files of named arrays: HDF5, and MATLAB of versions 4, 5 and 7.3, the latter with reversed axes.

A recording is any numeric array of frames x sensors, or the times of spikes: of all units in one
vector, beside their numbers (``spikes``, ``sCount``: Eglen et al. 2014, GigaScience 3:3,
doi:10.1186/2047-217X-3-3) or ends (``spike_times_index``: Neurodata Without Borders), or a vector
per unit. Cell and structure arrays of MATLAB list the ids of the sensors of each contact, the last
column of ``x y z id``, or the spike times of each channel.

Source: The MathWorks (2024). MAT-File Level 5 File Format.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from anisomap.base.axes import frames_of
from anisomap.base.clocks import clock_of, is_time
from anisomap.errors import FileError, import_extra
from anisomap.files.budget import Budget, bytes_kept
from anisomap.io.parsing.source import quote, read_head, warn
from anisomap.io.recordings.contact_lists import stream_contacts
from anisomap.io.recordings.events import stream_trains
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
"""First bytes of versions 5 and 7.3; version 4 has only its suffix."""

_KINDS = {
    "double": "f",
    "single": "f",
    "logical": "u",
    **{f"int{bits}": "i" for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": "u" for bits in (8, 16, 32, 64)},
}
_WITH_POINT = 4  # columns of x y z id
_MIN_UNITS = 2
_MAX_DEPTH = 64  # of groups
_DIGIT = re.compile(r"\d")

_NUMBERS, _REAL, _TEXT = "biuf", "iuf", "SUO"
_MICROMETRES = "epos"  # positions in the retinal wave repository, which defines their unit
_SPAN = "recordingtime"
_POSITIONS = {"positions", "position", "xyz", "coordinates", "taxel_positions", _MICROMETRES}
_RATES = {"rate_hz", "fs", "sample_rate", "sampling_rate"}


@dataclass(frozen=True)
class Dataset:
    """A named array in a file, whose first axis is frames if it is a recording.

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
        """Groups that hold the dataset."""
        return self.name.rpartition("/")[0]

    def whole(self) -> NDArray[Any]:
        """Read the whole array."""
        return self.read(0, self.shape[0])


@dataclass(frozen=True, eq=False)
class Lists:
    """Lists of numbers of different lengths, one per contact, channel or unit.

    members: Names of all arrays that they are in.
    group: Groups in which names and positions of the channels are looked for.
    certain: Whether they are a recording also beside arrays that can be one.
    contacts: Whether the lists are ids of sensors; otherwise they are times.
    """

    name: str
    length: int
    read: Callable[[], Sequence[NDArray[Any]]]
    members: frozenset[str]
    group: str = ""
    names: tuple[str, ...] = ()
    certain: bool = False
    contacts: bool = False

    @property
    def summary(self) -> str:
        """Description for display."""
        return f"{self.length} {'lists of sensors' if self.contacts else 'spike trains'}"


def find_spike_trains(path: Path, arrays: Sequence[Dataset]) -> list[Lists]:
    """Find the spike trains of each group."""
    groups: dict[str, list[Dataset]] = {}
    for each in arrays:
        groups.setdefault(each.group, []).append(each)
    found = (_trains_in(path, group, members) for group, members in groups.items())
    return [each for each in found if each]


def _trains_in(path: Path, group: str, arrays: Sequence[Dataset]) -> Lists | None:
    vectors = {each.key: each for each in arrays if _is_vector(each)}
    for times, index in (("spikes", "scount"), ("spike_times", "spike_times_index")):
        if times in vectors and index in vectors:
            pair = vectors[times], vectors[index]
            length = math.prod(pair[1].shape)
            return Lists(
                pair[0].name,
                length,
                functools.partial(_divided, path, *pair, counted=index == "scount"),
                frozenset(each.name for each in pair),
                group,
                tuple(f"e{i}" for i in range(length)),
                certain=True,
            )
    one_each = group and len(vectors) == len(arrays) >= _MIN_UNITS
    numbered = all(each.kind == "f" and _DIGIT.search(key) for key, each in vectors.items())
    lengths = {math.prod(each.shape) for each in vectors.values()}
    # Vectors of equal length are readings or properties of sensors.
    if not (one_each and numbered and len(lengths) > 1):
        return None
    return Lists(
        group,
        len(arrays),
        lambda: [each.whole().ravel() for each in arrays],
        frozenset(each.name for each in arrays),
        group,
        tuple(each.name.removeprefix(f"{group}/") for each in arrays),
    )


def _is_vector(array: Dataset) -> bool:
    """Return whether an array is a vector of numbers, which MATLAB stores as a matrix."""
    return array.kind in _REAL and sum(size != 1 for size in array.shape) <= 1


def _divided(path: Path, times: Dataset, index: Dataset, *, counted: bool) -> list[NDArray[Any]]:
    """Divide times among units, by the number of spikes of each, or else by the ends of units."""
    spikes, values = times.whole().ravel(), index.whole().astype(np.float64).ravel()
    counts = values if counted else np.diff(values, prepend=0)
    whole = bool(np.isfinite(counts).all() and (counts == np.floor(counts)).all())
    if not whole or counts.min(initial=0) < 0 or counts.sum() != len(spikes):
        raise FileError(
            f"{path}: {index.name} must divide the {len(spikes)} times of {times.name} among the "
            f"units, but it gives {counts.sum():g}"
        )
    return np.split(spikes, np.cumsum(counts.astype(np.intp))[:-1])


def _contents(datasets: Sequence[Dataset], lists: Sequence[Lists]) -> tuple[Content, ...]:
    """List datasets and what is made of them, and whether they can be a recording."""
    members = frozenset[str]().union(*(each.members for each in lists))
    others = [each for each in datasets if each.name not in members]
    # Vectors and cell arrays beside readings may be of any kind.
    alone = not any(map(_usable, others))
    return (
        *(Content(each.name, each.summary, alone or each.certain) for each in lists),
        *(
            Content(each.name, f"{each.dtype}, {' x '.join(map(str, each.shape))}", _usable(each))
            for each in others
        ),
    )


def _stream_of(
    path: Path,
    datasets: Sequence[Dataset],
    lists: Sequence[Lists],
    options: ReadOptions,
    metadata: Mapping[str, Scalar],
) -> Stream:
    """Create a stream of the selected or only possible recording."""
    chosen = choose(path, _contents(datasets, lists), options.select, "dataset")
    listed = next((each for each in lists if each.name == chosen.name), None)
    if listed:
        stream = _stream_of_lists(path, datasets, listed, options.bin_s)
        return replace(stream, source=f"{path.name}:{chosen.name}")
    choose(path, [chosen], "", "dataset")  # raises FileError for one that cannot be a recording
    dataset = next(each for each in datasets if each.name == chosen.name)
    dataset, names = _frames_first(path, dataset)
    near = [each for each in datasets if each.group == dataset.group and each.name != dataset.name]
    n_frames, n_sensors = dataset.shape[0], math.prod(dataset.shape[1:])
    least = bytes_kept(np.dtype(np.float32))
    Budget(path).check_readings(n_frames, n_sensors, least, "its table of readings")
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


def _frames_first(path: Path, dataset: Dataset) -> tuple[Dataset, tuple[str, ...]]:
    """Return a dataset with time as its first axis, and names of its readings."""
    frames = frames_of(dataset.shape)
    if frames is None or len(dataset.shape) == 2:
        return dataset, ()
    warn(path, f"{dataset.name} has {len(dataset.shape)} axes: {frames.said}")
    if frames.time == 0:
        return dataset, frames.names
    n_frames = dataset.shape[-1]

    @functools.cache
    def whole() -> NDArray[Any]:
        return np.ascontiguousarray(np.moveaxis(dataset.whole(), -1, 0))

    moved = replace(dataset, shape=(n_frames, *frames.shape), frames_at_once=1)
    return replace(moved, read=lambda start, stop: whole()[start:stop]), frames.names


def _stream_of_lists(
    path: Path, datasets: Sequence[Dataset], lists: Lists, bin_s: float | None
) -> Stream:
    """Create a stream of lists: a frame per contact, or counts of spikes in bins."""
    if lists.contacts:
        numbered = enumerate(each.astype(np.int64).tolist() for each in lists.read())
        contacts = ((("contact", "taxel"), float(i), [*map(str, ids)], None) for i, ids in numbered)
        return stream_contacts(path, contacts, bin_s, variable=lists.name)
    near = [e for e in datasets if e.group == lists.group and e.name not in lists.members]
    positions = _positions(near, lists.length)
    micrometres = positions is not None and any(each.key == _MICROMETRES for each in near)
    return stream_trains(
        path,
        lists.read(),
        bin_s,
        _names(near, lists.length) or lists.names,
        positions=positions,
        span=_span(near),
        units="um" if micrometres else "",
    )


def _usable(dataset: Dataset) -> bool:
    shape = dataset.shape
    if dataset.kind not in _NUMBERS or len(shape) < 2 or shape[0] == 1 or 0 in shape:
        return False
    if frames_of(shape) is None:
        return False
    # MATLAB stores a vector as a matrix.
    is_clock = len(shape) == 2 and 1 in shape and is_time(dataset.key)
    return not is_clock and dataset.key not in _POSITIONS


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


def is_hdf5(path: Path, head: bytes) -> bool:
    """Recognise HDF5 by its signature, which may follow a user block of 512, 1024, ... bytes."""
    offsets = [0, *(512 << i for i in range(7))]
    return any(head[offset : offset + len(_MAGIC)] == _MAGIC for offset in offsets)


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the datasets or variables of a file, and the lists that are found in them."""
    with _open(path) as (_, datasets, lists):
        return _contents(datasets, lists)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open the array or lists `options.select`, given with or without groups, or the only one."""
    with _open(path) as (name, datasets, lists):
        yield _stream_of(path, datasets, lists, options, {"format": name})


@contextmanager
def _open(path: Path) -> Iterator[tuple[str, list[Dataset], list[Lists]]]:
    """Open a file: the name of its format, its arrays, and the lists in them."""
    head = read_head(path)
    is_matlab = head.startswith(MAT_MAGICS)
    older = is_matlab or path.suffix.lower() == ".mat"
    if head.startswith(_MAGIC_73) or is_hdf5(path, head) or not older:
        with _open_hdf5(path, transposed=is_matlab) as datasets:
            yield "MATLAB" if is_matlab else "HDF5", datasets, find_spike_trains(path, datasets)
        return
    listed = scipy.io.whosmat(path)
    datasets = [
        Dataset(name, tuple(shape), kind, _KINDS.get(kind, "V"), _reader(path, name))
        for name, shape, kind in listed
    ]
    cells = [name for name, _, kind in listed if kind in ("cell", "struct")]
    variables = _load(path, cells) if cells else {}
    for name, value in variables.items():
        datasets += _fields_of(name, value)
    lists = [found for name, value in variables.items() for found in _lists_in(name, value)]
    yield "MATLAB", datasets, [*lists, *find_spike_trains(path, datasets)]


@contextmanager
def _open_hdf5(path: Path, *, transposed: bool) -> Iterator[list[Dataset]]:
    """Open an HDF5 file and list its datasets, without following links to other files."""
    h5py = import_extra("h5py", "reading HDF5", MAT_EXTRA if transposed else HDF5_EXTRA)
    with h5py.File(path, "r") as file:
        found = list[Any]()

        def collect(_: str | bytes, item: Any) -> None:
            # Names of deeper groups take quadratic time.
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
    """Return the path in the file; h5py returns bytes where it is not UTF-8."""
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
        if np.iscomplexobj(found):  # which the listing does not tell
            raise FileError(f"{path}: variable {quote(name)} is complex; readings are real")
        return found

    return lambda start, stop: loaded()[start:stop]


def _load(path: Path, names: list[str]) -> dict[str, Any]:
    found = scipy.io.loadmat(path, variable_names=names)
    if lost := [name for name in names if name not in found]:
        raise FileError(f"{path} is damaged: it lists the variable {quote(lost[0])} and lacks it")
    return {name: found[name] for name in names}


def _fields_of(name: str, value: NDArray[Any]) -> Iterator[Dataset]:
    """Yield the arrays of numbers in a single structure."""
    if value.size != 1 or value.dtype.names is None:
        return
    for field in value.dtype.names:
        array = value.ravel()[0][field]
        if isinstance(array, np.ndarray) and array.dtype.kind in _REAL and array.size > 1:
            read = functools.partial(_part, array)
            kind = str(array.dtype)
            yield Dataset(f"{name}/{field}", array.shape, kind, array.dtype.kind, read)


def _part(array: NDArray[Any], start: int, stop: int) -> NDArray[Any]:
    return array[start:stop]


def _lists_in(name: str, value: NDArray[Any]) -> Iterator[Lists]:
    """Find the contacts and spike trains in a cell array or structure."""
    items = [*value.ravel()]
    fields = value.dtype.names
    if fields is None and all(_is_struct(item) for item in items):
        items = [item.ravel()[0] for item in items if item.size == 1]
        fields = items[0].dtype.names if items and len(items) == value.size else ()
        if any(item.dtype.names != fields for item in items):
            return
    columns = {name: items}
    if fields is not None:
        columns = {f"{name}/{field}": [item[field] for item in items] for field in fields}
    for column, entries in columns.items():
        vectors = [_vector(entry) for entry in entries]
        if len(entries) < _MIN_UNITS:
            continue
        known = [vector for vector in vectors if vector is not None]
        if len(known) < len(entries) or max(map(len, known), default=0) < 2:
            continue
        values = np.concatenate(known)
        # Ids in float64 are exact up to 2^53, which no numbering of sensors reaches.
        whole = bool(((values >= 0) & (values == np.floor(values)) & (values < 2**53)).all())
        if whole or all((np.diff(vector) >= 0).all() for vector in known):
            read = functools.partial(tuple, known)
            yield Lists(column, len(known), read, frozenset([name]), contacts=whole)


def _is_struct(item: Any) -> bool:
    return isinstance(item, np.ndarray) and item.dtype.names is not None


def _vector(item: Any) -> NDArray[np.float64] | None:
    """Return a vector as float64, the last column of ``x y z id``, or None for anything else."""
    if not isinstance(item, np.ndarray) or item.dtype.kind not in _REAL or item.ndim != 2:
        return None
    values = item.astype(np.float64)
    if not values.size or 1 in values.shape:
        # A single row of four columns with fractions is a point with an id.
        fractions = bool((values[..., :3] % 1 != 0).any())
        return values[0, 3:] if values.shape == (1, _WITH_POINT) and fractions else values.ravel()
    return values[:, 3] if values.shape[1] == _WITH_POINT else None
