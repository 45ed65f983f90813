"""Optional libraries: lazy import, and conversion of their exceptions to FileError."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from anisomap.errors import AnisomapError, FileError, MissingExtraError

Item = TypeVar("Item")

_MAX_REASON = 200


class DamagedError(FileError):
    """A file that a library failed to parse."""


def import_extra(module: str, purpose: str, extra: str) -> Any:
    """Import a library that an extra installs.

    Parameters
    ----------
    module : str
        Full name of the module.
    purpose : str
        Start of the error message, such as ``"reading HDF5"``.
    extra : str
        Name of the extra.

    Returns
    -------
    module

    Raises
    ------
    MissingExtraError
        If the library is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(purpose, extra) from error


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
