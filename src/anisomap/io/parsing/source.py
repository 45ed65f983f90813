"""Opening files, and one clear sentence for all that can fail in it."""

from __future__ import annotations

import csv
import gzip
import io
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anisomap.errors import FileError, InputError

HEAD_BYTES = 1 << 16
"""How much of a file the formats look at to recognise their own."""

DAMAGED_GZIP = (EOFError, zlib.error, gzip.BadGzipFile)
"""What reading a gzipped file raises where it is damaged or cut short."""

_GZIP = b"\x1f\x8b"
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_QUOTED = 40
_SUSPICIOUS_RATIO, _SUSPICIOUS_BYTES = 900, 1 << 30


@contextmanager
def blaming(path: Path) -> Iterator[None]:
    """Turn whatever goes wrong in the block into a FileError that names the file.

    Parameters
    ----------
    path : pathlib.Path
        The file to name.

    Raises
    ------
    FileError
        In place of errors of input, decoding, decompression, memory and the operating system.
    """
    try:
        yield
    except FileError:
        raise
    except InputError as error:
        raise FileError(f"{path}: {error}") from error
    except UnicodeDecodeError as error:
        raise FileError(
            f"{path} is not UTF-8 text{_undecodable(path)}; save it as UTF-8"
        ) from error
    except csv.Error as error:
        raise FileError(f"{path}: quotation marks do not match up ({error})") from error
    except (*DAMAGED_GZIP, zipfile.BadZipFile) as error:
        raise FileError(f"{path} is damaged or cut short: {error}") from error
    except MemoryError as error:
        raise FileError(f"{path} holds more than fits into memory") from error
    except OverflowError as error:
        raise FileError(f"{path} holds a number that is too large: {error}") from error
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error


def check_unpacked(
    path: Path, what: str, packed: int, unpacked: int, *, largest_ratio: float = np.inf
) -> None:
    """Refuse data that unpack to far more than any recording does.

    Parameters
    ----------
    path : pathlib.Path
        The file to name.
    what : str
        The part of it that is packed, to begin the message with.
    packed, unpacked : int
        Bytes before and after.
    largest_ratio : float
        What the way of packing could reach at all.

    Raises
    ------
    FileError
        If they are made to fill memory. Deflate turns a byte into 1032 at most; not even an idle
        skin comes near it over a whole gigabyte.
    """
    if unpacked > most_unpacked(packed) or unpacked > largest_ratio * packed:
        raise FileError(
            f"{path}: {what} says that it unpacks to {unpacked} bytes "
            f"from {packed}, which no recording does; it is damaged or made to fill memory"
        )


def most_unpacked(packed: int) -> int:
    """Give the most bytes that so many packed ones may unpack to."""
    return max(_SUSPICIOUS_BYTES, _SUSPICIOUS_RATIO * packed)


class _Gunzipped(gzip.GzipFile):
    """Unpacks no more than could be a recording."""

    def __init__(self, path: Path, raw: io.BufferedReader) -> None:
        super().__init__(fileobj=raw)
        self._path = path

    def read(self, size: int | None = -1) -> bytes:
        if size is None or size < 0:
            return b"".join(iter(lambda: self.read(HEAD_BYTES), b""))
        content = super().read1(size)  # `read` loses all that came before damage
        if self.tell() > _SUSPICIOUS_BYTES:
            packed = self._path.stat().st_size
            check_unpacked(self._path, "its content", packed, self.tell())
        return content


@contextmanager
def opened(path: Path) -> Iterator[io.BufferedReader]:
    """Open a file as bytes, unpacked if its first bytes say that it is gzipped."""
    with _opened(path) as (stream, _):
        yield stream


@contextmanager
def _opened(path: Path) -> Iterator[tuple[io.BufferedReader, io.BufferedReader]]:
    """Open a file as bytes to read, and as those that lie on the disk."""
    with path.open("rb") as raw:
        if raw.peek(len(_GZIP))[: len(_GZIP)] != _GZIP:
            yield raw, raw
            return
        with _Gunzipped(path, raw) as unpacked:
            yield io.BufferedReader(unpacked), raw


@dataclass(frozen=True)
class Text:
    """An open text file: its lines, and how much of the file has been read, from 0 to 1."""

    lines: io.TextIOWrapper
    share: Callable[[], float]


@contextmanager
def opened_text(path: Path) -> Iterator[io.TextIOWrapper]:
    """Open a file as UTF-8 text, gunzipped, without byte order mark, line ends as they are."""
    with opened_with_share(path) as text:
        yield text.lines


@contextmanager
def opened_with_share(path: Path) -> Iterator[Text]:
    """Open a file as `opened_text` does, and be able to tell how much of it has been read."""
    with _opened(path) as (stream, raw):
        start = _start(stream)
        if start.startswith(_UTF16):
            raise FileError(f"{path} is UTF-16 text; save it as UTF-8")
        if b"\0" in start:
            raise FileError(f"{path} is binary, not text, whatever its name says")
        stream.seek(0)
        size = max(path.stat().st_size, 1)
        with io.TextIOWrapper(stream, encoding="utf-8-sig", newline="") as text:
            yield Text(text, lambda: raw.tell() / size)


def head(path: Path) -> bytes:
    """Give the first bytes of a file, gunzipped; none of a folder.

    Raises
    ------
    FileError
        If there is no such file, it cannot be read, or it is empty or no ordinary file.
    """
    with blaming(path):
        if path.is_dir():
            return b""
        if not path.exists():
            raise FileError(f"there is no file {path}")
        if not path.is_file():
            raise FileError(f"{path} is not an ordinary file; save its content to one first")
        with opened(path) as stream:
            start = _start(stream)
        if not start:
            raise FileError(f"{path} is empty")
        return start


def _start(stream: io.BufferedReader) -> bytes:
    """Read the first bytes, or as many as damage leaves."""
    start = b""
    try:
        while len(start) < HEAD_BYTES and (more := stream.read1(HEAD_BYTES - len(start))):
            start += more
    except DAMAGED_GZIP:
        if not start:
            raise
    return start


def quoted(text: str) -> str:
    """Quote a piece of a file in a message, shortened and on one line."""
    return repr(text if len(text) <= _QUOTED else text[:_QUOTED] + "...")


def readable(name: str) -> str:
    """Give a name as it is, or quoted if that would break a message."""
    return name if name.isprintable() and len(name) <= _QUOTED else quoted(name)


def _undecodable(path: Path) -> str:
    with opened(path) as stream:
        for number, line in enumerate(stream, start=1):
            try:
                line.decode("utf-8")
            except UnicodeDecodeError as error:
                return f" (line {number}, byte 0x{line[error.start]:02x})"
    return ""
