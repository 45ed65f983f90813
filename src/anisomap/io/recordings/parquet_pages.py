"""Sizes that a Parquet file declares, read before pyarrow unpacks its pages.

A page starts with its unpacked size, which pyarrow allocates before it decompresses; the sizes at
the end of the file need not agree, and no function of pyarrow reports those of the pages. The
places of the pages are read here as well, because pyarrow 26 ends the process if it is asked for
the metadata of a column whose size statistics do not fit its type.

Layout: Apache Parquet format 2.10, `FileMetaData` and `PageHeader` in the compact protocol of
Apache Thrift, of which the sizes are read and the rest is skipped.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any, TypeAlias

from anisomap.io.parsing.source import DamagedError

_UNPACKED, _PACKED = 2, 3  # fields of PageHeader
_ROW_GROUPS, _COLUMNS, _COLUMN_METADATA = 4, 1, 3  # of FileMetaData, RowGroup and ColumnChunk
_N_VALUES, _LENGTH, _DATA_PAGE, _DICTIONARY_PAGE = 5, 7, 9, 11  # of ColumnMetaData
_LENGTH_BYTES, _MAGIC_BYTES = 4, 4  # at the end of the file, after FileMetaData
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


_Wanted: TypeAlias = Mapping[int, Any]
"""Fields whose structs are kept, each with those that are kept in them; integers always are."""

_FOOTER: _Wanted = {_ROW_GROUPS: {_COLUMNS: {_COLUMN_METADATA: {}}}}


@dataclass(frozen=True)
class ColumnChunk:
    """The values of a column in a row group.

    n_values: Number of values, at least 0.
    start, length: Where its pages are in the file, in bytes.
    """

    n_values: int
    start: int
    length: int


def column_chunks(path: Path, stream: BufferedReader) -> list[list[ColumnChunk]]:
    """Read where the columns are, from the end of a file."""
    stream.seek(-_LENGTH_BYTES - _MAGIC_BYTES, io.SEEK_END)
    end = stream.tell()
    length = int.from_bytes(stream.read(_LENGTH_BYTES), "little")
    stream.seek(max(0, end - length))
    try:
        footer, _ = _struct(stream.read(length), _FOOTER)
        return [
            [_chunk(column[_COLUMN_METADATA]) for column in group[_COLUMNS]]
            for group in footer[_ROW_GROUPS]
        ]
    except (KeyError, TypeError, IndexError, ValueError) as error:  # fields missing, of other types
        raise DamagedError(f"{path} is damaged: its row groups are not described") from error


def _chunk(fields: Mapping[int, int]) -> ColumnChunk:
    offsets = fields[_DATA_PAGE], fields.get(_DICTIONARY_PAGE, 0)
    start = min((offset for offset in offsets if offset > 0), default=0)
    return ColumnChunk(max(0, fields[_N_VALUES]), start, fields[_LENGTH])


def unpacked_size(path: Path, stream: BufferedReader, start: int, length: int) -> int:
    """Return the sum of the unpacked sizes of the pages of a column."""
    total, at = 0, start
    while at < start + length:
        stream.seek(at)
        header = stream.read(_HEADER_BYTES)
        if not header:
            break  # pyarrow reports that the file is cut short
        try:
            fields, n_bytes = _struct(header)
        except IndexError:
            stream.seek(at)
            try:
                fields, n_bytes = _struct(stream.read(_MAX_HEADER_BYTES))
            except IndexError:
                raise DamagedError(f"{path} is damaged: the header of a page is cut") from None
        except ValueError as error:
            raise DamagedError(f"{path} is damaged: the header of a page has {error}") from error
        total += max(0, fields.get(_UNPACKED, 0))
        at += n_bytes + max(0, fields.get(_PACKED, 0))
    return total


def _struct(content: bytes, wanted: _Wanted | None = None) -> tuple[dict[int, Any], int]:
    """Return the fields of a struct by their numbers, and its size in bytes."""
    reader = _Compact(content)
    return reader.struct(0, wanted or {}), reader.at


class _Compact:
    """Values in the compact protocol; beyond the end of the content, an IndexError."""

    def __init__(self, content: bytes) -> None:
        self._content = content
        self.at = 0

    def struct(self, depth: int, wanted: _Wanted | None) -> dict[int, Any]:
        """Read a struct: its integers and the fields that are wanted; none to skip it."""
        found: dict[int, Any] = {}
        number = 0
        while kind := self._byte():
            step, kind = kind >> 4, kind & 15
            number = number + step if step else self._integer()
            value = self._value(kind, depth, None if wanted is None else wanted.get(number))
            if wanted is not None and value is not None:
                found[number] = value
        return found

    def _value(self, kind: int, depth: int, wanted: _Wanted | None) -> Any:
        """Return an integer, a struct or a list of structs; skip any other value."""
        if depth > _MAX_DEPTH:
            raise ValueError("too many nested values")
        if kind in _INTEGERS:
            return self._integer()
        if kind == _STRUCT:
            fields = self.struct(depth + 1, wanted)
            return None if wanted is None else fields
        if kind in _LISTS:
            return self._list(depth, wanted)
        if kind in {_BYTE, _DOUBLE, _BINARY}:
            self._skip({_BYTE: 1, _DOUBLE: 8}.get(kind) or self._varint())
        elif kind not in _BOOLEANS:
            raise ValueError(f"a value of type {kind}")
        return None

    def _list(self, depth: int, wanted: _Wanted | None) -> Sequence[Any] | None:
        start = self._byte()
        length, kind = start >> 4 if start >> 4 < 15 else self._varint(), start & 15
        kept = []
        for _ in range(length):
            if kind in _BOOLEANS:
                self._skip(1)
            elif wanted is not None and kind == _STRUCT:
                kept.append(self.struct(depth + 1, wanted))
            else:
                self._value(kind, depth + 1, None)
        return None if wanted is None else kept

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
