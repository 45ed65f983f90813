"""Sizes that the messages of an Arrow stream declare, read before pyarrow unpacks them.

A compressed buffer starts with its unpacked size, which pyarrow allocates before it decompresses;
no function of pyarrow reports it.

Layout: Arrow Columnar Format 1.5, "Encapsulated message format" and "Recordbatch message"; its
metadata are FlatBuffers tables, of which the few fields needed are read here.
"""

from __future__ import annotations

import io
import struct
from io import BufferedReader
from pathlib import Path

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


def unpacked_size(path: Path, stream: BufferedReader) -> int:
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
