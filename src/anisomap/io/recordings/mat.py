"""MATLAB files of versions 4, 5 and 7.3; the latter are HDF5 with reversed axes.

Besides readings, a file may list contacts or spikes: in a cell array of vectors, or in a field of
a structure array (or of a cell array of structures). Whole numbers are the ids of the sensors of
each contact; other numbers are the spike times of each channel. A matrix of four columns holds
``x y z id``, one row per sensor of a contact.

scipy looks up the type of numeric data in a table without a check, so that a damaged type ends the
process. `_Matrix` follows the order in which `scipy.io.loadmat` reads, and leaves all other damage
to it.

Source: The MathWorks (2024). MAT-File Level 5 File Format.
"""

from __future__ import annotations

import functools
import io
import math
import struct
import warnings
import zlib
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import scipy
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.files import open_regular
from anisomap.io.parsing.source import library_errors, quote
from anisomap.io.recordings.events import Events, name_sensors, stream_events
from anisomap.io.recordings.hdf5 import Dataset, contents_of, open_datasets, stream_of
from anisomap.io.stream import Content, ReadOptions, Stream, choose
from anisomap.memory import DEFLATE_RATIO, Budget, bytes_kept

EXTRA = "mat"
MAGICS = (_MAGIC_5 := b"MATLAB 5.0 MAT-file", _MAGIC_73 := b"MATLAB 7.3 MAT-file")
"""First bytes of versions 5 and 7.3; version 4 has only its suffix."""

_HEADER_BYTES, _CHUNK = 128, 1 << 20
_MATRIX, _COMPRESSED = 14, 15
_NUMERIC_TYPES = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18})
_CELL, _STRUCT, _OBJECT, _CHAR, _SPARSE = 1, 2, 3, 4, 5
# Bytes per value of the classes of numbers.
_ITEM_BYTES = {6: 8, 7: 4, 8: 1, 9: 1, 10: 2, 11: 2, 12: 4, 13: 4, 14: 8, 15: 8}
_COMPLEX = 1 << 11
_MIN_DIMENSIONS = 2  # of every array of MATLAB
_MAX_DEPTH = 100  # of cells within cells; scipy recurses, too
_MAX_PARTS = 1 << 20  # of one cell array or structure
_TYPES = {
    "double": "f8",
    "single": "f4",
    "logical": "u1",
    **{f"int{bits}": f"i{bits // 8}" for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": f"u{bits // 8}" for bits in (8, 16, 32, 64)},
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
    budget = Budget(path)
    _check_sizes(path, budget)
    with library_errors(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        listed = scipy.io.whosmat(path)
    datasets = [_dataset(path, budget, *each) for each in listed]
    cells = [name for name, _, kind in listed if kind in ("cell", "struct")]
    yield _find_lists(_load(path, cells)) if cells else [], datasets


def _dataset(path: Path, budget: Budget, name: str, shape: tuple[int, ...], kind: str) -> Dataset:
    dtype = np.dtype(_TYPES.get(kind, "V"))
    size = math.prod(shape) * dtype.itemsize
    budget.check(size, f"variable {quote(name)}", reachable=DEFLATE_RATIO * budget.size)
    n_bytes = bytes_kept(dtype) if dtype.kind in _NUMBERS else dtype.itemsize
    return Dataset(name, tuple(shape), kind, dtype.kind, _reader(path, name), n_bytes)


def _reader(path: Path, name: str) -> Callable[[int, int], NDArray[Any]]:
    @functools.cache
    def loaded() -> NDArray[Any]:
        found = np.asarray(_load(path, [name])[name])
        if np.iscomplexobj(found):  # which the listing does not tell
            raise FileError(f"{path}: variable {quote(name)} is complex; readings are real")
        return found

    return lambda start, stop: loaded()[start:stop]


def _load(path: Path, names: list[str]) -> dict[str, Any]:
    """Load variables, after checking the types of all their data."""
    for matrix in _variables(path, Budget(path)):
        with suppress(_EndError):
            matrix.check(names)
    with library_errors(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = scipy.io.loadmat(path, variable_names=names)
        return {name: found[name] for name in names}


def _check_sizes(path: Path, budget: Budget) -> None:
    """Check the declared sizes of all variables of numbers, before scipy unpacks any of them."""
    for matrix in _variables(path, budget):
        with suppress(_EndError):
            kind, lengths, name = matrix.header()
            n_bytes = math.prod(max(0, n) for n in lengths) * _ITEM_BYTES.get(kind & 0xFF, 0)
            budget.check(n_bytes, f"variable {quote(name)}", reachable=DEFLATE_RATIO * budget.size)


def _variables(path: Path, budget: Budget) -> Iterator[_Matrix]:
    """Yield the variables of a file of version 5, unpacked within a budget; none of version 4."""
    with open_regular(path) as stream:
        header = stream.read(_HEADER_BYTES)
        if not header.startswith(_MAGIC_5):
            return
        order = "<" if header.endswith(b"IM") else ">"
        while len(tag := stream.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            after = stream.tell() + size
            source: BinaryIO = stream
            if kind == _COMPRESSED:
                source = io.BufferedReader(_Unpacked(stream, size, budget), _CHUNK)
                with suppress(_EndError):
                    kind = struct.unpack(f"{order}II", _read(source, 8))[0]
            if kind == _MATRIX:
                yield _Matrix(path, order, source)
            stream.seek(after)


class _EndError(Exception):
    """The data end within an element, or scipy reads no further."""


class _Unpacked(io.RawIOBase):
    """The decompressed bytes of an element of a file."""

    def __init__(self, stream: BinaryIO, size: int, budget: Budget) -> None:
        self._stream, self._left, self._budget = stream, size, budget
        self._unpacker = zlib.decompressobj()

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        content = b""
        while not content:
            packed = self._unpacker.unconsumed_tail
            if not packed:
                packed = self._stream.read(min(self._left, _CHUNK))
                self._left -= len(packed)
            if not packed:
                return 0
            try:
                content = self._unpacker.decompress(packed, len(buffer))
            except zlib.error as error:
                raise _EndError from error
        self._budget.spend(len(content), "its content")
        buffer[: len(content)] = content
        return len(content)


def _read(source: BinaryIO, size: int) -> bytes:
    content = source.read(size)
    if len(content) < size:
        raise _EndError
    return content


class _Matrix:
    """A variable and the matrices within it, read as scipy reads them."""

    def __init__(self, path: Path, order: str, source: BinaryIO) -> None:
        self._path, self._order, self._source = path, order, source

    def header(self) -> tuple[int, tuple[int, ...], str]:
        """Read the class and flags of a matrix, its lengths, and its name."""
        flags = struct.unpack(f"{self._order}4I", _read(self._source, 16))[2]
        lengths = self._integers()
        name = self._data().split(b"\0")[0].decode("latin-1")
        if len(lengths) < _MIN_DIMENSIONS:
            raise FileError(f"{self._path} is damaged: variable {quote(name)} has no shape")
        return flags, lengths, name

    def check(self, wanted: Collection[str] | None = None, depth: int = 0) -> None:
        """Check a matrix after its tag; skip it if its name is not a wanted one."""
        flags, lengths, name = self.header()
        if depth > _MAX_DEPTH or (wanted is not None and name not in wanted):
            return
        kind = flags & 0xFF
        if kind in _ITEM_BYTES or kind in (_CHAR, _SPARSE):
            for _ in range((3 if kind == _SPARSE else 1) + bool(flags & _COMPLEX)):
                self._check_numbers(name)
        elif kind in (_CELL, _STRUCT, _OBJECT):
            self._check_parts(kind, math.prod(max(0, length) for length in lengths), depth)

    def _check_parts(self, kind: int, n_parts: int, depth: int) -> None:
        """Check the matrices of a cell array, a structure or an object."""
        if kind == _OBJECT:
            self._data()  # the name of its class
        if kind != _CELL:
            (width,) = self._integers()[:1] or (0,)
            n_parts *= len(self._data()) // width if width > 0 else 0
        if n_parts > _MAX_PARTS:
            raise FileError(f"{self._path} is damaged: a variable has {n_parts} parts")
        for _ in range(n_parts):
            inner, size = struct.unpack(f"{self._order}II", _read(self._source, 8))
            if inner != _MATRIX:
                raise _EndError
            if size:
                self.check(depth=depth + 1)

    def _tag(self) -> tuple[int, int, bytes | None]:
        """Read the tag of an element: its type, its size, and its data if they are in the tag."""
        tag = _read(self._source, 8)
        first, size = struct.unpack(f"{self._order}II", tag)
        small = first >> 16
        return (first & 0xFFFF, small, tag[4 : 4 + small]) if small else (first, size, None)

    def _data(self) -> bytes:
        _, size, content = self._tag()
        if content is None:
            if size > _CHUNK:
                raise _EndError
            content = _read(self._source, size)
            self._skip(-size % 8)
        return content

    def _integers(self) -> tuple[int, ...]:
        content = self._data()
        return struct.unpack(f"{self._order}{len(content) // 4}i", content[: len(content) // 4 * 4])

    def _check_numbers(self, name: str) -> None:
        kind, size, content = self._tag()
        if kind not in _NUMERIC_TYPES:
            raise FileError(
                f"{self._path} is damaged: variable {quote(name)} has data of type {kind}"
            )
        if content is None:
            self._skip(size + -size % 8)

    def _skip(self, size: int) -> None:
        if self._source.seekable():
            self._source.seek(size, io.SEEK_CUR)
            return
        while size:
            size -= len(_read(self._source, min(size, _CHUNK)))


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
