"""What rosbags has to be told about files: their kind, missing definitions, missing ends."""

from __future__ import annotations

import io
import warnings
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from anisomap.errors import AnisomapWarning, FileError
from anisomap.formats.foreign import imported
from anisomap.formats.source import check_unpacked

EXTRA = "ros"

MAGICS = {b"#ROSBAG V2.0\n": ".bag", b"\x89MCAP0\r\n": ".mcap", b"SQLite format 3\0": ".db3"}
"""The first bytes of bags, and the suffix by which rosbags knows them."""

_MCAP = b"\x89MCAP0\r\n"
_FOOTER = b"\x02\x14" + bytes(7) + bytes(20) + _MCAP
_RECORD_HEAD = 9


def disguised(path: Path) -> Path:
    """Give a path that has the suffix rosbags expects, and opens as a file with an end.

    Parameters
    ----------
    path : pathlib.Path
        A bag, whatever its suffix; a folder is left as it is.
    """
    if path.is_dir():
        return path
    start = _start(path)
    suffix = next((kind for magic, kind in MAGICS.items() if start.startswith(magic)), path.suffix)
    known: dict[str, Any] = {"suffix": suffix}
    if suffix != ".db3":
        is_cut = suffix == ".mcap" and not _has_end(path)
        known["open"] = lambda self, *_, **__: _BagFile(
            _WithEnd(path) if is_cut else _unbuffered(path)
        )
    named: Path = type("BagPath", (type(path),), known)(path)
    return named


def warn_of_missing_end(path: Path) -> None:
    """Warn of an MCAP file that was cut off, and say how much of it is lost."""
    if path.is_dir() or _start(path)[: len(_MCAP)] != _MCAP or _has_end(path):
        return
    size = path.stat().st_size
    warnings.warn(
        f"{path} was cut off: its last {size - _end_of_records(path)} of {size} bytes are no "
        "whole record, and lost; what follows in the original is lost, too",
        AnisomapWarning,
        stacklevel=2,
    )


def with_definitions(store: Any, files: Iterable[Path]) -> Any:
    """Teach a store of message types the definitions in files.

    Parameters
    ----------
    store : rosbags.typesys.store.Typestore
    files : iterable of pathlib.Path
        Each a ``.msg`` file in a folder ``package/msg``, or with the package in its name
        (``package.Name.msg``), as far as the store does not know the name already.
    """
    if not files:
        return store
    typesys = imported("rosbags.typesys", "reading bags", EXTRA)
    for file in files:
        try:
            text = file.read_text(encoding="utf-8")
        except OSError as error:
            raise FileError(f"cannot read {file}: {error.strerror or error}") from error
        store.register(typesys.get_types_from_msg(text, _type_name(file)))
    return store


def check_chunks(path: Path, reader: Any) -> None:
    """Refuse a bag whose chunks say that they unpack to far more than any recording does."""
    for each in reader.readers:
        storage = getattr(each, "storage", None)
        for part in getattr(storage, "storages", [storage]):
            for chunk in getattr(part, "chunks", []):
                check_unpacked(path, "a chunk", chunk.compressed_size, chunk.uncompressed_size)


def _type_name(file: Path) -> str:
    package, _, name = file.stem.rpartition(".")
    if not package and file.parent.name == "msg":
        package = file.absolute().parent.parent.name
    if not package:
        raise FileError(
            f"{file} does not say which package it is of; "
            "keep it as PACKAGE/msg/NAME.msg, or call it PACKAGE.NAME.msg"
        )
    return f"{package}/msg/{name}"


def _start(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(max(map(len, MAGICS)))


def _has_end(path: Path) -> bool:
    with path.open("rb") as stream:
        stream.seek(-min(len(_MCAP), path.stat().st_size), io.SEEK_END)
        return stream.read() == _MCAP


def _end_of_records(path: Path) -> int:
    """Find where the last whole record of an MCAP file ends."""
    size = path.stat().st_size
    end = len(_MCAP)
    with path.open("rb") as stream:
        while True:
            stream.seek(end)
            head = stream.read(_RECORD_HEAD)
            length = int.from_bytes(head[1:], "little")
            if len(head) < _RECORD_HEAD or end + _RECORD_HEAD + length > size:
                return end
            end += _RECORD_HEAD + length


def _unbuffered(path: Path) -> io.FileIO:
    """Open a file without a buffer."""
    return io.FileIO(path, "r")


class _BagFile(io.BufferedReader):
    """A file that is never asked for more than it has, whatever a damaged length says.

    Python sets aside as much memory as is asked for, before it looks how much there is.
    """

    def __init__(self, raw: io.RawIOBase) -> None:
        super().__init__(raw)
        self._size = self.seek(0, io.SEEK_END)
        self.seek(0)

    def read(self, size: int | None = -1) -> bytes:
        left = max(self._size - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))


class _WithEnd(io.RawIOBase):
    """An MCAP file that was cut off, as far as its records are whole, and an end behind them."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._file = path.open("rb")
        self._end = _end_of_records(path)
        self._at = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._at}.get(whence, self._end + len(_FOOTER))
        self._at = max(base + offset, 0)
        return self._at

    def tell(self) -> int:
        return self._at

    def readinto(self, buffer: Any) -> int:
        if self._at < self._end:
            self._file.seek(self._at)
            content = self._file.read(min(len(buffer), self._end - self._at))
        else:
            start = self._at - self._end
            content = _FOOTER[start : start + len(buffer)]
        buffer[: len(content)] = content
        self._at += len(content)
        return len(content)

    def close(self) -> None:
        self._file.close()
        super().close()
