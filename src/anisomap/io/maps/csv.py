"""Maps, true positions and lists of modules as delimited text.

A map has comments and a table ``name, x, y, z, component, health``, followed by ``error``,
``cov_xx, cov_xy, ...`` and ``nx, ny, nz`` if the map has errors, covariances and normals. Any table
with columns x and y (and z) is read, or, without a header, two or three columns of numbers after an
optional column of names.
"""

from __future__ import annotations

import csv
import functools
import itertools
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing import delimited
from anisomap.io.parsing import facts as comments
from anisomap.io.parsing.facts import from_provenance, to_provenance
from anisomap.io.parsing.naming import distinct_names
from anisomap.io.parsing.source import file_errors, open_text, quote, read_lines
from anisomap.io.parsing.table import LineError, is_number, parse_number
from anisomap.io.recordings.delimited_text import MAP_TITLE
from anisomap.placement.modules import Modules, modules_by_name
from anisomap.recording import Scalar
from anisomap.sensor_map import SensorMap, axis_names
from anisomap.usability import ACCURACY, UNKNOWN, Verdict

Value = TypeVar("Value")

_MAX_COLUMNS = 10_000  # covariances in 140 dimensions
_AXES = "xyz"
_NAMES = ("name", "sensor", "taxel", "label", "id")
_EXTRA_COLUMNS = ("component", "health")
_ERROR, _NORMAL = "error", ("nx", "ny", "nz")
_AXIS = re.compile(r"(x\d*|y|z)(?:[ _]*[\[(]?(mm|cm|m|um|\u00b5m|in|px|pixels?)[\])]?)?")


@dataclass(frozen=True)
class _Columns:
    """Column indices of the coordinates in order, and of the other columns by name."""

    axes: tuple[int, ...]
    others: Mapping[str, int]
    units: str
    from_header: bool
    covariances: tuple[str, ...] = ()


def read_map(path: Path) -> SensorMap:
    """Read a map, or true positions, from delimited text.

    Units come from the comments or the header (``x [mm]``), else they are empty. Errors give line
    and column.
    """
    lines = read_lines(path)
    if any(len(line) > _MAX_COLUMNS and _n_marks(line) > _MAX_COLUMNS for line in lines):
        raise FileError(f"{path} has a line of more than {_MAX_COLUMNS} columns; it is not a map")
    delimiter = delimited.find_delimiter(lines)
    rows = _without_trailing_columns(list(delimited.records(lines, delimiter)))
    if not rows:
        raise FileError(f"{path} holds no line of positions")
    columns = _columns(path, rows[0])
    body = rows[1:] if columns.from_header else rows
    if not body:
        raise FileError(f"{path} holds only a header")
    _check_widths(path, rows)

    def number(field: str) -> float:
        return parse_number(field if delimiter == "," else field.replace(",", "."))

    read = functools.partial(_column, path, body)
    others = columns.others
    is_map = all(column in others for column in _EXTRA_COLUMNS)
    parse_name: Callable[[str], str] = str if is_map else str.strip
    if lines[0].startswith(f"# {MAP_TITLE}"):
        parse_name = delimited.unguard_formula
    component = read(others["component"], int, "an integer") if is_map else ()
    errors = read(others[_ERROR], number, "a number") if is_map and _ERROR in others else ()
    entries = [read(others[name], number, "a number") for name in columns.covariances]
    normals = [read(others[axis], number, "a number") for axis in _NORMAL if axis in others]
    return SensorMap(
        np.array([read(column, number, "a number") for column in columns.axes]).T,
        names=distinct_names(path, read(others["name"], parse_name)) if "name" in others else (),
        component=np.array(component, np.intp),
        health=read(others["health"], parse_name) if is_map else (),
        errors=np.array(errors),
        covariances=_covariances(np.array(entries)) if is_map and entries else None,
        normals=np.array(normals).T if is_map and len(normals) == len(_NORMAL) else None,
        **_map_properties(lines, columns.units),
    )


def _n_marks(line: str) -> int:
    """Return the number of delimiters in a line; comments, which may be long, have none."""
    return 0 if line.startswith("#") else sum(map(line.count, ",;\t "))


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as comments and one line per sensor; every field is read back equal.

    Names that a spreadsheet would run as formulas are preceded by an apostrophe in the file.

    The suffix ``.tsv`` selects tabs, all others commas.
    """
    entries: list[tuple[str, Scalar]] = [
        ("method", sensor_map.method),
        ("units", sensor_map.units),
        *sensor_map.reference.items(),
        ("stress", float(sensor_map.stress)),
        ("verdict", sensor_map.verdict.level),
        *((name, float(getattr(sensor_map.verdict, name))) for name in ACCURACY),
        *(("reason", reason) for reason in sensor_map.verdict.reasons),
        *(("note", note) for note in sensor_map.notes),
    ]
    title = f"{MAP_TITLE}, {sensor_map.pose}"
    with path.open("w", encoding="utf-8", newline="") as stream:
        provenance = to_provenance(sensor_map)
        stream.write(comments.write_comments(title, entries, "provenance", provenance))
        table = csv.writer(
            stream,
            delimiter="\t" if path.suffix.lower() == ".tsv" else ",",
            quoting=csv.QUOTE_NONNUMERIC,
            lineterminator="\n",
        )
        further, values = _further_columns(sensor_map)
        table.writerow(("name", *axis_names(sensor_map.dimensions), *_EXTRA_COLUMNS, *further))
        for name, position, component, health, more in zip(
            sensor_map.names,
            sensor_map.positions.tolist(),
            sensor_map.component.tolist(),
            sensor_map.health,
            values.tolist(),
            strict=True,
        ):
            guarded = delimited.guard_formula(name), delimited.guard_formula(health)
            table.writerow((guarded[0], *position, component, guarded[1], *more))


def _further_columns(sensor_map: SensorMap) -> tuple[list[str], NDArray[np.float64]]:
    """Return the columns of errors, covariances and normals, if the map has them."""
    columns = [np.empty((sensor_map.n_sensors, 0))]
    names: list[str] = []
    if not np.isnan(sensor_map.errors).all():
        columns.append(sensor_map.errors[:, None])
        names.append(_ERROR)
    if sensor_map.covariances is not None:
        rows, others = np.triu_indices(sensor_map.dimensions)
        columns.append(sensor_map.covariances[:, rows, others])
        names += _covariance_names(sensor_map.dimensions)
    if sensor_map.normals is not None:
        columns.append(sensor_map.normals)
        names += _NORMAL
    return names, np.hstack(columns)


def _covariance_names(dimensions: int) -> list[str]:
    """Return the names of the columns of covariances: cov_xx, cov_xy, cov_yy."""
    axes = axis_names(dimensions)
    return [f"cov_{a}{b}" for i, a in enumerate(axes) for b in axes[i:]]


def _covariances(entries: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return matrices, shape (N, k, k), from their upper triangles, shape (k (k + 1) / 2, N)."""
    dimensions = (math.isqrt(8 * len(entries) + 1) - 1) // 2
    found = np.empty((entries.shape[1], dimensions, dimensions))
    rows, columns = np.triu_indices(dimensions)
    found[:, rows, columns] = found[:, columns, rows] = entries.T
    return found


def _without_trailing_columns(rows: list[delimited.Record]) -> list[delimited.Record]:
    """Drop the empty last columns of a table with delimiters at the end of every line."""
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
        spread = _covariance_names(len(axes))
        spread = spread if set(spread) <= set(words) else []
        kept = (*_EXTRA_COLUMNS, _ERROR, *spread, *_NORMAL)
        others = {word: i for i, word in enumerate(words) if word in kept}
        named = [words.index(word) for word in _NAMES if word in words]
        others |= {"name": named[0]} if named else {}
        return _Columns(
            tuple(found[axis][0] for axis in axes), others, found[axes[0]][1], True, tuple(spread)
        )
    start = 0 if is_number(fields[0], None) else 1
    coordinates = range(start, len(fields))
    if len(coordinates) in (2, 3) and all(is_number(fields[i], None) for i in coordinates):
        return _Columns(tuple(coordinates), {"name": 0} if start else {}, "", False)
    raise LineError(
        path,
        line,
        f" ({quote(', '.join(fields))}) gives no columns x and y; the table needs a header with "
        "x, y (and z), or two or three columns of numbers after an optional column of names",
    )


def _check_widths(path: Path, rows: Sequence[delimited.Record]) -> None:
    first, width = rows[0][0], len(rows[0][1])
    for line, fields in rows:
        if len(fields) != width:
            raise LineError(path, line, f" has {len(fields)} fields, but line {first} has {width}")


def _column(
    path: Path,
    rows: Sequence[delimited.Record],
    column: int,
    parse: Callable[[str], Value],
    expected: str = "text",
) -> tuple[Value, ...]:
    values = []
    for line, fields in rows:
        try:
            values.append(parse(fields[column]))
        except ValueError:
            problem = f", column {column + 1}: {quote(fields[column])} is not {expected}"
            raise LineError(path, line, problem) from None
    return tuple(values)


def _number(value: Scalar | None) -> float:
    return float(value) if isinstance(value, int | float) else math.nan


def _map_properties(lines: Sequence[str], units: str) -> dict[str, Any]:
    """Read the properties in the comments of a map written by anisomap."""
    if not lines[0].startswith(f"# {MAP_TITLE}"):
        return {"units": units}
    leading = itertools.takewhile(lambda line: line.startswith("#"), lines)
    entries, provenance = comments.read_comments(leading, "provenance")
    known = dict(entries)
    return {
        "units": str(known.get("units", units)),
        "method": str(known.get("method", "")),
        "stress": _number(known.get("stress")),
        "verdict": Verdict(
            str(known.get("verdict", UNKNOWN)),
            **{name: _number(known.get(name)) for name in ACCURACY},
            reasons=tuple(str(value) for key, value in entries if key == "reason"),
        ),
        "notes": tuple(str(value) for key, value in entries if key == "note"),
        **from_provenance(provenance),
    }


_SENSOR = ("sensor", "name", "taxel", "id")


def read_modules(path: str | os.PathLike[str], names: Sequence[str]) -> Modules:
    """Read which sensors are on which module.

    Parameters
    ----------
    path : path-like
        Delimited text with a header: ``sensor,module`` or ``sensor,module,pad``. Pads are numbered
        from 0; without them, the sensors of a module are its pads in the order of the file.
    names : sequence of str
        Names of the sensors; others in the file are left out.

    Returns
    -------
    Modules
        Without a template.

    Raises
    ------
    FileError
        If the file is missing, damaged, lacks a column, names a sensor twice, or has none of
        `names`.
    """
    file = Path(path)
    with file_errors(file):
        with open_text(file) as stream:
            lines = list(stream)
        rows = list(delimited.records(lines, delimited.find_delimiter(lines)))
        header = [field.strip().lower() for field in rows[0][1]] if rows else []
        sensor = next((header.index(word) for word in _SENSOR if word in header), None)
        if sensor is None or "module" not in header:
            raise FileError(f"{file} must have a header with the columns sensor, module (and pad)")
        module = header.index("module")
        pad = header.index("pad") if "pad" in header else None
        assigned: dict[str, tuple[str, int | None]] = {}
        for line, fields in rows[1:]:
            if len(fields) != len(header):
                raise LineError(file, line, f" has {len(fields)} fields, not {len(header)}")
            name = fields[sensor].strip()
            if name in assigned:
                raise LineError(file, line, f": sensor {quote(name)} is listed twice")
            text = None if pad is None else fields[pad].strip()
            if text is not None and not (text.isascii() and text.isdigit() and len(text) < 10):
                raise LineError(file, line, f": pad {quote(text)} must be a whole number from 0")
            assigned[name] = (fields[module].strip(), None if text is None else int(text))
        return modules_by_name(names, assigned)
