"""Files of points: PLY, and taxel positions of the iCub.

They contain the placed sensors of a map of up to three dimensions. ASCII point clouds (PLY for mesh
viewers) store coordinates as doubles, so that they are read back equal. Comments restore the names;
names in other files are s0, s1, ...

Source: Turk (1994), The PLY polygon file format.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError, InputError
from anisomap.io.maps.edits import LineEdit, edited_rows, lines_of
from anisomap.io.parsing.facts import format_value, read_comments
from anisomap.io.parsing.names import distinct_names, numbers_of
from anisomap.io.parsing.source import numbered_lines, quote, read_lines
from anisomap.io.parsing.tables import LineError, parse_row
from anisomap.placement import pad_to_3d, surface_normals, to_taxels
from anisomap.recording import Scalar
from anisomap.sensor_map import SensorMap

_AXES = ("x", "y", "z")
_PLY_COLUMNS = (*_AXES, "nx", "ny", "nz")
_MOST = 2**31  # maximum numbers of sensors and components
_MAX_DIGITS = 9  # of a number of points; Python refuses to convert thousands of digits


def is_ply(path: Path, head: bytes) -> bool:
    """Recognise a PLY file by its first line."""
    return head.splitlines()[:1] == [b"ply"]


def write_ply(sensor_map: SensorMap, path: Path) -> None:
    """Write the placed sensors as vertices, each with its index in the map and its component."""
    numbers = np.flatnonzero(sensor_map.placed).tolist()
    head = [
        "ply",
        "format ascii 1.0",
        f"comment anisomap map, {sensor_map.pose}",
        *(f"comment {fact}" for fact in _facts(sensor_map)),
        f"element vertex {len(numbers)}",
        *(f"property double {column}" for column in _PLY_COLUMNS),
        "property int sensor",
        "property int component",
        "end_header",
    ]
    rows = np.hstack([pad_to_3d(sensor_map.positions), surface_normals(sensor_map)])
    body = [
        f"{' '.join(map(repr, rows[i].tolist()))} {i} {sensor_map.component[i]}" for i in numbers
    ]
    path.write_text("\n".join([*head, *body, ""]), encoding="utf-8")


def _facts(sensor_map: SensorMap) -> list[str]:
    """Format properties that a point cloud cannot represent."""
    placed = np.flatnonzero(sensor_map.placed).tolist()
    errors = {i: float(sensor_map.errors[i]) for i in placed}
    known: dict[str, Scalar] = {
        "method": sensor_map.method,
        "units": sensor_map.units,
        **sensor_map.reference,
        "dimensions": sensor_map.dimensions,
        "normals": "estimated from the positions" if sensor_map.normals is None else "of the map",
        **{f"sensor {i}": sensor_map.names[i] for i in placed},
        **{f"error {i}": each for i, each in errors.items() if math.isfinite(each)},
    }
    return [f"{key}: {format_value(value)}" for key, value in known.items()]


def read_ply(path: Path) -> SensorMap:
    """Read the vertices of an ASCII file as sensors; other elements are skipped."""
    counts, columns = dict[str, int](), dict[str, list[str]]()
    remarks, element = list[str](), ""
    lines = numbered_lines(path)
    for number, line in lines:
        match line.split():
            case ["end_header"]:
                break
            case ["format", kind, *_] if kind != "ascii":
                raise LineError(path, number, f": the PLY format must be ascii, got {quote(kind)}")
            case ["comment", *_]:
                remarks.append(line.removeprefix("comment"))
            case ["element", element, count] if count.isdecimal() and len(count) <= _MAX_DIGITS:
                counts[element], columns[element] = int(count), []
            case ["property", _, *_, name] if element:
                columns[element].append(name)
            case ["ply"] | ["format", *_] | ["obj_info", *_] | []:
                pass
            case _:
                raise LineError(path, number, f": {quote(line)} is not valid in a PLY header")
    else:
        raise FileError(f"{path} ends within its PLY header")
    n_vertices = counts.get("vertex", 0)
    before = itertools.takewhile(lambda name: name != "vertex", counts)
    skipped = sum(counts[name] for name in before)
    vertices = itertools.islice(lines, skipped, skipped + n_vertices)
    return _read_vertices(path, columns.get("vertex", []), vertices, remarks, n_vertices)


def _read_vertices(
    path: Path, columns: list[str], lines: Iterable[tuple[int, str]], remarks: list[str], count: int
) -> SensorMap:
    """Read the vertices declared in a header; comments restore other properties."""
    if not count or not set(_AXES) <= set(columns):
        raise FileError(f"{path} holds no vertices with x, y and z")
    wanted = {columns.index(n): n for n in (*_AXES, "sensor", "component") if n in columns}
    rows = []
    for number, line in lines:
        fields = line.split()
        if len(fields) != len(columns):
            problem = f" has {len(fields)} instead of {len(columns)} numbers, as in the header"
            raise LineError(path, number, problem)
        rows.append(parse_row(path, number, fields, wanted))
    if len(rows) != count:
        raise FileError(f"{path} is damaged: it has {len(rows)} of {count} vertices")
    values = dict(zip(wanted.values(), np.array(rows).T, strict=True))
    if any(np.isinf(values[axis]).any() for axis in _AXES):
        raise FileError(f"{path}: x, y and z must be finite, or nan for a sensor without a place")
    known = dict(read_comments(remarks, "")[0])
    dimensions = 2 if known.get("dimensions") == 2 else len(_AXES)
    numbers = _integers(path, values.get("sensor", np.arange(count, dtype=np.float64)))
    return SensorMap(
        np.column_stack([values[axis] for axis in _AXES[:dimensions]]),
        names=distinct_names(path, [str(known.get(f"sensor {i}", f"s{i}")) for i in numbers]),
        component=_integers(path, values.get("component", np.empty(0))),
        units=str(known.get("units", "")),
    )


def _integers(path: Path, values: NDArray[np.float64]) -> NDArray[np.intp]:
    if not ((np.abs(values) < _MOST) & (values == np.floor(values))).all():
        raise FileError(f"{path}: sensor and component must be integers below {_MOST}")
    return values.astype(np.intp)


_BOARD = 192  # values per board: 16 triangles of 12
_MAX_VALUES = 100_000
_REPRESENTATIVES = re.compile(r"taxel2Repr\s*+\(")


def is_icub(path: Path, head: bytes) -> bool:
    """Recognise the file by its keyword taxel2Repr."""
    return b"taxel2Repr" in head


def write_icub(sensor_map: SensorMap, path: Path) -> None:
    """Write ``x y z nx ny nz`` for each value of a port, in metres, zeros without a taxel.

    Unique numbers at the ends of all names (``taxel97``) are the indices on the port. The last line
    contains zeros, because some readers drop it. No line starts with a blank, which other readers
    reject.
    """
    skin = to_taxels(sensor_map, "a file of taxel positions")
    ports = np.array(numbers_of(sensor_map.names) or range(sensor_map.n_sensors))[skin.indices]
    if ports.max() >= _MAX_VALUES:
        raise InputError(
            f"port index {ports.max()} must be below {_MAX_VALUES}; rename the sensors"
        )
    # A multiple of the board size, and at least one line of zeros after the last taxel.
    n_values = (int(ports.max()) // _BOARD + 1) * _BOARD
    rows = np.zeros((n_values + 1, 6))
    rows[ports] = np.hstack([skin.positions, skin.normals])
    representatives = np.full(n_values + 1, -1)
    representatives[ports] = ports
    lines = [
        f"name {re.sub(r'[^A-Za-z0-9_.-]', '_', skin.frame) or 'skin'}",
        "spatial_sampling taxel",
        f"taxel2Repr ( {' '.join(map(str, representatives.tolist()))} )",
        "[calibration]",
        *(" ".join("0" if v == 0 else repr(v) for v in row) for row in rows.tolist()),
    ]
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def read_icub(path: Path) -> SensorMap:
    """Read the taxels, named by port index (``taxel97``); values without a taxel are skipped."""
    lines = [line.strip() for line in read_lines(path)]
    if "[calibration]" not in lines:
        raise FileError(f"{path} lacks the line [calibration] that precedes the positions")
    start = lines.index("[calibration]") + 1
    header = " ".join(lines[: start - 1])
    opening = _REPRESENTATIVES.search(header)
    listed, closing, _ = header[opening.end() :].partition(")") if opening else ("", "", "")
    if not closing:
        raise FileError(f"{path}: taxel2Repr must be followed by numbers in brackets")
    representatives = listed.split()
    positions = {}
    body = [(number, line.split()) for number, line in enumerate(lines[start:], start + 1) if line]
    # Some programs drop the last line, and some list values without a taxel beyond the lines.
    n_taxels = max((i for i, one in enumerate(representatives, 1) if one != "-1"), default=0)
    if len(body) < min(n_taxels, len(representatives) - 1):
        problem = f"taxel2Repr lists {n_taxels} values, but {len(body)} lines follow"
        raise FileError(f"{path} is cut short: {problem}")
    for value, (number, fields) in enumerate(body):
        if len(fields) not in (6, 7):
            problem = f" has {len(fields)} instead of 6 numbers, x y z nx ny nz"
            raise LineError(path, number, problem)
        row = parse_row(path, number, fields, dict.fromkeys(range(6), ""))
        if not np.isfinite(row).all():
            raise LineError(path, number, f": {quote(' '.join(fields))} must hold finite numbers")
        absent = value < len(representatives) and representatives[value] == "-1"
        if not absent and any(row):
            positions[f"taxel{value}"] = row[:3]
    if not positions:
        raise FileError(f"{path} holds no taxel: all lines are zeros")
    return SensorMap(np.array(list(positions.values())), names=tuple(positions), units="m")


def edit_icub(path: Path, stated: SensorMap, corrected: SensorMap) -> list[LineEdit]:
    """Return the lines of taxels with changed places; normals are moved with the places."""
    lines = [line.rstrip("\r\n") for line in lines_of(path)]
    start = next(i for i, line in enumerate(lines, 1) if line.strip() == "[calibration]")
    body = [(i, line) for i, line in enumerate(lines[start:], start + 1) if line.strip()]
    rows = {}
    for sensor, value in enumerate(numbers_of(stated.names) or ()):
        number, line = body[value]
        spans = [match.span() for match in re.finditer(r"\S+", line)]
        rows[sensor] = (number, line, spans[: len(_PLY_COLUMNS)])
    return edited_rows(stated, corrected, rows)
