"""``# key: value`` lines at the top of a text file: easy to read, and read back equal."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping

import numpy as np

from anisomap.errors import InputError
from anisomap.recording import Scalar

# A spreadsheet that saves a file pads its comment lines with empty cells.
_PADDING = ",;\t "


def write_comments(
    title: str, entries: Iterable[tuple[str, Scalar]], section: str, mapping: Mapping[str, Scalar]
) -> str:
    """Write a title, entries, and a mapping under a section of its own.

    Parameters
    ----------
    title : str
        First line.
    entries : iterable of (str, scalar)
        Keys may repeat.
    section : str
        Key whose empty value opens the mapping; left out if the mapping is empty.
    mapping : mapping of str to scalar
        All lines from there on.

    Returns
    -------
    str
        Lines that begin with ``#`` and end with a newline.
    """
    lines = [title, *(f"{_written_key(key)}: {written(value)}" for key, value in entries)]
    if mapping:
        lines.append(f"{section}:")
    lines += [f"{_written_key(key)}: {written(value)}" for key, value in mapping.items()]
    return "".join(f"# {line}\n" for line in lines)


def read_comments(
    lines: Iterable[str], section: str
) -> tuple[list[tuple[str, Scalar]], dict[str, Scalar]]:
    """Read what `write_comments` wrote; lines without a colon are passed over.

    Parameters
    ----------
    lines : iterable of str
        The comment lines, title and all.
    section : str
        As it was written.

    Returns
    -------
    entries : list of (str, scalar)
    mapping : dict of str to scalar
    """
    entries: list[tuple[str, Scalar]] = []
    mapping: dict[str, Scalar] = {}
    inside = False
    for line in lines:
        key, separator, value = _split(line.strip().removeprefix("#").strip())
        if not separator:
            continue
        text = value.strip().rstrip(_PADDING)
        if not text and key == section and not inside:
            inside = True
        elif inside:
            mapping[key] = _decoded(text)
        else:
            entries.append((key, _decoded(text)))
    return entries, mapping


def written(value: Scalar) -> str:
    """Write a value: text as it is where that reads back as the same text, all else as JSON."""
    if isinstance(value, str):
        plain = value and value.isprintable() and value == value.strip(_PADDING)
        return value if plain and _decoded(value) == value else json.dumps(value)
    return json.dumps(python_scalar(value))


def python_scalar(value: object) -> Scalar:
    """Give a scalar of Python for one of numpy.

    Raises
    ------
    InputError
        If it is not a scalar at all.
    """
    scalar = value.item() if isinstance(value, np.generic) else value
    if not isinstance(scalar, Scalar):
        raise InputError(
            f"provenance and metadata hold text, numbers and truth values, "
            f"not {type(value).__name__}"
        )
    return scalar


def _written_key(key: str) -> str:
    plain = key and key.isprintable() and key == key.strip() and key[0] not in '"#'
    return key if plain and ":" not in key else json.dumps(key)


def _split(line: str) -> tuple[str, str, str]:
    if not line.startswith('"'):
        key, separator, value = line.partition(":")
        return key.strip(), separator, value
    try:
        key, end = json.JSONDecoder().raw_decode(line)
    except ValueError:
        return "", "", ""
    separator, value = line[end : end + 1], line[end + 1 :]
    return (key, separator, value) if separator == ":" else ("", "", "")


def _decoded(text: str) -> Scalar:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return value if isinstance(value, (str, int, float, bool)) else text
