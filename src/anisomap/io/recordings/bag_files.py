"""Prepare files for rosbags: their suffix, missing message definitions, and missing indices.

A missing index, as interrupted recorders leave it, is rebuilt in memory and appended to the last
complete record, because rosbags 0.11 rejects such files; the file is not changed.

Layouts: MCAP specification, and "Bag File Format, version 2.0" (ROS 1).
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError, import_extra
from anisomap.files.paths import check_regular, read_small

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
    with _BagFile(path) as file:
        start = file.read(max(map(len, MAGICS)))
        suffix = next((s for magic, s in MAGICS.items() if start.startswith(magic)), path.suffix)
        find = {".mcap": _repair_mcap, ".bag": _repair_ros1}.get(suffix)
        repair, size = find(file, file.size) if find else None, file.size
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
_LATEST = (1 << 32) * 10**9 - 1  # of the format, in nanoseconds


@dataclass(frozen=True)
class _Repair:
    """Replace the first bytes by `start`, keep the file up to `end`, and append `tail`."""

    start: bytes
    end: int
    tail: bytes


class _BagFile(io.BufferedReader):
    """A file, perhaps repaired, that limits reads to its size: Python allocates before it reads."""

    def __init__(self, path: Path, repair: _Repair | None = None) -> None:
        super().__init__(io.FileIO(path, "r") if repair is None else _Repaired(path, repair))
        self.size = self.seek(0, io.SEEK_END)
        self.seek(0)

    def read(self, size: int | None = -1) -> bytes:
        """Read at most `size` bytes."""
        left = max(self.size - self.tell(), 0)
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


def _repair_mcap(file: BinaryIO, size: int) -> _Repair | None:
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


class _Record(NamedTuple):
    """A record of a ROS 1 bag: header fields, and the offsets of start, data and end."""

    start: int
    fields: Any
    data: int
    end: int


def _records(file: BinaryIO, start: int, size: int) -> Iterator[_Record]:
    """Yield records up to the first incomplete one."""
    library = _library("reader")
    with suppress(library.ReaderError, ValueError):
        while start < size:
            file.seek(start)
            fields = library.Header.read(file)
            length = library.read_uint32(file)
            record = _Record(start, fields, file.tell(), file.tell() + length)
            if not fields or record.end > size:
                return
            yield record
            start = record.end


def _library(module: str) -> Any:
    return import_extra(f"rosbags.rosbag1.{module}", "reading bags", EXTRA)


def _repair_ros1(file: BinaryIO, size: int) -> _Repair | None:
    head = next(_records(file, len(_ROS1), size), None)
    counted = ("conn_count", "chunk_count")
    if head is None or not head.fields.keys() >= {"index_pos", *counted}:
        return None  # without a bag header, nothing can be repaired
    n_indexed = sum(head.fields.get_uint32(name) for name in counted)
    index = head.fields.get_uint64("index_pos")
    if index and sum(1 for _ in _records(file, index, size)) >= n_indexed:
        return None
    end, infos, connections = _scan(file, head.end, size)
    file.seek(0)
    start = file.read(head.data)
    for name, value, width in (
        (b"index_pos=", end, 8),
        (b"conn_count=", len(connections), 4),
        (b"chunk_count=", len(infos), 4),
    ):
        at = start.index(name) + len(name)
        start = start[:at] + value.to_bytes(width, "little") + start[at + width :]
    return _Repair(start, end, b"".join([*connections.values(), *infos]))


def _scan(file: BinaryIO, start: int, size: int) -> tuple[int, list[bytes], dict[int, bytes]]:
    """Return the end of the indexed chunks, their records of the index, and the connections."""
    kinds = _library("reader").RecordType
    end, chunks = start, list[tuple[_Record, dict[int, NDArray[np.int64]]]]()
    for record in _records(file, start, size):
        kind = int.from_bytes(record.fields.get("op", b""), "little")
        if kind == kinds.CHUNK:
            chunks.append((record, {}))
        elif kind == kinds.IDXDATA and chunks:
            file.seek(record.data)
            entries = file.read((record.end - record.data) // 12 * 12)
            stamps = np.frombuffer(entries, "<u4").reshape(-1, 3).astype(np.int64)
            times = stamps[:, 0] * 10**9 + stamps[:, 1]
            chunks[-1][1][record.fields.get_uint32("conn")] = times
            end = record.end
        else:
            break  # the rest is an incomplete index, which is rebuilt
    infos, connections = list[bytes](), dict[int, bytes]()
    for record, indexed in chunks:
        if indexed:
            infos.append(_chunk_info(record.start, indexed))
            if not connections.keys() >= indexed.keys():
                connections |= _connections(file, record)
    return end, infos, connections


def _connections(file: BinaryIO, chunk: _Record) -> dict[int, bytes]:
    library = _library("reader")
    file.seek(chunk.data)
    packed = file.read(chunk.end - chunk.data)
    try:
        content = library.decompressors[chunk.fields.get_string("compression")](packed)
    except (OSError, ValueError, EOFError, RuntimeError, KeyError):  # of bz2 and lz4
        return {}
    found = _records(io.BytesIO(content), 0, len(content))
    kind = bytes([library.RecordType.CONNECTION])
    return {
        record.fields.get_uint32("conn"): content[record.start : record.end]
        for record in found
        if record.fields.get("op") == kind
    }


def _chunk_info(start: int, indexed: dict[int, NDArray[np.int64]]) -> bytes:
    header, times = _library("writer").Header(), np.concatenate([*indexed.values()])
    header.set_uint32("ver", 1)
    header.set_uint64("chunk_pos", start)
    header.set_time("start_time", int(times.min(initial=_LATEST)))
    header.set_time("end_time", int(times.max(initial=0)))
    header.set_uint32("count", len(indexed))
    info = io.BytesIO()
    header.write(info, _library("reader").RecordType.CHUNK_INFO)
    counts = b"".join(struct.pack("<II", name, len(each)) for name, each in indexed.items())
    return info.getvalue() + struct.pack("<I", len(counts)) + counts
