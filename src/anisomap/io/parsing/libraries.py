"""Exceptions of libraries that parse files, converted to FileError."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

from anisomap.errors import AnisomapError, FileError

Item = TypeVar("Item")

_MAX_REASON = 200


class DamagedError(FileError):
    """A file that a library failed to parse."""


@contextmanager
def library_errors(path: Path) -> Iterator[None]:
    """Convert any exception that a library raises in the block into a DamagedError.

    The exceptions that these libraries raise for damaged files are undocumented. The block must
    contain library calls only, because it would hide defects of anisomap.
    """
    try:
        yield
    except (AnisomapError, MemoryError):
        raise
    except Exception as error:
        raise DamagedError(f"{path} is damaged or cut short: {error_reason(error)}") from error


def guarded_iter(items: Iterator[Item], path: Path) -> Iterator[Item]:
    """Yield the items of a library's iterator, with its exceptions as DamagedError."""
    while True:
        with library_errors(path):
            try:
                item = next(items)
            except StopIteration:
                return
        yield item


def error_reason(error: BaseException) -> str:
    """Return the message of an exception on one line, shortened to printable characters."""
    text = " ".join(str(error).split()) or type(error).__name__
    text = "".join(letter if letter.isprintable() else "?" for letter in text)
    return text if len(text) <= _MAX_REASON else text[:_MAX_REASON] + "..."
