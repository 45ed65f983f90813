"""Check the elements of a MATLAB file (version 5) before scipy reads them.

scipy looks up the type of numeric data in a table without a check, so that a damaged type ends the
process. The walk below follows the order in which `scipy.io.loadmat` reads, and leaves all other
damage to it.

Source: The MathWorks (2024). MAT-File Level 5 File Format.

Contacts and spike trains in cell arrays and structures of MATLAB.

A cell array of vectors, or a field of a structure array (or of a cell array of structures), holds
either the ids of the sensors of each contact, which are whole numbers, or the spike times of each
channel. A matrix of four columns holds ``x y z id``, one row per sensor of a contact.

MATLAB files of versions 4, 5 and 7.3; the latter are HDF5 with reversed axes.
"""

from __future__ import annotations

import functools
import math
import struct
import warnings
import zlib
from collections.abc import Iterator, Sequence
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

_MAGIC = b"MATLAB 5.0 MAT-file"
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


class _EndError(Exception):
    """The data end within an element, or scipy reads no further."""


class _Raw:
    """The bytes of a file from its present position."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def read(self, size: int) -> bytes:
        content = self._stream.read(size)
        if len(content) < size:
            raise _EndError
        return content

    def skip(self, size: int) -> None:
        self._stream.seek(size, 1)


class _Unpacked:
    """The decompressed bytes of an element of a file."""

    def __init__(self, stream: BinaryIO, size: int) -> None:
        self._stream, self._left = stream, size
        self._unpacker, self._buffer = zlib.decompressobj(), b""

    def read(self, size: int) -> bytes:
        parts = []
        while size:
            part = self._some(size)
            parts.append(part)
            size -= len(part)
        return b"".join(parts)

    def skip(self, size: int) -> None:
        while size:
            size -= len(self._some(size))

    def _some(self, size: int) -> bytes:
        """Return at least one byte, and at most `size`."""
        while not self._buffer:
            packed = self._unpacker.unconsumed_tail
            if not packed:
                packed = self._stream.read(min(self._left, _CHUNK))
                self._left -= len(packed)
            if not packed:
                raise _EndError
            try:
                self._buffer = self._unpacker.decompress(packed, _CHUNK)
            except zlib.error as error:
                raise _EndError from error
        part, self._buffer = self._buffer[:size], self._buffer[size:]
        return part


def check_sizes(path: Path, budget: Budget) -> None:
    """Check the declared sizes of all variables of numbers, before scipy unpacks any of them."""
    for matrix in _variables(path):
        with suppress(_EndError):
            kind, lengths, name = matrix.header()
            n_bytes = math.prod(max(0, n) for n in lengths) * _ITEM_BYTES.get(kind & 0xFF, 0)
            budget.check(n_bytes, f"variable {quote(name)}", reachable=DEFLATE_RATIO * budget.size)


def check_variable(path: Path, name: str) -> None:
    """Check the types of all data of a variable."""
    for matrix in _variables(path):
        with suppress(_EndError):
            matrix.check(name)


def _variables(path: Path) -> Iterator[_Matrix]:
    """Yield the variables of a file of version 5; none of other versions."""
    with open_regular(path) as stream:
        header = stream.read(_HEADER_BYTES)
        if not header.startswith(_MAGIC):
            return  # version 4
        order = "<" if header.endswith(b"IM") else ">"
        while len(tag := stream.read(8)) == 8:
            kind, size = struct.unpack(f"{order}II", tag)
            after = stream.tell() + size
            source: _Raw | _Unpacked = _Raw(stream)
            if kind == _COMPRESSED:
                source = _Unpacked(stream, size)
            if kind == _COMPRESSED:
                with suppress(_EndError):
                    kind = struct.unpack(f"{order}II", source.read(8))[0]
            if kind == _MATRIX:
                yield _Matrix(path, order, source)
            stream.seek(after)


class _Matrix:
    """A variable and the matrices within it, read as scipy reads them."""

    def __init__(self, path: Path, order: str, source: _Raw | _Unpacked) -> None:
        self._path, self._order, self._source = path, order, source

    def header(self) -> tuple[int, tuple[int, ...], str]:
        """Read the class and flags of a matrix, its lengths, and its name."""
        flags = struct.unpack(f"{self._order}4I", self._source.read(16))[2]
        lengths = self._integers()
        name = self._data().split(b"\0")[0].decode("latin-1")
        if len(lengths) < _MIN_DIMENSIONS:
            raise FileError(f"{self._path} is damaged: variable {quote(name)} has no shape")
        return flags, lengths, name

    def check(self, wanted: str | None = None, depth: int = 0) -> None:
        """Check a matrix after its tag; skip it if its name is not the wanted one."""
        flags, lengths, name = self.header()
        if depth > _MAX_DEPTH or wanted not in (None, name):
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
            inner, size = struct.unpack(f"{self._order}II", self._source.read(8))
            if inner != _MATRIX:
                raise _EndError
            if size:
                self.check(depth=depth + 1)

    def _tag(self) -> tuple[int, int, bytes | None]:
        """Read the tag of an element: its type, its size, and its data if they are in the tag."""
        tag = self._source.read(8)
        first, size = struct.unpack(f"{self._order}II", tag)
        small = first >> 16
        return (first & 0xFFFF, small, tag[4 : 4 + small]) if small else (first, size, None)

    def _data(self) -> bytes:
        _, size, content = self._tag()
        if content is None:
            if size > _CHUNK:
                raise _EndError
            content = self._source.read(size)
            self._source.skip(-size % 8)
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
            self._source.skip(size + -size % 8)


_NUMBERS = "iuf"
_WITH_POINT = 4


@dataclass(frozen=True, eq=False)
class Lists:
    """Lists of numbers of different lengths.

    name: Name of the variable, with the field.
    lists: One per contact or channel.
    contacts: Whether the lists are ids of sensors; otherwise they are times.
    """

    name: str
    lists: tuple[NDArray[np.float64], ...]
    contacts: bool

    @property
    def summary(self) -> str:
        """Description for display."""
        return f"{len(self.lists)} {'lists of sensors' if self.contacts else 'spike trains'}"


def find_lists(name: str, value: NDArray[Any]) -> tuple[Lists, ...]:
    """Find the lists of contacts or spikes in a variable."""
    items = [*value.ravel()]
    if value.dtype.names is None and all(_is_struct(item) for item in items):
        items = [item.ravel()[0] for item in items if item.size == 1]
        fields = items[0].dtype.names if items and len(items) == value.size else ()
        same = all(item.dtype.names == fields for item in items)
        return _of_fields(name, items, fields or ()) if same else ()
    if value.dtype.names is not None:
        return _of_fields(name, items, value.dtype.names)
    found = _lists(name, items)
    return (found,) if found else ()


def stream_lists_of(path: Path, lists: Lists, bin_s: float | None) -> Stream:
    """Create a stream of lists: a frame per contact, or counts of spikes in bins."""
    lengths = [len(each) for each in lists.lists]
    values = np.concatenate(lists.lists)
    if not lists.contacts:
        names = tuple(f"channel{i + 1}" for i in range(len(lengths)))
        events = Events(values, np.repeat(np.arange(len(lengths)), lengths), names)
        return stream_events(
            path, events, bin_s=bin_s, spikes=True, metadata={"format": "spike trains"}
        )
    ids, sensors = np.unique(values.astype(np.int64), return_inverse=True)
    names, _ = name_sensors([str(each) for each in ids.tolist()], "taxel")
    moments = np.repeat(np.arange(float(len(lengths))), np.maximum(lengths, 1))
    active = np.full(len(moments), -1, dtype=np.intp)
    active[np.repeat(np.array(lengths) > 0, np.maximum(lengths, 1))] = sensors
    return stream_events(
        path,
        Events(moments, active, names, timed=False),
        bin_s=bin_s,
        metadata={"format": "list of contacts", "variable": lists.name},
    )


def _is_struct(item: Any) -> bool:
    return isinstance(item, np.ndarray) and item.dtype.names is not None


def _of_fields(name: str, items: Sequence[Any], fields: Sequence[str]) -> tuple[Lists, ...]:
    found = (_lists(f"{name}/{field}", [item[field] for item in items]) for field in fields)
    return tuple(each for each in found if each)


def _lists(name: str, items: Sequence[Any]) -> Lists | None:
    vectors = [_vector(item) for item in items]
    known = [vector for vector in vectors if vector is not None]
    if len(known) < len(items) or max(map(len, known), default=0) < 2:
        return None
    values = np.concatenate(known)
    # Ids in float64 are exact up to 2^53, which no numbering of sensors reaches.
    whole = bool(((values >= 0) & (values == np.floor(values)) & (values < 2**53)).all())
    times = all((np.diff(vector) >= 0).all() for vector in known)
    return Lists(name, tuple(known), contacts=whole) if whole or times else None


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


EXTRA = "mat"

_MAGIC_MAT, _MAGIC_73 = b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file"
_HEADER_BYTES_MAT, _COMPRESSED_MAT = 128, 15  # of version 5
_CHUNK_MAT = 1 << 20
_TYPES = {
    "double": "f8",
    "single": "f4",
    "logical": "u1",
    **{f"int{bits}": f"i{bits // 8}" for bits in (8, 16, 32, 64)},
    **{f"uint{bits}": f"u{bits // 8}" for bits in (8, 16, 32, 64)},
}


def recognises(path: Path, head: bytes) -> bool:
    """Recognise versions 5 and 7.3 by their headers; version 4 has none, only its suffix."""
    return head.startswith((_MAGIC_MAT, _MAGIC_73))


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the variables of a file."""
    with _open(path) as datasets:
        lists = _lists_mat(path)
        variables = {each.name.partition("/")[0] for each in lists}
        tables = [each for each in contents_of(datasets) if each.name not in variables]
        # Cell arrays beside readings may be of any kind.
        alone = not any(each.usable for each in tables)
        return (*(Content(each.name, each.summary, alone) for each in lists), *tables)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open the variable `options.select`, or the only one of frames x sensors.

    Contacts and spikes may be in cell arrays, and in fields of structures (``torso/taxels``).
    """
    lists = _lists_mat(path)
    if lists:
        name = choose(path, contents(path, options), options.select, "variable").name
        for each in lists:
            if each.name == name:
                stream = stream_lists_of(path, each, options.bin_s)
                yield replace(stream, source=f"{path.name}:{name}")
                return
        options = replace(options, select=name)
    with _open(path) as datasets:
        yield stream_of(path, datasets, options, {"format": "MATLAB"})


@contextmanager
def _open(path: Path) -> Iterator[list[Dataset]]:
    with open_regular(path) as stream:
        is_73 = stream.read(len(_MAGIC_73)) == _MAGIC_73
    if is_73:
        with open_datasets(path, EXTRA, frames_last=True) as datasets:
            yield datasets
        return
    yield _variables_mat(path)


def _lists_mat(path: Path) -> list[Lists]:
    """Find the contacts and spike trains in cell arrays and structures; none in version 7.3."""
    with open_regular(path) as stream:
        if not stream.read(len(_MAGIC_MAT)).startswith(_MAGIC_MAT):
            return []
    check_sizes(path, Budget(path))
    with library_errors(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        names = [name for name, _, kind in scipy.io.whosmat(path) if kind in ("cell", "struct")]
    if not names:
        return []
    _check_unpacked(path)
    with library_errors(path):
        return [
            found for name in names for found in find_lists(name, _reader(path, name)(None, None))
        ]


def _check_unpacked(path: Path) -> None:
    """Reject variables that expand too far: their headers do not give the size of a cell array."""
    budget = Budget(path)
    with open_regular(path) as stream, library_errors(path):
        order = "<" if stream.read(_HEADER_BYTES_MAT)[-2:] == b"IM" else ">"
        while len(tag := stream.read(8)) == 8:
            kind, n_bytes = struct.unpack(f"{order}II", tag)
            if kind != _COMPRESSED_MAT:
                stream.seek(n_bytes, 1)
                continue
            unpacker, left = zlib.decompressobj(), n_bytes
            while left and (packed := stream.read(min(left, _CHUNK_MAT))):
                left -= len(packed)
                while packed:
                    budget.spend(len(unpacker.decompress(packed, _CHUNK_MAT)), "its content")
                    packed = unpacker.unconsumed_tail


def _variables_mat(path: Path) -> list[Dataset]:
    found, budget = [], Budget(path)
    check_sizes(path, budget)
    with library_errors(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        listed = scipy.io.whosmat(path)
    for name, shape, kind in listed:
        dtype = np.dtype(_TYPES.get(kind, "V"))
        size = math.prod(shape) * dtype.itemsize
        budget.check(size, f"variable {name}", reachable=DEFLATE_RATIO * budget.size)
        n_bytes = bytes_kept(dtype) if dtype.kind in _NUMBERS else dtype.itemsize
        found.append(Dataset(name, tuple(shape), kind, dtype.kind, _reader(path, name), n_bytes))
    return found


def _reader(path: Path, name: str) -> Any:
    @functools.cache
    def loaded() -> NDArray[Any]:
        check_variable(path, name)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = np.asarray(scipy.io.loadmat(path, variable_names=[name])[name])
        if np.iscomplexobj(found):  # which the listing does not tell
            raise FileError(f"{path}: variable {quote(name)} is complex; readings are real")
        return found

    return lambda start, stop: loaded()[start:stop]
