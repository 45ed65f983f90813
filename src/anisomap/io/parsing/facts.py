"""Facts about maps and recordings as text, in ``# key: value`` lines that are read back equal."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from anisomap.errors import FileError, InputError
from anisomap.io.parsing.source import quote
from anisomap.map_verdict import ACCURACY, UNKNOWN, Verdict
from anisomap.recording import Scalar
from anisomap.sensor_map import DEFAULT_FRAME, DEFAULT_KIND, SensorMap


def texts_of(mapping: Mapping[str, Scalar]) -> Iterator[str]:
    """Yield all keys, and all values that are text, of metadata or provenance."""
    yield from mapping
    yield from (value for value in mapping.values() if isinstance(value, str))


def check_encodable(words: Iterable[str], file: Path) -> None:
    """Reject null characters and unpaired surrogates."""
    for word in words:
        if "\0" in word or any("\ud800" <= character <= "\udfff" for character in word):
            raise FileError(f"cannot write {file}: {quote(word)} is not valid text")


# Spreadsheets pad comment lines with empty cells when they save a file.
_PADDING = ",;\t "
# Spreadsheets split comment lines at delimiters and run cells that start like this.
_FORMULA = re.compile(r"(?<=[,;])[=+\-@]")


def write_comments(
    title: str, entries: Iterable[tuple[str, Scalar]], section: str, mapping: Mapping[str, Scalar]
) -> str:
    """Format a title, entries, and a mapping in a separate section."""
    lines = [title, *(f"{_format_key(key)}: {format_value(value)}" for key, value in entries)]
    if mapping:
        lines.append(f"{section}:")
    lines += [f"{_format_key(key)}: {format_value(value)}" for key, value in mapping.items()]
    return "".join(f"# {line}\n" for line in lines)


def read_comments(
    lines: Iterable[str], section: str
) -> tuple[list[tuple[str, Scalar]], dict[str, Scalar]]:
    """Parse the output of `write_comments`; lines without a colon are skipped."""
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
    """Convert a numpy scalar to a Python scalar."""
    scalar = value.item() if isinstance(value, np.generic) else value
    if not isinstance(scalar, Scalar):
        raise InputError(f"metadata must be str, int, float or bool, got {type(value).__name__}")
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


_FLAGS = ("distorted", "mirrored", "handed", "anchored")
_TEXTS = {"frame": DEFAULT_FRAME, "kind": DEFAULT_KIND}
_FIELDS = (*_FLAGS, *_TEXTS)

_ESCAPE = "~"
"""Precedes a key of the provenance that is also the name of a field."""


def properties_of(sensor_map: SensorMap) -> dict[str, Any]:
    """Return what a file states about a map; the frame and flags are part of the provenance."""
    flags: dict[str, Scalar] = {name: True for name in _FLAGS if getattr(sensor_map, name)}
    texts = {name: getattr(sensor_map, name) for name in _TEXTS}
    flags |= {name: text for name, text in texts.items() if text != _TEXTS[name]}
    provenance = {
        f"{_ESCAPE}{key}" if key.lstrip(_ESCAPE) in _FIELDS else key: to_python_scalar(value)
        for key, value in sensor_map.provenance.items()
    }
    verdict = sensor_map.verdict
    return {
        "method": sensor_map.method,
        "units": sensor_map.units,
        **sensor_map.reference,
        "stress": float(sensor_map.stress),
        "verdict": verdict.level,
        **{name: float(getattr(verdict, name)) for name in ACCURACY},
        "reasons": verdict.reasons,
        "notes": sensor_map.notes,
        "provenance": {**provenance, **flags},
    }


def read_properties(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Return arguments of `SensorMap`; texts and numbers that are missing are empty and NaN."""
    provenance: Mapping[str, Scalar] = stored.get("provenance", {})
    facts: dict[str, Any] = {
        name: provenance[name] is True for name in _FLAGS if name in provenance
    }
    facts |= {name: str(provenance[name]) for name in _TEXTS if name in provenance}
    if "precomputed" not in provenance:
        facts["similarity"] = str(provenance.get("similarity", ""))
    iterations = provenance.get("iterations")
    if isinstance(iterations, int):
        facts["n_iterations"] = int(iterations)
    return {
        **facts,
        "units": str(stored.get("units", "")),
        "method": str(stored.get("method", "")),
        "stress": _number(stored.get("stress")),
        "verdict": Verdict(
            str(stored.get("verdict", UNKNOWN)),
            **{name: _number(stored.get(name)) for name in ACCURACY},
            reasons=tuple(map(str, stored.get("reasons", ()))),
        ),
        "notes": tuple(map(str, stored.get("notes", ()))),
        "provenance": {
            key.removeprefix(_ESCAPE) if key.lstrip(_ESCAPE) in _FIELDS else key: value
            for key, value in provenance.items()
            if key not in _FIELDS
        },
    }


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.nan
