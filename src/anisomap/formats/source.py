"""Opening files, and one clear sentence for all that can fail in it."""

from __future__ import annotations

import csv
import gzip
import io
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from anisomap.errors import FileError, InputError

HEAD_BYTES = 1 << 16
"""How much of a file the formats look at to recognise their own."""

_GZIP = b"\x1f\x8b"
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_QUOTED = 40


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
    except (EOFError, zlib.error, gzip.BadGzipFile, zipfile.BadZipFile) as error:
        raise FileError(f"{path} is damaged or cut short: {error}") from error
    except MemoryError as error:
        raise FileError(f"{path} holds more than fits into memory") from error
    except OverflowError as error:
        raise FileError(f"{path} holds a number that is too large: {error}") from error
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error


@contextmanager
def opened(path: Path) -> Iterator[io.BufferedReader]:
    """Open a file as bytes, unpacked if its first bytes say that it is gzipped."""
    with path.open("rb") as raw:
        if raw.peek(len(_GZIP))[: len(_GZIP)] != _GZIP:
            yield raw
            return
        with gzip.GzipFile(fileobj=raw) as unpacked:
            yield io.BufferedReader(unpacked)


@contextmanager
def opened_text(path: Path) -> Iterator[io.TextIOWrapper]:
    """Open a file as UTF-8 text, gunzipped, without byte order mark, line ends as they are."""
    with opened(path) as stream:
        start = stream.read(HEAD_BYTES)
        if start.startswith(_UTF16):
            raise FileError(f"{path} is UTF-16 text; save it as UTF-8")
        if b"\0" in start:
            raise FileError(f"{path} is binary, not text, whatever its name says")
        stream.seek(0)
        with io.TextIOWrapper(stream, encoding="utf-8-sig", newline="") as text:
            yield text


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
            start = stream.read(HEAD_BYTES)
        if not start:
            raise FileError(f"{path} is empty")
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
