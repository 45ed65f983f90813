"""Prepare files for rosbags: their suffix, missing message definitions, and missing indices.

A missing index, as interrupted recorders leave it, is rebuilt in memory and appended to the last
complete record; the file is not changed. No library does this: rosbags 0.11 rejects such files
("Bag is not indexed", "File end magic is invalid"), and ``rosbag reindex`` is part of ROS. The mcap
package scans unindexed MCAP files, but it would add a second way of decoding messages to replace
the 15 lines for MCAP.

Layouts: MCAP specification, and "Bag File Format, version 2.0" (ROS 1).
"""

from __future__ import annotations

import bz2
import io
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from anisomap.errors import FileError, import_extra
from anisomap.files import check_regular, open_regular, read_small

EXTRA = "ros"

_MCAP, _ROS1 = b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n"

MAGICS = {_ROS1: ".bag", _MCAP: ".mcap", b"SQLite format 3\0": ".db3"}
"""Magic numbers, and the suffixes that rosbags expects."""

METADATA = "metadata.yaml"
"""The file that makes a folder a bag of ROS 2."""

_MAX_DEFINITION = 1 << 17  # thousands of fields; rosbags reads 0.2 MB/s


def prepare(path: Path) -> tuple[Path, str]:
    """Return the path to open with rosbags, and what is lost of a bag that was cut, if it was."""
    if path.is_dir():
        for each in path.iterdir():
            check_regular(each)
        return path, ""
    with open_regular(path) as file:
        start = file.read(max(map(len, MAGICS)))
        suffix = next((s for magic, s in MAGICS.items() if start.startswith(magic)), path.suffix)
        find = {".mcap": _repair_mcap, ".bag": _repair_ros1}.get(suffix)
        repair, size = find(file) if find else None, file.seek(0, io.SEEK_END)
    overrides: dict[str, Any] = {"suffix": suffix}
    if find:
        overrides["open"] = lambda self, *_, **__: _BagFile(path, repair)
    lost = f"dropped the last {size - repair.end} of {size} bytes" if repair else ""
    return type("BagPath", (type(path),), overrides)(path), lost


def register_definitions(store: Any, files: Iterable[Path]) -> None:
    """Register message definitions from files in a type store."""
    typesys = import_extra("rosbags.typesys", "reading bags", EXTRA)
    for file in files:
        text = read_small(file, _MAX_DEFINITION, "a message definition")
        store.register(typesys.get_types_from_msg(text, _type_name(file)))


def _type_name(file: Path) -> str:
    package, _, name = file.stem.rpartition(".")
    if not package and file.parent.name == "msg":
        package = file.absolute().parent.parent.name
    if not package:
        raise FileError(
            f"the package of {file} is unknown; name the file PACKAGE/msg/NAME.msg or "
            "PACKAGE.NAME.msg"
        )
    return f"{package}/msg/{name}"


_MCAP_FOOTER = b"\x02\x14" + bytes(7) + bytes(20) + _MCAP
_MCAP_HEAD = 9
_INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 4, 5, 6, 7
_MAX_HEADER = 1 << 16


@dataclass(frozen=True)
class _Repair:
    """Replace the first bytes by `start`, keep the file up to `end`, and append `tail`."""

    start: bytes
    end: int
    tail: bytes


class _BagFile(io.BufferedReader):
    """A file, repaired if necessary, that limits reads to its size.

    Python allocates the requested number of bytes before reading, and a damaged length can request
    any number.
    """

    def __init__(self, path: Path, repair: _Repair | None) -> None:
        super().__init__(io.FileIO(path, "r") if repair is None else _Repaired(path, repair))
        self._size = self.seek(0, io.SEEK_END)
        self.seek(0)

    def read(self, size: int | None = -1) -> bytes:
        """Read at most `size` bytes."""
        left = max(self._size - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))


class _Repaired(io.RawIOBase):
    def __init__(self, path: Path, repair: _Repair) -> None:
        super().__init__()
        self._file = path.open("rb")
        self._repair = repair
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        size = self._repair.end + len(self._repair.tail)
        self._at = max({io.SEEK_SET: 0, io.SEEK_CUR: self._at}.get(whence, size) + offset, 0)
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        start, end = self._repair.start, self._repair.end
        if self._at < len(start):
            content = start[self._at : self._at + len(buffer)]
        elif self._at < end:
            self._file.seek(self._at)
            content = self._file.read(min(len(buffer), end - self._at))
        else:
            content = self._repair.tail[self._at - end : self._at - end + len(buffer)]
        buffer[: len(content)] = content
        self._at += len(content)
        return len(content)

    def close(self) -> None:
        self._file.close()
        super().close()


def _repair_mcap(file: BinaryIO) -> _Repair | None:
    size = file.seek(0, io.SEEK_END)
    file.seek(max(size - len(_MCAP), 0))
    if file.read() == _MCAP:
        return None
    end = len(_MCAP)
    while True:
        file.seek(end)
        head = file.read(_MCAP_HEAD)
        length = int.from_bytes(head[1:], "little")
        if len(head) < _MCAP_HEAD or end + _MCAP_HEAD + length > size:
            return _Repair(b"", end, _MCAP_FOOTER)
        end += _MCAP_HEAD + length


@dataclass(frozen=True)
class _Record:
    """A record of a ROS 1 bag: header fields, and the offsets of start, data and end."""

    start: int
    fields: dict[bytes, bytes]
    data: int
    end: int

    @property
    def kind(self) -> int:
        return self.number(b"op")

    def number(self, name: bytes) -> int:
        return int.from_bytes(self.fields.get(name, b""), "little")


@dataclass
class _Chunk:
    """A chunk of messages, with the counts per connection and the times in its index."""

    record: _Record
    counts: dict[int, int]
    times: list[int]


def _repair_ros1(file: BinaryIO) -> _Repair | None:
    size = file.seek(0, io.SEEK_END)
    head = _record(file, len(_ROS1), size)
    if head is None or not head.fields.keys() >= {b"index_pos", b"conn_count", b"chunk_count"}:
        return None  # without a bag header, nothing can be repaired
    n_indexed = head.number(b"conn_count") + head.number(b"chunk_count")
    index = head.number(b"index_pos")
    if index and sum(1 for _ in _records(file, index, size)) >= n_indexed:
        return None
    chunks, connections, end = _scan(file, head.end, size)
    tail = b"".join(connections.values()) + b"".join(map(_chunk_info, chunks))
    file.seek(0)
    start = file.read(head.data)
    for name, value, width in (
        (b"index_pos=", end, 8),
        (b"conn_count=", len(connections), 4),
        (b"chunk_count=", len(chunks), 4),
    ):
        at = start.index(name) + len(name)
        start = start[:at] + value.to_bytes(width, "little") + start[at + width :]
    return _Repair(start, end, tail)


def _scan(file: BinaryIO, start: int, size: int) -> tuple[list[_Chunk], dict[int, bytes], int]:
    """Return the indexed chunks, the connections of their messages, and the offset of their end."""
    chunks: list[_Chunk] = []
    connections: dict[int, bytes] = {}
    end = start
    for record in _records(file, start, size):
        if record.kind == _CHUNK:
            chunks.append(_Chunk(record, {}, []))
        elif record.kind == _INDEX and chunks:
            _take_index(file, record, chunks[-1])
            end = record.end
        else:
            break  # the rest is an incomplete index, which is rebuilt
    whole = [chunk for chunk in chunks if chunk.counts]
    for chunk in whole:
        if not connections.keys() >= chunk.counts.keys():
            connections |= _connections(file, chunk.record)
    return whole, connections, end


def _take_index(file: BinaryIO, record: _Record, chunk: _Chunk) -> None:
    count = record.number(b"count")
    file.seek(record.data + 4)
    entries = file.read(min(12 * count, record.end - record.data - 4))
    chunk.counts[record.number(b"conn")] = count
    # Seconds and nanoseconds of a stamp are combined in one integer for comparison.
    stamps = [struct.unpack_from("<II", entries, at) for at in range(0, len(entries) - 7, 12)]
    chunk.times += [seconds << 32 | nanoseconds for seconds, nanoseconds in stamps]


def _connections(file: BinaryIO, chunk: _Record) -> dict[int, bytes]:
    file.seek(chunk.data + 4)
    compressed = file.read(chunk.end - chunk.data - 4)
    compression = chunk.fields.get(b"compression", b"none").decode("latin-1")
    try:
        content = _decompress(compressed, compression)
    except (OSError, ValueError, EOFError, RuntimeError):  # of bz2 and lz4
        return {}
    inner = io.BytesIO(content)
    return {
        record.number(b"conn"): content[record.start : record.end]
        for record in _records(inner, 0, len(content))
        if record.kind == _CONNECTION
    }


def _decompress(compressed: bytes, compression: str) -> bytes:
    if compression == "lz4":
        content: bytes = import_extra("lz4.frame", "reading bags", EXTRA).decompress(compressed)
        return content
    return bz2.decompress(compressed) if compression == "bz2" else compressed


def _chunk_info(chunk: _Chunk) -> bytes:
    first, last = (
        struct.pack("<II", time >> 32, time & 0xFFFFFFFF)
        for time in (min(chunk.times, default=0), max(chunk.times, default=0))
    )
    fields = {
        b"op": bytes([_CHUNK_INFO]),
        b"ver": struct.pack("<I", 1),
        b"chunk_pos": struct.pack("<Q", chunk.record.start),
        b"start_time": first,
        b"end_time": last,
        b"count": struct.pack("<I", len(chunk.counts)),
    }
    parts = [name + b"=" + value for name, value in fields.items()]
    header = b"".join(struct.pack("<I", len(part)) + part for part in parts)
    data = b"".join(struct.pack("<II", *pair) for pair in chunk.counts.items())
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def _records(file: BinaryIO, start: int, size: int) -> Iterator[_Record]:
    """Yield records up to the first incomplete one."""
    while (record := _record(file, start, size)) is not None:
        yield record
        start = record.end


def _record(file: BinaryIO, start: int, size: int) -> _Record | None:
    if start >= size:
        return None
    file.seek(start)
    length = int.from_bytes(file.read(4), "little")
    if not 0 < length <= min(_MAX_HEADER, size - start - 8):
        return None
    header = file.read(length)
    data = start + 4 + length
    end = data + 4 + int.from_bytes(file.read(4), "little")
    if end > size:
        return None
    fields: dict[bytes, bytes] = {}
    at = 0
    while at + 4 < len(header):
        width = int.from_bytes(header[at : at + 4], "little")
        name, _, value = header[at + 4 : at + 4 + width].partition(b"=")
        fields[name] = value
        at += 4 + width
    return _Record(start, fields, data, end)
