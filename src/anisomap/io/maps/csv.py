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
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.facts import (
    properties_of,
    read_comments,
    read_properties,
    write_comments,
)
from anisomap.io.parsing.names import distinct_names
from anisomap.io.parsing.source import file_errors, quote, read_lines
from anisomap.io.parsing.tables import (
    LineError,
    empty_columns,
    find_delimiter,
    guard_formula,
    is_number,
    parse_number,
    records,
    unguard_formula,
)
from anisomap.io.recordings.delimited_text import MAP_TITLE
from anisomap.placement.modules import Modules, modules_by_name
from anisomap.sensor_map import SensorMap, axis_names

_MAX_COLUMNS = 10_000  # covariances in 140 dimensions
_NAMES = ("name", "sensor", "taxel", "label", "id")
_ERROR, _NORMAL = "error", ("nx", "ny", "nz")
_AXIS = re.compile(r"(x\d*|y|z)(?:[ _]*[\[(]?(mm|cm|m|um|\u00b5m|in|px|pixels?)[\])]?)?")
_SEVERAL = {"reason": "reasons", "note": "notes"}  # comments with a line for each of a property


def read_map(path: Path) -> SensorMap:
    """Read a map, or true positions, from delimited text.

    Units come from the comments or the header (``x [mm]``), else they are empty. Errors give line
    and column.
    """
    lines = read_lines(path)
    if any(len(line) > _MAX_COLUMNS and _n_marks(line) > _MAX_COLUMNS for line in lines):
        raise FileError(f"{path} has a line of more than {_MAX_COLUMNS} columns; it is not a map")
    delimiter = find_delimiter(lines)
    rows = list(records(lines, delimiter))
    if not rows:
        raise FileError(f"{path} holds no line of positions")
    n_empty = empty_columns([fields for _, fields in rows])
    first, fields = rows[0][0], rows[0][1][: len(rows[0][1]) - n_empty]
    axes, header, units = _find_columns(path, first, fields)
    body = rows[1:] if header else rows
    if not body:
        raise FileError(f"{path} holds only a header")
    for line, row in rows:
        if len(row) - n_empty != len(fields):
            n_fields = len(row) - n_empty
            problem = f" has {n_fields} fields, but line {first} has {len(fields)}"
            raise LineError(path, line, problem)

    def column(index: int, parse: Callable[[str], Any], expected: str = "text") -> list[Any]:
        values = []
        for line, row in body:
            try:
                values.append(parse(row[index]))
            except ValueError:
                problem = f", column {index + 1}: {quote(row[index])} is not {expected}"
                raise LineError(path, line, problem) from None
        return values

    def numbers(*indices: int) -> NDArray[np.float64]:
        parse = functools.partial(parse_number, delimiter=delimiter)
        return np.array([column(i, parse, "a number") for i in indices])

    own = lines[0].startswith(f"# {MAP_TITLE}")
    is_map = "component" in header and "health" in header
    kept = header if is_map else {}
    parse_name = unguard_formula if own else str if is_map else str.strip
    # Without a header, names come before the numbers.
    name = next((header[word] for word in _NAMES if word in header), -1 if header else axes[0] - 1)
    covariances = [kept[entry] for entry in _covariance_names(len(axes)) if entry in kept]
    has_covariances = len(covariances) == len(_covariance_names(len(axes)))
    normals = [kept[axis] for axis in _NORMAL if axis in kept]
    return SensorMap(
        numbers(*axes).T,
        names=distinct_names(path, column(name, parse_name)) if name >= 0 else (),
        component=np.array(column(kept["component"], int, "an integer") if kept else (), np.intp),
        health=tuple(column(kept["health"], parse_name)) if kept else (),
        errors=numbers(kept[_ERROR])[0] if _ERROR in kept else np.empty(0),
        covariances=_covariances(numbers(*covariances)) if has_covariances else None,
        normals=numbers(*normals).T if len(normals) == len(_NORMAL) else None,
        **(_read_comments(lines, units) if own else {"units": units}),
    )


def _n_marks(line: str) -> int:
    """Return the number of delimiters in a line; comments, which may be long, have none."""
    return 0 if line.startswith("#") else sum(map(line.count, ",;\t "))


def _find_columns(
    path: Path, line: int, fields: Sequence[str]
) -> tuple[list[int], dict[str, int], str]:
    """Return the columns of coordinates, those of a header by name, and the unit."""
    words = [field.strip().lower() for field in fields]
    matches = [(i, match) for i, word in enumerate(words) if (match := _AXIS.fullmatch(word))]
    axes = {match[1]: (i, match[2] or "") for i, match in matches}
    known = axis_names(3) if "x" in axes else axis_names(len(axes) + 3)
    found = [axes[axis] for axis in known if axis in axes]
    if found:
        header = {word: i for i, word in reversed(list(enumerate(words)))}
        return [i for i, _ in found], header, found[0][1]
    start = 0 if is_number(fields[0], None) else 1
    if len(fields) - start in (2, 3) and all(is_number(f, None) for f in fields[start:]):
        return list(range(start, len(fields))), {}, ""
    raise LineError(
        path,
        line,
        f" ({quote(', '.join(fields))}) gives no columns x and y; the table needs a header with "
        "x, y (and z), or two or three columns of numbers after an optional column of names",
    )


def _read_comments(lines: Sequence[str], units: str) -> dict[str, Any]:
    """Read the properties in the comments of a map written by anisomap."""
    leading = itertools.takewhile(lambda line: line.startswith("#"), lines)
    entries, provenance = read_comments(leading, "provenance")
    several = {name: [v for key, v in entries if key == one] for one, name in _SEVERAL.items()}
    return read_properties({"units": units, **dict(entries), **several, "provenance": provenance})


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as comments and one line per sensor; every field is read back equal.

    Names that a spreadsheet would run as formulas are preceded by an apostrophe in the file.

    The suffix ``.tsv`` selects tabs, all others commas.
    """
    known = properties_of(sensor_map)
    provenance = known.pop("provenance")
    several = [(one, value) for one, name in _SEVERAL.items() for value in known.pop(name)]
    title = f"{MAP_TITLE}, {sensor_map.pose}"
    with path.open("w", encoding="utf-8", newline="") as stream:
        entries = [*known.items(), *several]
        stream.write(write_comments(title, entries, "provenance", provenance))
        table = csv.writer(
            stream,
            delimiter="\t" if path.suffix.lower() == ".tsv" else ",",
            quoting=csv.QUOTE_NONNUMERIC,
            lineterminator="\n",
        )
        further, values = _further_columns(sensor_map)
        axes = axis_names(sensor_map.dimensions)
        table.writerow(("name", *axes, "component", "health", *further))
        for name, position, component, health, more in zip(
            map(guard_formula, sensor_map.names),
            sensor_map.positions.tolist(),
            sensor_map.component.tolist(),
            map(guard_formula, sensor_map.health),
            values.tolist(),
            strict=True,
        ):
            table.writerow((name, *position, component, health, *more))


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
    pairs = itertools.combinations_with_replacement(axis_names(dimensions), 2)
    return [f"cov_{a}{b}" for a, b in pairs]


def _covariances(entries: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return matrices, shape (N, k, k), from their upper triangles, shape (k (k + 1) / 2, N)."""
    dimensions = (math.isqrt(8 * len(entries) + 1) - 1) // 2
    found = np.empty((entries.shape[1], dimensions, dimensions))
    rows, columns = np.triu_indices(dimensions)
    found[:, rows, columns] = found[:, columns, rows] = entries.T
    return found


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
        lines = read_lines(file)
        rows = list(records(lines, find_delimiter(lines)))
        header = [field.strip().lower() for field in rows[0][1]] if rows else []
        sensor = next((word for word in ("sensor", "name", "taxel", "id") if word in header), "")
        if not sensor or "module" not in header:
            raise FileError(f"{file} must have a header with the columns sensor, module (and pad)")
        assigned: dict[str, tuple[str, int | None]] = {}
        for line, fields in rows[1:]:
            if len(fields) != len(header):
                raise LineError(file, line, f" has {len(fields)} fields, not {len(header)}")
            row = dict(zip(header, map(str.strip, fields), strict=True))
            name, pad = row[sensor], row.get("pad")
            if name in assigned:
                raise LineError(file, line, f": sensor {quote(name)} is listed twice")
            if pad is not None and not (pad.isascii() and pad.isdigit() and len(pad) < 10):
                raise LineError(file, line, f": pad {quote(pad)} must be a whole number from 0")
            assigned[name] = (row["module"], None if pad is None else int(pad))
        return modules_by_name(names, assigned)
