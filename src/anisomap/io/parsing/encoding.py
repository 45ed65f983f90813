"""Text that files can hold: checked before anything is written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from anisomap.errors import FileError
from anisomap.io.parsing.source import quote
from anisomap.recording import Scalar


def texts_of(mapping: Mapping[str, Scalar]) -> Iterator[str]:
    """Yield all keys, and all values that are text, of metadata or provenance."""
    yield from mapping
    yield from (value for value in mapping.values() if isinstance(value, str))


def check_encodable(words: Iterable[str], file: Path) -> None:
    """Reject null characters and unpaired surrogates.

    Raises
    ------
    FileError
        If a word contains one.
    """
    for word in words:
        if "\0" in word or any("\ud800" <= character <= "\udfff" for character in word):
            raise FileError(
                f"cannot write {file}: {quote(word)} contains a character that is not valid text"
            )
