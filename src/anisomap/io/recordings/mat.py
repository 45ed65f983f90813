"""MATLAB files of versions 4, 5 and 7.3; the latter are HDF5 with reversed axes.

Besides readings, a file may list contacts or spikes: in a cell array of vectors, or in a field of
a structure array (or of a cell array of structures). Whole numbers are the ids of the sensors of
each contact; other numbers are the spike times of each channel. A matrix of four columns holds
``x y z id``, one row per sensor of a contact.

Source: The MathWorks (2024). MAT-File Level 5 File Format.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.files import open_regular
from anisomap.io.parsing.source import quote
from anisomap.io.recordings.events import Events, name_sensors, stream_events
from anisomap.io.recordings.hdf5 import Dataset, contents_of, open_datasets, stream_of
from anisomap.io.stream import Content, ReadOptions, Stream, choose

EXTRA = "mat"
MAGICS = (b"MATLAB 5.0 MAT-file", _MAGIC_73 := b"MATLAB 7.3 MAT-file")
"""First bytes of versions 5 and 7.3; version 4 has only its suffix."""

_KINDS = {
    "double": "f",
    "single": "f",
    "logical": "u",
    **{f"int{bits}": "i" for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": "u" for bits in (8, 16, 32, 64)},
}
_NUMBERS = "iuf"
_WITH_POINT = 4  # columns of x y z id


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the variables of a file."""
    with _open(path) as (lists, datasets):
        return _contents(lists, datasets)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open the variable `options.select`, or the only one of frames x sensors.

    Contacts and spikes may be in cell arrays, and in fields of structures (``torso/taxels``).
    """
    with _open(path) as (lists, datasets):
        if lists:
            name = choose(path, _contents(lists, datasets), options.select, "variable").name
            options = replace(options, select=name)
        listed = next((each for each in lists if each.name == options.select), None)
        if listed:
            stream = _stream_of_lists(path, listed, options.bin_s)
            yield replace(stream, source=f"{path.name}:{listed.name}")
        else:
            yield stream_of(path, datasets, options, {"format": "MATLAB"})


@dataclass(frozen=True, eq=False)
class _Lists:
    """Lists of numbers of different lengths, one per contact or channel.

    name: Name of the variable, with the field.
    contacts: Whether the lists are ids of sensors; otherwise they are times.
    """

    name: str
    lists: tuple[NDArray[np.float64], ...]
    contacts: bool

    @property
    def summary(self) -> str:
        """Description for display."""
        return f"{len(self.lists)} {'lists of sensors' if self.contacts else 'spike trains'}"


def _contents(lists: Sequence[_Lists], datasets: Sequence[Dataset]) -> tuple[Content, ...]:
    variables = {each.name.partition("/")[0] for each in lists}
    tables = [each for each in contents_of(datasets) if each.name not in variables]
    # Cell arrays beside readings may be of any kind.
    alone = not any(each.usable for each in tables)
    return (*(Content(each.name, each.summary, alone) for each in lists), *tables)


@contextmanager
def _open(path: Path) -> Iterator[tuple[list[_Lists], list[Dataset]]]:
    with open_regular(path) as stream:
        is_73 = stream.read(len(_MAGIC_73)) == _MAGIC_73
    if is_73:
        with open_datasets(path, EXTRA, frames_last=True) as datasets:
            yield [], datasets
        return
    listed = scipy.io.whosmat(path)
    datasets = [_dataset(path, *each) for each in listed]
    cells = [name for name, _, kind in listed if kind in ("cell", "struct")]
    yield _find_lists(_load(path, cells)) if cells else [], datasets


def _dataset(path: Path, name: str, shape: tuple[int, ...], kind: str) -> Dataset:
    return Dataset(name, tuple(shape), kind, _KINDS.get(kind, "V"), _reader(path, name))


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


def _find_lists(variables: dict[str, NDArray[Any]]) -> list[_Lists]:
    """Find the contacts and spike trains in cell arrays and structures."""
    return [found for name, value in variables.items() for found in _lists_in(name, value)]


def _lists_in(name: str, value: NDArray[Any]) -> Iterator[_Lists]:
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
        known = [vector for vector in vectors if vector is not None]
        if len(known) < len(entries) or max(map(len, known), default=0) < 2:
            continue
        values = np.concatenate(known)
        # Ids in float64 are exact up to 2^53, which no numbering of sensors reaches.
        whole = bool(((values >= 0) & (values == np.floor(values)) & (values < 2**53)).all())
        if whole or all((np.diff(vector) >= 0).all() for vector in known):
            yield _Lists(column, tuple(known), contacts=whole)


def _is_struct(item: Any) -> bool:
    return isinstance(item, np.ndarray) and item.dtype.names is not None


def _vector(item: Any) -> NDArray[np.float64] | None:
    """Return a vector as float64, the last column of ``x y z id``, or None for anything else."""
    if not isinstance(item, np.ndarray) or item.dtype.kind not in _NUMBERS or item.ndim != 2:
        return None
    values = item.astype(np.float64)
    if not values.size or 1 in values.shape:
        # A single row of four columns with fractions is a point with an id.
        fractions = bool((values[..., :3] % 1 != 0).any())
        return values[0, 3:] if values.shape == (1, _WITH_POINT) and fractions else values.ravel()
    return values[:, 3] if values.shape[1] == _WITH_POINT else None


def _stream_of_lists(path: Path, lists: _Lists, bin_s: float | None) -> Stream:
    """Create a stream of lists: a frame per contact, or counts of spikes in bins."""
    lengths = np.array([len(each) for each in lists.lists])
    values = np.concatenate(lists.lists)
    if not lists.contacts:
        names = tuple(f"channel{i + 1}" for i in range(len(lengths)))
        events = Events(values, np.repeat(np.arange(len(lengths)), lengths), names)
        return stream_events(
            path, events, bin_s=bin_s, spikes=True, metadata={"format": "spike trains"}
        )
    ids, sensors = np.unique(values.astype(np.int64), return_inverse=True)
    names, _ = name_sensors([str(each) for each in ids.tolist()], "taxel")
    # A contact without a sensor is a moment, too.
    rows = np.maximum(lengths, 1)
    active = np.full(rows.sum(), -1, dtype=np.intp)
    active[np.repeat(lengths > 0, rows)] = sensors
    return stream_events(
        path,
        Events(np.repeat(np.arange(float(len(lengths))), rows), active, names, timed=False),
        bin_s=bin_s,
        metadata={"format": "list of contacts", "variable": lists.name},
    )
