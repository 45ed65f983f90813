"""Maps and true positions as delimited text.

Ours has comments at the top, then ``name, x, y, z, component, health``. Read is any
table that has columns x and y (and z), and what else of those it has; or, without a header, two or
three columns of numbers, with names before them or not.
"""

from __future__ import annotations

import csv
import functools
import itertools
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from anisomap.errors import FileError
from anisomap.io.parsing import comments, delimited
from anisomap.io.parsing.map_facts import from_provenance, to_provenance
from anisomap.io.parsing.source import opened_text, quoted
from anisomap.io.parsing.table import LineError, parse_number
from anisomap.io.recordings.text import MAP_TITLE
from anisomap.recording import Scalar
from anisomap.sensor_map import SensorMap

Value = TypeVar("Value")

_AXES = "xyz"
_NAMES = ("name", "sensor", "taxel", "label", "id")
_OURS = ("component", "health")
_AXIS = re.compile(r"(x\d*|y|z)(?:[ _]*[\[(]?(mm|cm|m|um|\u00b5m|in|px|pixels?)[\])]?)?")
_TRUTH = {"true": True, "false": False, "1": True, "0": False}


@dataclass(frozen=True)
class _Columns:
    """Where what stands; the places of coordinates in their order, those of the rest by name."""

    axes: tuple[int, ...]
    places: Mapping[str, int]
    units: str
    from_header: bool


def axis_names(dimensions: int) -> tuple[str, ...]:
    """Name coordinates: x, y, z, or x1, x2, ... where there are more."""
    if dimensions <= len(_AXES):
        return tuple(_AXES[:dimensions])
    return tuple(f"x{i + 1}" for i in range(dimensions))


def read_map(path: Path) -> SensorMap:
    """Read a map, or true positions, from delimited text.

    Parameters
    ----------
    path : pathlib.Path
        See the head of this module.

    Returns
    -------
    SensorMap
        Units are those of the comments or of the header (``x [mm]``), else empty.

    Raises
    ------
    FileError
        With line and column of what cannot be read.
    """
    with opened_text(path) as stream:
        lines = list(stream)
    delimiter = delimited.find_delimiter(lines)
    rows = _without_empty_end(list(delimited.records(lines, delimiter)))
    if not rows:
        raise FileError(f"{path} holds no line of positions")
    columns = _columns(path, rows[0])
    body = rows[1:] if columns.from_header else rows
    if not body:
        raise FileError(f"{path} holds a header and nothing below it")
    _check_widths(path, rows)

    def number(field: str) -> float:
        return parse_number(field if delimiter == "," else field.replace(",", "."))

    read = functools.partial(_column, path, body)
    places = columns.places
    ours = all(column in places for column in _OURS)
    named = str if ours else str.strip
    return SensorMap(
        np.array([read(place, number, "a number") for place in columns.axes]).T,
        names=read(places["name"], named) if "name" in places else (),
        component=np.array(
            read(places["component"], int, "a whole number") if ours else (), np.intp
        ),
        health=read(places["health"], str) if ours else (),
        **_described(lines, columns.units),
    )


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as text: what it is in comments, then a line a sensor.

    Parameters
    ----------
    sensor_map : SensorMap
        What to write; all of it reads back equal.
    path : pathlib.Path
        Fields are separated by tabs if it ends in ``.tsv``, else by commas.
    """
    entries: list[tuple[str, Scalar]] = [
        ("method", sensor_map.method),
        ("units", sensor_map.units),
        *sensor_map.reference.items(),
        ("stress", float(sensor_map.stress)),
        ("confidence", float(sensor_map.confidence)),
        *(("note", note) for note in sensor_map.notes),
    ]
    title = f"{MAP_TITLE}, known up to {sensor_map.known_up_to}"
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(
            comments.write_comments(title, entries, "provenance", to_provenance(sensor_map))
        )
        table = csv.writer(
            stream,
            delimiter="\t" if path.suffix.lower() == ".tsv" else ",",
            quoting=csv.QUOTE_NONNUMERIC,
            lineterminator="\n",
        )
        table.writerow(("name", *axis_names(sensor_map.dimensions), *_OURS))
        for name, position, component, health in zip(
            sensor_map.names,
            sensor_map.positions.tolist(),
            sensor_map.component.tolist(),
            sensor_map.health,
            strict=True,
        ):
            table.writerow((name, *position, component, health))


def _without_empty_end(rows: list[delimited.Record]) -> list[delimited.Record]:
    """Drop columns at the end in which nothing stands: every line ends in delimiters."""
    empty = delimited.empty_columns([fields for _, fields in rows]) if rows else 0
    return [(number, fields[: len(fields) - empty]) for number, fields in rows]


def _columns(path: Path, first: delimited.Record) -> _Columns:
    line, fields = first
    words = [field.strip().lower() for field in fields]
    found = {
        match[1]: (i, match[2] or "")
        for i, word in enumerate(words)
        if (match := _AXIS.fullmatch(word))
    }
    axes = [
        axis for axis in (_AXES if "x" in found else axis_names(len(found) + 3)) if axis in found
    ]
    if axes:
        places = {word: i for i, word in enumerate(words) if word in _OURS}
        named = [words.index(word) for word in _NAMES if word in words]
        places |= {"name": named[0]} if named else {}
        return _Columns(tuple(found[axis][0] for axis in axes), places, found[axes[0]][1], True)
    start = 0 if _is_number(fields[0]) else 1
    coordinates = range(start, len(fields))
    if len(coordinates) in (2, 3) and all(_is_number(fields[i]) for i in coordinates):
        return _Columns(tuple(coordinates), {"name": 0} if start else {}, "", False)
    raise LineError(
        path,
        line,
        f" has {len(fields)} fields ({quoted(', '.join(fields))}), but no columns x and y; give a "
        "header with x, y (and z), or lines of two or three numbers, with or without a name before",
    )


def _check_widths(path: Path, rows: Sequence[delimited.Record]) -> None:
    first, width = rows[0][0], len(rows[0][1])
    for line, fields in rows:
        if len(fields) != width:
            raise LineError(path, line, f" has {len(fields)} fields, but line {first} has {width}")


def _column(
    path: Path,
    rows: Sequence[delimited.Record],
    place: int,
    parse: Callable[[str], Value],
    wanted: str = "text",
) -> tuple[Value, ...]:
    values = []
    for line, fields in rows:
        try:
            values.append(parse(fields[place]))
        except ValueError:
            problem = f", column {place + 1}: {quoted(fields[place])} is not {wanted}"
            raise LineError(path, line, problem) from None
    return tuple(values)


def _number(value: Scalar | None) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def _is_number(field: str) -> bool:
    try:
        parse_number(field.replace(",", "."))
    except ValueError:
        return False
    return True


def _described(lines: Sequence[str], units: str) -> dict[str, Any]:
    """Give what the comments of a map of our own say; of other files only the units."""
    if not lines[0].startswith(f"# {MAP_TITLE}"):
        return {"units": units}
    leading = itertools.takewhile(lambda line: line.startswith("#"), lines)
    entries, provenance = comments.read_comments(leading, "provenance")
    known = dict(entries)
    return {
        "units": str(known.get("units", units)),
        "method": str(known.get("method", "")),
        "stress": _number(known.get("stress")),
        "confidence": _number(known.get("confidence")),
        "notes": tuple(str(value) for key, value in entries if key == "note"),
        **from_provenance(provenance),
    }
