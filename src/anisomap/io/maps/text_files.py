"""Maps, true positions and lists of modules as delimited text; maps as JSON; CySkin's calibrations.

A map has comments and a table ``name, x, y, z, component, health``, followed by ``error``,
``cov_xx, cov_xy, ...`` and ``nx, ny, nz`` if there are errors, covariances and normals. A JSON file
contains the properties, then one object per sensor; NaN is null.
"""

from __future__ import annotations

import csv
import functools
import itertools
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from anisomap.base.clocks import is_time
from anisomap.errors import FileError
from anisomap.io.maps.edits import LineEdit, edited_rows, lines_of
from anisomap.io.parsing.facts import (
    properties_of,
    read_comments,
    read_properties,
    to_python_scalar,
    write_comments,
)
from anisomap.io.parsing.names import distinct_names
from anisomap.io.parsing.source import file_errors, quote, read_json, read_lines
from anisomap.io.parsing.tables import (
    LineError,
    empty_columns,
    field_error,
    find_delimiter,
    guard_formula,
    is_number,
    parse_number,
    records,
    unguard_formula,
)
from anisomap.io.recordings.delimited_text import MAP_TITLE, TITLE, open_recording
from anisomap.io.stream import ReadOptions
from anisomap.map_verdict import ACCURACY, UNKNOWN
from anisomap.placement.modules import Modules, modules_by_name
from anisomap.placement.placing import errors_in_mm
from anisomap.recording import Scalar
from anisomap.sensor_map import UNASSESSED, SensorMap, axis_names

_MAX_COLUMNS = 10_000  # covariances in 140 dimensions
_NAMES = ("name", "sensor", "taxel", "label", "id")
_ERROR, _NORMAL = "error", ("nx", "ny", "nz")
_AXIS = re.compile(r"(x\d*|y|z)(?:[ _]*[\[(]?(mm|cm|m|um|\u00b5m|in|px|pixels?)[\])]?)?")
_SEVERAL = {"reason": "reasons", "note": "notes"}  # comments with a line for each of a property


def read_text(path: Path) -> SensorMap:
    """Read a map, or true positions; units come from the comments or the header (``x [mm]``)."""
    lines = read_lines(path)
    if lines and lines[0].startswith(f"# {TITLE}"):
        return _positions_of(path)
    _refuse_wide(path, lines)
    delimiter = find_delimiter(lines)
    rows = list(records(lines, delimiter))
    if not rows:
        raise FileError(f"{path} holds no line of positions")
    n_empty = empty_columns([fields for _, fields in rows])
    rows = [(line, fields[: len(fields) - n_empty]) for line, fields in rows]
    first, fields = rows[0]
    axes, header, units = _find_columns(path, first, fields)
    body = rows[1:] if header else rows
    if not body:
        raise FileError(f"{path} holds only a header")
    for line, row in rows:
        if len(row) != len(fields):
            problem = f" has {len(row)} instead of {len(fields)} fields, as line {first} has"
            raise LineError(path, line, problem)

    def column(index: int, parse: Callable[[str], Any], expected: str = "text") -> list[Any]:
        values = []
        for line, row in body:
            try:
                values.append(parse(row[index]))
            except ValueError:
                problem = f"is not {expected}"
                raise field_error(path, line, index, row[index], problem=problem) from None
        return values

    def numbers(*indices: int) -> NDArray[np.float64]:
        parse = functools.partial(parse_number, delimiter=delimiter)
        return np.array([column(i, parse, "a number") for i in indices])

    own = lines[0].startswith(f"# {MAP_TITLE}")
    is_map = "component" in header and "health" in header
    kept = header if is_map else {}
    parse_name = unguard_formula if own else str if is_map else str.strip
    # Without a header, names are in front of the numbers.
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


def _refuse_wide(path: Path, lines: Sequence[str]) -> None:
    wide = (line for line in lines if len(line) > _MAX_COLUMNS and not line.startswith("#"))
    if any(sum(map(line.count, ",;\t ")) > _MAX_COLUMNS for line in wide):
        raise FileError(f"{path} has a line of more than {_MAX_COLUMNS} columns; it is not a map")


def _positions_of(path: Path) -> SensorMap:
    """Return the true positions of a recording."""
    with open_recording(path, ReadOptions()) as stream:
        if stream.positions is None:
            raise FileError(f"{path} is a recording without positions")
        return SensorMap(stream.positions, names=stream.names, units=stream.units)


def _find_columns(
    path: Path, line: int, fields: Sequence[str]
) -> tuple[list[int], dict[str, int], str]:
    """Return the columns of coordinates, columns of a header by name, and the unit."""
    words = [field.strip().lower() for field in fields]
    matches = [(i, match) for i, word in enumerate(words) if (match := _AXIS.fullmatch(word))]
    axes = {match[1]: (i, match[2] or "") for i, match in matches}
    known = axis_names(3) if "x" in axes else axis_names(len(axes) + 3)
    found = [axes[axis] for axis in known if axis in axes]
    if found:
        header = {word: i for i, word in reversed(list(enumerate(words)))}
        if clocks := [word for word, i in header.items() if is_time(word, i)]:
            problem = "so it is a recording, not a list of positions"
            raise FileError(f"{path} holds times (column {quote(clocks[0])}), {problem}")
        return [i for i, _ in found], header, found[0][1]
    start = 0 if is_number(fields[0], None) else 1
    if len(fields) - start in (2, 3) and all(is_number(f, None) for f in fields[start:]):
        return list(range(start, len(fields))), {}, ""
    needed = "the table needs a header with x, y (and z), or two or three columns of numbers"
    raise LineError(path, line, f" ({quote(', '.join(fields))}) gives no columns x and y; {needed}")


def _read_comments(lines: Sequence[str], units: str) -> dict[str, Any]:
    """Read the properties in the comments of a map written by anisomap."""
    leading = itertools.takewhile(lambda line: line.startswith("#"), lines)
    entries, provenance = read_comments(leading, "provenance")
    several = {name: [v for key, v in entries if key == one] for one, name in _SEVERAL.items()}
    return read_properties({"units": units, **dict(entries), **several, "provenance": provenance})


def write_text(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as comments and one line per sensor, with tabs if the suffix is ``.tsv``."""
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
        columns = _columns(sensor_map)
        table.writerow(columns)
        table.writerows(zip(*columns.values(), strict=True))


def edit_text(path: Path, stated: SensorMap, corrected: SensorMap) -> list[LineEdit] | None:
    """Return the lines of sensors with changed places; None if not every sensor has a line."""
    plain = [line.rstrip("\r\n") for line in lines_of(path)]
    delimiter = find_delimiter(plain)
    rows = list(records(plain, delimiter))
    if not rows:
        return None
    axes, header, _ = _find_columns(path, *rows[0])
    body = rows[1:] if header else rows
    normals = [header[axis] for axis in _NORMAL if axis in header]
    columns = [*axes, *(normals if len(normals) == len(_NORMAL) else [])]
    found = {}
    for sensor, (number, fields) in enumerate(body):
        line = plain[number - 1]
        spans = _spans(line, delimiter)
        if [line[slice(*span)] for span in spans] != [field.strip() for field in fields]:
            return None  # quotes, or records of several lines
        found[sensor] = (number, line, [spans[i] for i in columns])
    return edited_rows(stated, corrected, found) if len(found) == stated.n_sensors else None


def _spans(line: str, delimiter: str | None) -> list[tuple[int, int]]:
    """Return the spans of the fields of a line, without enclosing blanks."""
    pattern = r"\S+" if delimiter is None or delimiter == " " else rf"[^{re.escape(delimiter)}]*"
    found, end = [], -1
    for match in re.finditer(pattern, line):
        if match.start() > end:
            text = match[0]
            lead = len(text) - len(text.lstrip())
            found.append((match.start() + lead, match.start() + max(lead, len(text.rstrip()))))
            end = match.end()
    return found


def _columns(sensor_map: SensorMap) -> dict[str, Iterable[Any]]:
    """Return the columns of a map; errors, covariances and normals may be absent."""
    dimensions = sensor_map.dimensions
    columns: dict[str, Iterable[Any]] = {
        "name": map(guard_formula, sensor_map.names),
        **dict(zip(axis_names(dimensions), sensor_map.positions.T.tolist(), strict=True)),
        "component": sensor_map.component.tolist(),
        "health": map(guard_formula, sensor_map.health),
    }
    if not np.isnan(sensor_map.errors).all():
        columns[_ERROR] = sensor_map.errors.tolist()
    if sensor_map.covariances is not None:
        entries = sensor_map.covariances[:, *np.triu_indices(dimensions)]
        columns |= zip(_covariance_names(dimensions), entries.T.tolist(), strict=True)
    if sensor_map.normals is not None:
        columns |= zip(_NORMAL, sensor_map.normals.T.tolist(), strict=True)
    return columns


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
    """Read the modules of sensors.

    Parameters
    ----------
    path : path-like
        Delimited text with a header: ``sensor,module`` or ``sensor,module,pad``. Pads are numbered
        from 0; without pads, the sensors of a module are its pads in the order of the file.
    names : sequence of str
        Names of the sensors; other sensors in the file are left out.

    Returns
    -------
    Modules
        Modules without a template.

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
                raise LineError(file, line, f" has {len(fields)} instead of {len(header)} fields")
            row = dict(zip(header, map(str.strip, fields), strict=True))
            name, pad = row[sensor], row.get("pad")
            if name in assigned:
                raise LineError(file, line, f": sensor {quote(name)} is listed twice")
            if pad is not None and not (pad.isascii() and pad.isdigit() and len(pad) < 10):
                raise LineError(file, line, f": pad {quote(pad)} must be a whole number from 0")
            assigned[name] = (row["module"], None if pad is None else int(pad))
        return modules_by_name(names, assigned)


SIGNATURE = f'{{\n "format": "{MAP_TITLE}"'.encode()
# Strict JSON has no infinities; {"float": "inf"} differs from the string "inf".
_INFINITE = "float"


def is_json(path: Path, head: bytes) -> bool:
    """Recognise a JSON object by its start; a file of lines with one object each is not a map."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    first, _, rest = text.partition(b"\n")
    lines = first.rstrip().endswith(b"}") and rest.lstrip().startswith(b"{")
    return text.startswith(b"{") and text[1:].lstrip()[:1] in (b'"', b"}", b"") and not lines


def write_json(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as strict JSON; every field is read back equal."""
    known = properties_of(sensor_map)
    rest = {key: known.pop(key) for key in (*ACCURACY, "reasons")}
    known["verdict"] = {"level": known["verdict"], **rest, **errors_in_mm(sensor_map)}
    columns: dict[str, Sequence[Any]] = {
        "name": sensor_map.names,
        "position": sensor_map.positions.tolist(),
        "component": sensor_map.component.tolist(),
        "health": sensor_map.health,
        "error": sensor_map.errors.tolist(),
    }
    for key, values in (("covariance", sensor_map.covariances), ("normal", sensor_map.normals)):
        if values is not None:
            columns[key] = values.tolist()
    document = {
        "format": MAP_TITLE,
        "known_up_to": sensor_map.known_up_to,
        **known,
        "dimensions": sensor_map.dimensions,
        "sensors": [
            {k: v for k, v in zip(columns, row, strict=True) if k != "error" or not math.isnan(v)}
            for row in zip(*columns.values(), strict=True)
        ],
    }
    text = json.dumps(_to_json(document), indent=1, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def read_json_map(path: Path) -> SensorMap:
    """Read a map; the first sensor determines the properties besides positions."""
    document = read_json(path)
    listed = document.get("sensors") if isinstance(document, dict) else None
    if not isinstance(listed, list) or not listed:
        raise FileError(f"{path} is JSON without a list of sensors, so it is not a map")
    for i, sensor in enumerate(listed):
        if not isinstance(sensor, dict):
            raise FileError(f"{path}, sensor {i}: must be an object with a position")

    def typed(key: str, kind: type, default: object = None) -> list[Any]:
        values = [sensor.get(key, default) for sensor in listed]
        for i, value in enumerate(values):
            if type(value) is not kind:
                where, shown = f"{path}, sensor {i}: {key}", quote(str(value))
                raise FileError(f"{where} is {shown}; it must be {kind.__name__}")
        return values

    def numbers(key: str, *shape: int) -> list[Any]:
        return [
            _numbers(f"{path}, sensor {i}: {key}", sensor.get(key), shape)
            for i, sensor in enumerate(listed)
        ]

    first = listed[0]
    k = len(typed("position", list)[0])
    oriented = all("normal" in sensor for sensor in listed)
    return SensorMap(
        np.array(numbers("position", k)),
        names=distinct_names(path, typed("name", str) if "name" in first else []),
        component=np.array(typed("component", int) if "component" in first else [], np.intp),
        health=tuple(typed("health", str, UNASSESSED)),
        errors=np.array(numbers("error")),
        covariances=np.array(numbers("covariance", k, k)) if "covariance" in first else None,
        normals=np.array(numbers("normal", 3)) if oriented else None,
        **_read_json_properties(path, document),
    )


def _numbers(what: str, value: object, shape: tuple[int, ...]) -> Any:
    """Convert a number, or nested lists of numbers."""
    if not shape:
        try:
            return _from_json(value)
        except ValueError:
            raise FileError(f"{what} must hold numbers or null, got {quote(str(value))}") from None
    if not isinstance(value, list):
        raise FileError(f"{what} is {quote(str(value))}; it must be list")
    if len(value) != shape[0]:
        raise FileError(f"{what} must have {shape[0]} coordinates, got {len(value)}")
    return [_numbers(what, each, shape[1:]) for each in value]


def _read_json_properties(path: Path, document: dict[str, Any]) -> dict[str, Any]:
    try:
        verdict = dict(document.get("verdict", {}))
        stored = {**document, **verdict, "verdict": verdict.get("level", UNKNOWN)}
        numbers = {key: _from_json(stored.get(key)) for key in ("stress", *ACCURACY)}
        provenance = {
            key: value if isinstance(value, Scalar) else _from_json(value)
            for key, value in stored.get("provenance", {}).items()
        }
        return read_properties({**stored, **numbers, "provenance": provenance})
    except (ValueError, TypeError, AttributeError) as error:
        problem = "stress, notes, verdict or provenance is not as anisomap writes it"
        raise FileError(f"{path}: {problem} ({error})") from error


def _to_json(value: Any) -> Any:
    """Convert to values of strict JSON."""
    if isinstance(value, dict):
        return {key: _to_json(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_to_json(each) for each in value]
    scalar = to_python_scalar(value)
    if not isinstance(scalar, float) or math.isfinite(scalar):
        return scalar
    return None if math.isnan(scalar) else {_INFINITE: repr(scalar)}


def _from_json(value: object) -> float:
    """Invert `_to_json` for a number."""
    if value is None:
        return math.nan
    if isinstance(value, dict) and isinstance(value.get(_INFINITE), str):
        return float(value[_INFINITE])
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    raise ValueError(f"{value!r} is not a number")


def is_calibration(path: Path, head: bytes) -> bool:
    """Recognise a JSON object with the keys skin and taxels near its start."""
    return is_json(path, head) and all(key in head for key in (b'"skin"', b'"taxels"'))


def read_calibration(path: Path) -> SensorMap:
    """Read the taxels of all patches of CySkin by address; no module reads those of address 0."""
    document = read_json(path)
    skin = document.get("skin") if isinstance(document, dict) else None
    listed = skin.get("taxels") if isinstance(skin, dict) else None
    if not isinstance(listed, list):
        raise FileError(f"{path} is JSON without the taxels of a skin")
    # Some versions list them by patch.
    taxels = (taxel for each in listed for taxel in (each if isinstance(each, list) else [each]))
    found = [_taxel(f"{path}, taxel {i}", taxel) for i, taxel in enumerate(taxels)]
    kept = [taxel for taxel in found if taxel[0]]
    if not kept:
        raise FileError(f"{path} holds no taxel with an address")
    return SensorMap(
        np.array([position for _, position, _ in kept]),
        names=distinct_names(path, [str(address) for address, _, _ in kept]),
        normals=np.array([normal for _, _, normal in kept]),
        units="m",
    )


def _taxel(where: str, taxel: Any) -> tuple[int, list[float], list[float]]:
    """Return the address, position and unit normal of a taxel; NaN without a normal."""
    if not isinstance(taxel, dict):
        raise FileError(f"{where}: must be an object with id and x, got {quote(str(taxel))}")
    address, position, normal = taxel.get("id"), taxel.get("x"), taxel.get("n")
    if type(address) is not int or address < 0:
        raise FileError(f"{where}: id must be a whole number, got {quote(str(address))}")
    if not _is_point(position):
        raise FileError(f"{where}: x must be three finite numbers, got {quote(str(position))}")
    vector = normal if _is_point(normal) else [0.0] * 3
    length = math.hypot(*vector)
    unit = [x / length if 0 < length < math.inf else math.nan for x in vector]
    return address, [float(x) for x in position], unit


def _is_point(values: object) -> TypeGuard[list[float]]:
    return (
        isinstance(values, list)
        and [type(x) in (int, float) for x in values] == [True] * 3
        and all(map(math.isfinite, values))
    )
