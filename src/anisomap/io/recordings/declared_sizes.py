"""Sizes that Arrow messages and Parquet pages declare, read before pyarrow unpacks them.

A compressed buffer of Arrow, and a page of Parquet, start with their unpacked size, which pyarrow
allocates before it decompresses; no function of pyarrow reports it, and the sizes at the end of a
Parquet file need not agree. The places of the pages are read here as well, because pyarrow 26 ends
the process if it is asked for the metadata of a column whose size statistics do not fit its type.

Layouts: Arrow Columnar Format 1.5, "Encapsulated message format" and "Recordbatch message", whose
metadata are FlatBuffers tables; Apache Parquet format 2.10, `FileMetaData` and `PageHeader` in the
compact protocol of Apache Thrift. The few fields needed are read, and the rest is skipped.
"""

from __future__ import annotations

import io
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any, TypeAlias

from anisomap.io.parsing.source import DamagedError

_CONTINUATION = 0xFFFFFFFF
_DICTIONARY, _RECORD_BATCH = 2, 3
_HEADER_TYPE, _HEADER, _BODY_LENGTH = 1, 2, 3  # fields of Message
_BUFFERS, _COMPRESSION = 2, 3  # fields of RecordBatch
_DICTIONARY_DATA = 1  # field of DictionaryBatch
_NOT_COMPRESSED = -1


def is_last(stream: BufferedReader) -> bool:
    """Return whether a stream, at the start of a message, ends here; the position is kept."""
    start = stream.tell()
    ended = not _metadata(stream, _CONTINUATION)
    stream.seek(start)
    return ended


def batch_bytes(path: Path, stream: BufferedReader) -> int:
    """Return the unpacked size of the next record batch and the dictionaries before it."""
    start, total = stream.tell(), 0
    size = stream.seek(0, io.SEEK_END)
    stream.seek(start)
    try:
        while True:
            metadata = _metadata(stream, size)
            if not metadata:
                return total
            message = _Table.root(metadata)
            kind, body = message.number("b", _HEADER_TYPE), stream.tell()
            length = _checked_length(message.number("q", _BODY_LENGTH), size - body)
            if kind in (_DICTIONARY, _RECORD_BATCH):
                batch = message.table(_HEADER)
                if kind == _DICTIONARY:
                    batch = batch.table(_DICTIONARY_DATA)
                total += _batch_size(stream, batch, body)
            if kind == _RECORD_BATCH:
                return total
            stream.seek(body + length)
    except (struct.error, ValueError) as error:
        raise DamagedError(f"{path} is damaged or cut short: {error}") from error
    finally:
        stream.seek(start)


def _checked_length(length: int, left: int) -> int:
    if not 0 <= length <= left:
        raise ValueError("a message has no end")
    return length


def _metadata(stream: BufferedReader, size: int) -> bytes:
    """Read the metadata of a message; empty at the end of the stream."""
    length = int.from_bytes(stream.read(4), "little")
    if length == _CONTINUATION:  # absent before Arrow 0.15
        length = int.from_bytes(stream.read(4), "little")
    return stream.read(min(length, size))


def _batch_size(stream: BufferedReader, batch: _Table, body: int) -> int:
    """Return the sum of the sizes of all buffers of a batch, unpacked."""
    packed, total = batch.field(_COMPRESSION) != 0, 0
    for offset, length in batch.pairs(_BUFFERS):
        unpacked = length
        if packed and length:
            stream.seek(body + offset)
            (declared,) = struct.unpack("<q", stream.read(8))
            unpacked = length if declared == _NOT_COMPRESSED else declared
        if unpacked < 0:
            raise ValueError("a buffer has a negative size")
        total += unpacked
    return total


class _Table:
    """A table of FlatBuffers: an offset to its vtable, which holds the offsets of its fields."""

    def __init__(self, content: bytes, at: int) -> None:
        self._content, self._at = content, at
        self._vtable = at - self._unpack("i", at)
        if self._vtable < 0:
            raise ValueError("its metadata are not valid")

    @classmethod
    def root(cls, content: bytes) -> _Table:
        """Return the table that the first offset points to."""
        return cls(content, struct.unpack_from("<I", content)[0])

    def field(self, number: int) -> int:
        """Return the offset of a field; 0 if it is absent."""
        entry = 4 + 2 * number
        if entry >= self._unpack("H", self._vtable):
            return 0
        relative = self._unpack("H", self._vtable + entry)
        return self._at + relative if relative else 0

    def number(self, kind: str, number: int) -> int:
        """Return an integer field; 0 if it is absent."""
        at = self.field(number)
        return self._unpack(kind, at) if at else 0

    def table(self, number: int) -> _Table:
        """Return a table field."""
        return _Table(self._content, self._follow(number))

    def pairs(self, number: int) -> list[tuple[int, int]]:
        """Return a vector of pairs of 64-bit integers."""
        if not self.field(number):
            return []
        at = self._follow(number)
        count = self._unpack("I", at)
        content = self._content[at + 4 : at + 4 + 16 * count]
        return list(struct.iter_unpack("<qq", content))

    def _follow(self, number: int) -> int:
        at = self.field(number)
        if not at:
            raise ValueError("its metadata are not complete")
        return at + self._unpack("I", at)

    def _unpack(self, kind: str, at: int) -> int:
        value: int = struct.unpack_from(f"<{kind}", self._content, at)[0]
        return value


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


def page_bytes(path: Path, stream: BufferedReader, start: int, length: int) -> int:
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
