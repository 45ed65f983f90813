"""Metadata in ``# key: value`` lines at the top of a text file, read back equal."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping

import numpy as np

from anisomap.errors import InputError
from anisomap.recording import Scalar

# Spreadsheets pad comment lines with empty cells when they save a file.
_PADDING = ",;\t "
# Spreadsheets split comment lines at delimiters and run cells that start like this.
_FORMULA = re.compile(r"(?<=[,;])[=+\-@]")


def write_comments(
    title: str, entries: Iterable[tuple[str, Scalar]], section: str, mapping: Mapping[str, Scalar]
) -> str:
    """Format a title, entries, and a mapping in a separate section.

    Parameters
    ----------
    title : str
        First line.
    entries : iterable of (str, scalar)
        Keys may repeat.
    section : str
        Heading of the mapping; omitted if the mapping is empty.
    mapping : mapping of str to scalar

    Returns
    -------
    str
        Lines that start with ``#`` and end with a newline.
    """
    lines = [title, *(f"{_format_key(key)}: {format_value(value)}" for key, value in entries)]
    if mapping:
        lines.append(f"{section}:")
    lines += [f"{_format_key(key)}: {format_value(value)}" for key, value in mapping.items()]
    return "".join(f"# {line}\n" for line in lines)


def read_comments(
    lines: Iterable[str], section: str
) -> tuple[list[tuple[str, Scalar]], dict[str, Scalar]]:
    """Parse the output of `write_comments`; lines without a colon are skipped.

    Parameters
    ----------
    lines : iterable of str
        The comment lines, including the title.
    section : str
        Heading of the mapping.

    Returns
    -------
    entries : list of (str, scalar)
        Entries before the section.
    mapping : dict of str to scalar
        Entries in the section.
    """
    entries: list[tuple[str, Scalar]] = []
    mapping: dict[str, Scalar] = {}
    inside = False
    for line in lines:
        key, separator, value = _split_entry(line.strip().removeprefix("#").strip())
        if not separator:
            continue
        text = value.strip().rstrip(_PADDING)
        if not text and key == section and not inside:
            inside = True
        elif inside:
            mapping[key] = _parse_value(text)
        else:
            entries.append((key, _parse_value(text)))
    return entries, mapping


def format_value(value: Scalar) -> str:
    """Format a value as JSON, or text verbatim if it reads back as the same text."""
    if isinstance(value, str):
        plain = value and value.isprintable() and value == value.strip(_PADDING)
        plain = plain and not _FORMULA.search(value)
        return value if plain and _parse_value(value) == value else _quoted(value)
    return json.dumps(to_python_scalar(value))


def to_python_scalar(value: object) -> Scalar:
    """Convert a numpy scalar to a Python scalar.

    Raises
    ------
    InputError
        If `value` is not a scalar.
    """
    scalar = value.item() if isinstance(value, np.generic) else value
    if not isinstance(scalar, Scalar):
        raise InputError(
            "values of provenance and metadata must be str, int, float or bool, "
            f"got {type(value).__name__}"
        )
    return scalar


def _format_key(key: str) -> str:
    plain = key and key.isprintable() and key == key.strip() and key[0] not in '"#'
    plain = plain and ":" not in key and not _FORMULA.search(key)
    return key if plain else _quoted(key)


def _quoted(text: str) -> str:
    return _FORMULA.sub(lambda match: f"\\u{ord(match[0]):04x}", json.dumps(text))


def _split_entry(line: str) -> tuple[str, str, str]:
    if not line.startswith('"'):
        key, separator, value = line.partition(":")
        return key.strip(), separator, value
    try:
        key, end = json.JSONDecoder().raw_decode(line)
    except ValueError:
        return "", "", ""
    separator, value = line[end : end + 1], line[end + 1 :]
    return (key, separator, value) if separator == ":" else ("", "", "")


def _parse_value(text: str) -> Scalar:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return value if isinstance(value, (str, int, float, bool)) else text
