"""Other people's readers: loaded when needed, and whatever they raise becomes one sentence."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from anisomap.errors import AnisomapError, FileError, MissingExtraError

Item = TypeVar("Item")

_LONGEST_REASON = 200


class DamagedError(FileError):
    """A file that another library could not make sense of."""


def imported(module: str, purpose: str, extra: str) -> Any:
    """Import a library that comes with an extra.

    Parameters
    ----------
    module : str
        Its full name.
    purpose : str
        What needs it, to begin the message with: ``"reading HDF5"``.
    extra : str
        Name of the extra that brings it.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MissingExtraError(purpose, extra) from error


@contextmanager
def foreign(path: Path) -> Iterator[None]:
    """Turn whatever another library raises in the block into a DamagedError.

    Such libraries are made for whole files; of damage they complain in ways that none of them
    lists. Only calls of them belong in the block, since it would hide defects of our own.
    """
    try:
        yield
    except (AnisomapError, MemoryError):
        raise
    except Exception as error:
        raise DamagedError(f"{path} is damaged or cut short: {reason_of(error)}") from error


def guarded(items: Iterator[Item], path: Path) -> Iterator[Item]:
    """Give what another library yields; what it raises becomes a DamagedError."""
    while True:
        with foreign(path):
            try:
                item = next(items)
            except StopIteration:
                return
        yield item


def reason_of(error: BaseException) -> str:
    """Say on one line, and in short, what another library found wrong."""
    text = " ".join(str(error).split()) or type(error).__name__
    text = "".join(letter if letter.isprintable() else "?" for letter in text)
    return text if len(text) <= _LONGEST_REASON else text[:_LONGEST_REASON] + "..."
