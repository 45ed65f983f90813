"""Sizes that the pages of a Parquet file declare, read before pyarrow unpacks them.

A page starts with its unpacked size, which pyarrow allocates before it decompresses; the sizes at
the end of the file need not agree, and no function of pyarrow reports those of the pages.

Layout: Apache Parquet format 2.10, `PageHeader` in the compact protocol of Apache Thrift, of which
the sizes are read and the rest is skipped.
"""

from __future__ import annotations

from io import BufferedReader
from pathlib import Path

from anisomap.io.parsing.libraries import DamagedError

_UNPACKED, _PACKED = 2, 3  # fields of PageHeader
_HEADER_BYTES, _MAX_HEADER_BYTES = 1 << 7, 1 << 24  # usual; the limit of pyarrow
_MAX_DEPTH, _VARINT_BYTES = 16, 10  # of nested values; of an integer of 64 bits

# Types of the compact protocol. Values of booleans are in their types.
_BOOLEANS, _BYTE, _INTEGERS, _DOUBLE, _BINARY, _LISTS, _STRUCT = (
    {1, 2},
    3,
    {4, 5, 6},
    7,
    8,
    {9, 10},
    12,
)


def unpacked_size(path: Path, stream: BufferedReader, start: int, length: int) -> int:
    """Return the sum of the unpacked sizes of the pages of a column.

    Parameters
    ----------
    path : pathlib.Path
        The file, for messages.
    stream : io.BufferedReader
        The position changes.
    start, length : int
        Where the pages are, in bytes.

    Returns
    -------
    int
        In bytes.

    Raises
    ------
    DamagedError
        If the header of a page is not valid.
    """
    total, at = 0, start
    while at < start + length:
        stream.seek(at)
        header = stream.read(_HEADER_BYTES)
        if not header:
            break  # pyarrow reports that the file is cut short
        try:
            fields, n_bytes = _header(header)
        except IndexError:
            stream.seek(at)
            try:
                fields, n_bytes = _header(stream.read(_MAX_HEADER_BYTES))
            except IndexError:
                raise DamagedError(f"{path} is damaged: the header of a page is cut") from None
        except ValueError as error:
            raise DamagedError(f"{path} is damaged: the header of a page has {error}") from error
        total += max(0, fields.get(_UNPACKED, 0))
        at += n_bytes + max(0, fields.get(_PACKED, 0))
    return total


def _header(content: bytes) -> tuple[dict[int, int], int]:
    """Return the integers of a struct, by the numbers of their fields, and its size in bytes."""
    reader = _Compact(content)
    return reader.struct(0), reader.at


class _Compact:
    """Values in the compact protocol; beyond the end of the content, an IndexError."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self.at = 0

    def struct(self, depth: int) -> dict[int, int]:
        found: dict[int, int] = {}
        number = 0
        while kind := self._byte():
            step, kind = kind >> 4, kind & 15
            number = number + step if step else self._integer()
            value = self._value(kind, depth)
            if value is not None:
                found[number] = value
        return found

    def _value(self, kind: int, depth: int) -> int | None:
        """Return an integer; skip any other value."""
        if depth > _MAX_DEPTH:
            raise ValueError("too many nested values")
        if kind in _INTEGERS:
            return self._integer()
        if kind == _STRUCT:
            self.struct(depth + 1)
        elif kind in _LISTS:
            start = self._byte()
            length = start >> 4 if start >> 4 < 15 else self._varint()
            for _ in range(length):
                if start & 15 in _BOOLEANS:
                    self._skip(1)
                else:
                    self._value(start & 15, depth + 1)
        elif kind in {_BYTE, _DOUBLE, _BINARY}:
            self._skip({_BYTE: 1, _DOUBLE: 8}.get(kind) or self._varint())
        elif kind not in _BOOLEANS:
            raise ValueError(f"a value of type {kind}")
        return None

    def _byte(self) -> int:
        self.at += 1
        return self._content[self.at - 1]

    def _skip(self, n_bytes: int) -> None:
        self.at += n_bytes
        if self.at > len(self._content):
            raise IndexError

    def _varint(self) -> int:
        value = 0
        for i in range(_VARINT_BYTES):
            byte = self._byte()
            value |= (byte & 127) << 7 * i
            if byte < 128:
                return value
        raise ValueError("an integer of more than 64 bits")

    def _integer(self) -> int:
        value = self._varint()
        return value >> 1 ^ -(value & 1)  # zigzag
