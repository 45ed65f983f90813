"""JSON files, which may be gzipped, read within the budget of the file."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from anisomap.errors import FileError
from anisomap.io.parsing.source import open_text
from anisomap.memory import Budget

_OBJECT_BYTES = 24
"""Memory of the objects per character of their text (measured: empty lists; CPython 3.11)."""

_FREE_PARTS, _PART_CHARACTERS = 1 << 19, 10
"""Lists and objects that any file may hold, and the characters of each beyond that number; the
shortest sensor of a map has 21 for its two."""

_BLANKS = " \t\r\n"
_DECODER = json.JSONDecoder()


def read_json(path: Path) -> Any:
    """Parse a file."""
    text = _read(path)
    n_parts = text.count("[") + text.count("{")
    if n_parts > max(_FREE_PARTS, len(text) // _PART_CHARACTERS):
        raise FileError(
            f"{path} holds {n_parts} lists and objects in {len(text)} characters, too many for a "
            "map; it is damaged or a decompression bomb"
        )
    value, end = _decoded(path, text, _after_blanks(text, 0))
    if _after_blanks(text, end) < len(text):
        raise _invalid(path, json.JSONDecodeError("Extra data", text, end))
    return value


def read_items(path: Path) -> Iterator[Any]:
    """Yield the elements of a file that is one list, so that only one of them takes memory."""
    text = _read(path)
    at = _after_blanks(text, text.find("[") + 1)
    ended = text[at : at + 1] == "]"
    while not ended:
        value, at = _decoded(path, text, at)
        yield value
        at = _after_blanks(text, at)
        ended = text[at : at + 1] == "]"
        if not ended and text[at : at + 1] != ",":
            raise _invalid(path, json.JSONDecodeError("Expecting ',' delimiter", text, at))
        at = at if ended else _after_blanks(text, at + 1)
    if _after_blanks(text, at + 1) < len(text):
        raise _invalid(path, json.JSONDecodeError("Extra data", text, at + 1))


def _read(path: Path) -> str:
    budget = Budget(path)
    with open_text(path) as stream:
        text = stream.read(budget.limit // _OBJECT_BYTES + 1)
    budget.check(_OBJECT_BYTES * len(text), "its text")
    return text


def _decoded(path: Path, text: str, at: int) -> tuple[Any, int]:
    try:
        return _DECODER.raw_decode(text, at)
    except json.JSONDecodeError as error:
        raise _invalid(path, error) from error
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: not valid JSON ({error})") from error


def _invalid(path: Path, error: json.JSONDecodeError) -> FileError:
    where = f"{path}, line {error.lineno}, column {error.colno}"
    return FileError(f"{where}: not valid JSON ({error.msg})")


def _after_blanks(text: str, at: int) -> int:
    while at < len(text) and text[at] in _BLANKS:
        at += 1
    return at
