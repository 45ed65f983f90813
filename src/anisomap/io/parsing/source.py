"""Read files as bytes, text or JSON, gzipped or not, and convert errors to FileError."""

from __future__ import annotations

import csv
import gzip
import io
import json
import re
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar

from anisomap.base.wording import printable
from anisomap.errors import AnisomapWarning, FileError, InputError, error_reason
from anisomap.files.budget import Budget
from anisomap.files.paths import open_regular

Item = TypeVar("Item")
Line = TypeVar("Line", str, bytes)

_MIN_REPORTED_LOSS = 0.005
# Colours of terminals, and checksums as of NMEA 0183; titles of terminals and other controls.
_APART = re.compile(r"\x1b\[[0-9;?]*+[ -/]*+[@-~]|(?<=[\w.\])])\*[0-9A-Fa-f]{2}(?=\s*$)")
_CONTROLS = re.compile(r"\x1b\][^\x07\x1b]*+\x07?|[\x01-\b\x0e-\x1b]")
_ERRORS = re.compile(r"#(?:N/A|(?:VALUE|DIV/0|NUM|REF|NULL)!|NAME\?)")  # of spreadsheets


class RefusedError(FileError):
    """Lines that can be read, but not with the intended meaning, even if some are left out."""


_SAID: ContextVar[list[tuple[str, str, str]] | None] = ContextVar("said", default=None)


@contextmanager
def said_here() -> Iterator[list[tuple[str, str, str]]]:
    """Collect the arguments of `warn` in this thread, instead of warning."""
    said = list[tuple[str, str, str]]()
    token = _SAID.set(said)
    try:
        yield said
    finally:
        _SAID.reset(token)


def warn(path: Path | str, problem: str, remedy: str = "") -> None:
    """Warn about a file whose map or recording is used nevertheless.

    remedy: What users of files can do, such as give an option.
    """
    if (said := _SAID.get()) is not None:
        said.append((str(path), printable(problem), remedy))
        return
    text = "; ".join(filter(None, (problem, remedy)))
    warnings.warn(f"{path}: {printable(text)}", AnisomapWarning, stacklevel=3)


def warn_of_loss(path: Path, error: BaseException, found: str, fraction: float) -> None:
    """Warn that only a fraction of a file could be read, such as ``"3 frames"``."""
    loss = 1 - fraction
    lost = f" (about {loss:.0%} of the file)" if loss > _MIN_REPORTED_LOSS else ""
    problem = f"damaged or cut short ({error_reason(error)})"
    warn(path, f"{problem}: read the {found} before the damage, lost the rest{lost}")


HEAD_BYTES = 1 << 16
"""Bytes at the start of a file that the formats inspect to recognise it."""

GZIP_ERRORS = (EOFError, zlib.error, gzip.BadGzipFile)
"""Exceptions of reading a damaged or truncated gzip file."""

_GZIP = b"\x1f\x8b"
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_MAX_QUOTED = 40

_LINE_BYTES = 300
"""Memory of a line of a table and its fields, by sizes of objects in CPython."""

_MAX_LINE = 1 << 23
"""Maximum characters of a line: readings or names of a million sensors are shorter."""


@contextmanager
def file_errors(path: Path) -> Iterator[None]:
    """Convert errors in the block to FileErrors that name the file."""
    try:
        yield
    except FileError:
        raise
    except InputError as error:
        raise FileError(f"{path}: {error}") from error
    except UnicodeDecodeError as error:
        where = _undecodable(path)
        raise FileError(f"{path} is not UTF-8 text{where}; save it as UTF-8") from error
    except csv.Error as error:
        raise FileError(f"{path}: unbalanced quotation marks ({error})") from error
    except (*GZIP_ERRORS, zipfile.BadZipFile) as error:
        raise FileError(f"{path} is damaged or cut short: {error}") from error
    except MemoryError as error:
        raise FileError(f"{path} does not fit into memory") from error
    except OverflowError as error:
        raise FileError(f"{path} holds a number that is too large: {error}") from error
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error


class _Gunzipped(gzip.GzipFile):
    """A gzip file that is checked for decompression bombs while it is read."""

    def __init__(self, path: Path, raw: io.BufferedReader) -> None:
        super().__init__(fileobj=raw)
        self._budget = Budget(path)

    def read(self, size: int | None = -1) -> bytes:
        content = super().read1(-1 if size is None else size)  # `read` discards data before damage
        self._budget.check(self.tell(), "its content")
        return content


@contextmanager
def open_binary(path: Path) -> Iterator[io.BufferedReader]:
    """Open a file as bytes, and decompress it if it starts with the gzip magic number."""
    with _open(path) as (stream, _):
        yield stream


@contextmanager
def _open(path: Path) -> Iterator[tuple[io.BufferedReader, io.BufferedReader]]:
    """Open a file as decompressed bytes and as the raw bytes on disk."""
    with open_regular(path) as raw:
        if raw.peek(len(_GZIP))[: len(_GZIP)] != _GZIP:
            yield raw, raw
            return
        with _Gunzipped(path, raw) as decompressed:
            yield io.BufferedReader(decompressed), raw


class TextLines(io.TextIOWrapper):
    """UTF-8 text whose lines have a maximum length when it is iterated.

    last, number: The last line read, and its number from 1.
    """

    def __init__(self, path: Path, stream: io.BufferedReader, raw: io.BufferedReader) -> None:
        super().__init__(stream, encoding="utf-8-sig", newline="")
        self.last, self.number = "", 0
        self._path, self._raw, self._size = path, raw, max(path.stat().st_size, 1)

    def __next__(self) -> str:  # type: ignore[override]
        line = self.readline(_MAX_LINE)
        if not line:
            raise StopIteration
        self.last, self.number = line, self.number + 1
        line = plain(line)
        if len(line) == _MAX_LINE:
            raise _long_line(self._path)
        return line

    def fraction(self) -> float:
        """Return the fraction of the file that was read, from 0 to 1."""
        return self._raw.tell() / self._size


def plain(line: str) -> str:
    """Remove control characters and a checksum from a line; cells that are errors become NaN."""
    if "\x1b" in line or "*" in line:
        line = _APART.sub("", line)
    if not (line[:-1].isprintable() or '"' in line):  # names in quotes may have controls
        line = _CONTROLS.sub("", line)
    return _ERRORS.sub("nan", line) if "#" in line else line


def binary_lines(path: Path, stream: io.BufferedReader) -> Iterator[bytes]:
    """Yield the lines of a file; raise FileError if a line is too long."""
    while line := stream.readline(_MAX_LINE):
        if len(line) == _MAX_LINE:
            raise _long_line(path)
        yield line


def _long_line(path: Path) -> FileError:
    return FileError(f"{path} has a line of more than {_MAX_LINE} characters; it is not a table")


@contextmanager
def open_text(path: Path) -> Iterator[TextLines]:
    """Open a file as UTF-8 text: decompressed, without byte order mark, with its line ends."""
    with _open(path) as (stream, raw):
        start = _read_start(stream)
        nulls = sorted((start[::2].count(0), start[1::2].count(0)))
        if start.startswith(_UTF16) or (nulls[0] == 0 and 4 * nulls[1] > len(start)):
            raise FileError(f"{path} is UTF-16 text; save it as UTF-8")
        if b"\0" in start:
            raise FileError(f"{path} is binary, not text")
        stream.seek(0)
        with TextLines(path, stream, raw) as text:
            yield text


def read_lines(path: Path) -> list[str]:
    """Read all lines of a file as `open_text` does, within the budget of the file."""
    with open_text(path) as stream:
        return list(_budgeted(path, stream))


def numbered_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield stripped lines, from 1, of text before binary data, within the budget of the file."""
    with open_binary(path) as stream:
        lines = _budgeted(path, binary_lines(path, stream))
        for number, line in enumerate(lines, start=1):
            yield number, line.decode("utf-8", "replace").strip()


def _budgeted(path: Path, lines: Iterator[Line]) -> Iterator[Line]:
    budget, n_bytes = Budget(path), 0
    for line in lines:
        n_bytes += len(line) + _LINE_BYTES
        budget.check(n_bytes, "its text")
        yield line


def batches(
    items: Iterator[Item], weigh: Callable[[Item], int], limit: int
) -> Iterator[list[Item]]:
    """Group items up to a limit of total weight; items before an error are yielded first."""
    held, weight = list[Item](), 0
    try:
        for item in items:
            held.append(item)
            weight += weigh(item)
            if weight >= limit:
                yield held
                held, weight = [], 0
    except Exception:
        if held:
            yield held
        raise
    if held:
        yield held


def read_head(path: Path) -> bytes:
    """Read the first decompressed bytes of a file; empty for a folder."""
    with file_errors(path):
        if path.is_dir():
            return b""
        with open_binary(path) as stream:
            start = _read_start(stream)
        if not start:
            raise FileError(f"{path} is empty")
        return start


def lines_of(head: bytes) -> list[str]:
    """Return the lines of the first bytes of a text, with their ends; none for binary data."""
    if b"\0" in head:
        return []
    return head.decode("utf-8-sig", "replace").splitlines(keepends=True)


def _read_start(stream: io.BufferedReader) -> bytes:
    """Read up to `HEAD_BYTES`, stopping at the first damage."""
    start = b""
    try:
        while len(start) < HEAD_BYTES and (more := stream.read1(HEAD_BYTES - len(start))):
            start += more
    except GZIP_ERRORS:
        if not start:
            raise
    return start


def quote(text: str) -> str:
    """Quote text from a file for a message, shortened and on one line."""
    return repr(text if len(text) <= _MAX_QUOTED else text[:_MAX_QUOTED] + "...")


def quote_if_needed(name: str) -> str:
    """Return a short printable name verbatim, and quote others."""
    short = len(name) <= _MAX_QUOTED and name.isprintable()
    return name if short else quote(name)


def _undecodable(path: Path) -> str:
    """Locate the first byte that is not UTF-8, unless it is in a folder or after damage."""
    if path.is_dir():
        return ""
    with suppress(*GZIP_ERRORS), open_binary(path) as stream:
        for number, line in enumerate(binary_lines(path, stream), start=1):
            try:
                line.decode("utf-8")
            except UnicodeDecodeError as error:
                return f" (line {number}, byte 0x{line[error.start]:02x})"
    return ""


_OBJECT_BYTES = 24
"""Memory of the objects per character of their text (measured: empty lists; CPython 3.11)."""

_FREE_PARTS, _PART_CHARACTERS = 1 << 19, 10
"""Lists and objects allowed in any file, and minimum characters of each beyond that number; the
shortest sensor of a map has 21 for its two."""


def read_json(path: Path) -> Any:
    """Parse a JSON file."""
    budget = Budget(path)
    with open_text(path) as stream:
        text = stream.read(budget.limit // _OBJECT_BYTES + 1)
    budget.check(_OBJECT_BYTES * len(text), "its text")
    n_parts = text.count("[") + text.count("{")
    if n_parts > max(_FREE_PARTS, len(text) // _PART_CHARACTERS):
        raise FileError(f"{path} is damaged: {n_parts} lists and objects are too many for a map")
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        where = f"{path}, line {error.lineno}, column {error.colno}"
        raise FileError(f"{where}: not valid JSON ({error.msg})") from error
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: not valid JSON ({error})") from error
