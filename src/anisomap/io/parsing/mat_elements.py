"""Check the elements of a MATLAB file (version 5) before scipy reads them.

scipy looks up the type of numeric data in a table without a check, so that a damaged type ends the
process. The walk below follows the order in which `scipy.io.loadmat` reads, and leaves all other
damage to it.

Source: The MathWorks (2024). MAT-File Level 5 File Format.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from anisomap.budget import DEFLATE_RATIO, Budget
from anisomap.errors import FileError
from anisomap.files import open_regular
from anisomap.io.parsing.source import quote

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
    """Check the declared sizes of all variables of numbers, before scipy unpacks any of them.

    Parameters
    ----------
    path : pathlib.Path
    budget : Budget

    Raises
    ------
    FileError
        If a variable is larger than the budget.
    """
    for matrix in _variables(path):
        with suppress(_EndError):
            kind, lengths, name = matrix.header()
            n_bytes = math.prod(max(0, n) for n in lengths) * _ITEM_BYTES.get(kind & 0xFF, 0)
            budget.check(n_bytes, f"variable {quote(name)}", reachable=DEFLATE_RATIO * budget.size)


def check_variable(path: Path, name: str) -> None:
    """Check the types of all data of a variable.

    Parameters
    ----------
    path : pathlib.Path
    name : str
        All variables of this name are checked.

    Raises
    ------
    FileError
        If data have an unknown type.
    """
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
