"""ASCII point clouds with normals: PLY for mesh viewers, PCD for the Point Cloud Library.

They hold the placed sensors of a map of up to three dimensions. Coordinates are doubles, so that
they are read back equal; comments restore the names, which are s0, s1, ... in other files.

Sources: Turk (1994), The PLY polygon file format; the PCD file format of the Point Cloud Library.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing import facts as comments
from anisomap.io.parsing.naming import distinct_names
from anisomap.io.parsing.source import open_binary, quote, read_lines
from anisomap.io.parsing.table import LineError, parse_row
from anisomap.placement import pad_to_3d, surface_normals
from anisomap.recording import Scalar
from anisomap.sensor_map import SensorMap

_AXES = ("x", "y", "z")
_PLY_COLUMNS = (*_AXES, "nx", "ny", "nz")
_PCD_COLUMNS = (*_AXES, "normal_x", "normal_y", "normal_z")
_MAX_DIGITS = 9  # of a number of points: more are in no file, and Python converts few thousand

Line = tuple[int, str]


def is_ply(path: Path, head: bytes) -> bool:
    """Recognise a PLY file by its first line."""
    return head.splitlines()[:1] == [b"ply"]


def is_pcd(path: Path, head: bytes) -> bool:
    """Recognise a PCD file by VERSION in its first line that is not a comment."""
    lines = (line.strip() for line in head.splitlines())
    return next((line for line in lines if line and line[:1] != b"#"), b"")[:8] == b"VERSION "


def write_ply(sensor_map: SensorMap, path: Path) -> None:
    """Write the placed sensors as vertices, each with its index in the map and its component."""
    numbers = np.flatnonzero(sensor_map.placed).tolist()
    points = _points_and_normals(sensor_map)
    head = [
        "ply",
        "format ascii 1.0",
        f"comment anisomap map, {sensor_map.pose}",
        *(f"comment {fact}" for fact in _facts(sensor_map, numbers)),
        f"element vertex {len(numbers)}",
        *(f"property double {column}" for column in _PLY_COLUMNS),
        "property int sensor",
        "property int component",
        "end_header",
    ]
    body = [
        f"{point} {i} {sensor_map.component[i]}" for i, point in zip(numbers, points, strict=True)
    ]
    path.write_text("\n".join([*head, *body, ""]), encoding="utf-8")


def write_pcd(sensor_map: SensorMap, path: Path) -> None:
    """Write the placed sensors as points."""
    points = _points_and_normals(sensor_map)
    head = [
        *(f"# {fact}" for fact in _facts(sensor_map, range(len(points)))),
        "VERSION 0.7",
        f"FIELDS {' '.join(_PCD_COLUMNS)}",
        f"SIZE {' '.join('8' for _ in _PCD_COLUMNS)}",
        f"TYPE {' '.join('F' for _ in _PCD_COLUMNS)}",
        f"COUNT {' '.join('1' for _ in _PCD_COLUMNS)}",
        f"WIDTH {len(points)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(points)}",
        "DATA ascii",
    ]
    path.write_text("\n".join([*head, *points, ""]), encoding="utf-8")


def _points_and_normals(sensor_map: SensorMap) -> list[str]:
    rows = np.hstack([pad_to_3d(sensor_map.positions), surface_normals(sensor_map)])
    return [" ".join(map(repr, row)) for row in rows[sensor_map.placed].tolist()]


def _facts(sensor_map: SensorMap, numbers: Iterable[int]) -> list[str]:
    """Format what a point cloud cannot hold; `numbers` stand for the placed sensors."""
    placed = dict(zip(numbers, np.flatnonzero(sensor_map.placed).tolist(), strict=True))
    errors = {number: float(sensor_map.errors[i]) for number, i in placed.items()}
    known: dict[str, Scalar] = {
        "method": sensor_map.method,
        "units": sensor_map.units,
        **sensor_map.reference,
        "dimensions": sensor_map.dimensions,
        "normals": "estimated from the positions" if sensor_map.normals is None else "of the map",
        **{f"sensor {number}": sensor_map.names[i] for number, i in placed.items()},
        **{f"error {number}": each for number, each in errors.items() if math.isfinite(each)},
    }
    return [f"{key}: {comments.format_value(value)}" for key, value in known.items()]


@dataclass(frozen=True)
class _Header:
    """Number of lines and column names of each element, in order, and entries in comments."""

    counts: dict[str, int]
    columns: dict[str, list[str]]
    known: dict[str, Scalar]


def read_ply(path: Path) -> SensorMap:
    """Read the vertices of an ASCII file as sensors; other elements are skipped."""
    with open_binary(path) as stream:
        lines = enumerate((line.decode("utf-8", "replace").strip() for line in stream), start=1)
        header = _read_header(path, lines)
        rows = _read_vertices(path, header, lines)
    values = dict(zip(header.columns["vertex"], np.array(rows).T, strict=True))
    numbers = _integers(path, values.get("sensor", np.arange(len(rows), dtype=np.float64)))
    dimensions = 2 if header.known.get("dimensions") == 2 else len(_AXES)
    return SensorMap(
        np.column_stack([values[axis] for axis in _AXES[:dimensions]]),
        names=distinct_names(
            path, [str(header.known.get(f"sensor {i}", f"s{i}")) for i in numbers]
        ),
        component=_integers(path, values.get("component", np.empty(0))),
        units=str(header.known.get("units", "")),
    )


def _read_header(path: Path, lines: Iterator[Line]) -> _Header:
    counts: dict[str, int] = {}
    columns: dict[str, list[str]] = {}
    remarks: list[str] = []
    element = ""
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
    if not counts.get("vertex") or not set(_AXES) <= set(columns["vertex"]):
        raise FileError(f"{path} holds no vertices with x, y and z")
    return _Header(counts, columns, dict(comments.read_comments(remarks, "")[0]))


def _read_vertices(path: Path, header: _Header, lines: Iterator[Line]) -> list[list[float]]:
    before = itertools.takewhile(lambda name: name != "vertex", header.counts)
    skipped = sum(header.counts[name] for name in before)
    body = itertools.islice(lines, skipped, skipped + header.counts["vertex"])
    rows = [_row(path, header.columns["vertex"], number, line) for number, line in body]
    if len(rows) < header.counts["vertex"]:
        raise FileError(
            f"{path} is truncated: it holds {len(rows)} of {header.counts['vertex']} vertices"
        )
    return rows


def _row(
    path: Path, columns: Sequence[str], number: int, line: str, wanted: Sequence[str] | None = None
) -> list[float]:
    """Parse the wanted columns of a line; all by default."""
    fields = line.split()
    if len(fields) != len(columns):
        problem = f" has {len(fields)} numbers, but the header announces {len(columns)}"
        raise LineError(path, number, problem)
    places = range(len(columns)) if wanted is None else map(columns.index, wanted)
    return parse_row(path, number, fields, {i: columns[i] for i in places})


def _integers(path: Path, values: NDArray[np.float64]) -> NDArray[np.intp]:
    if not all(math.isfinite(value) and value == int(value) for value in values.tolist()):
        raise FileError(f"{path}: sensor and component must be integers")
    return values.astype(np.intp)


def read_pcd(path: Path) -> SensorMap:
    """Read the points of an ASCII file as sensors."""
    lines = list(enumerate(read_lines(path), start=1))
    remarks = [line.lstrip("# ") for _, line in lines if line.startswith("#")]
    known = dict(comments.read_comments(remarks, "")[0])
    fields: list[str] = []
    count = -1
    rows = iter(lines)
    for number, line in rows:
        match line.split():
            case ["FIELDS", *names]:
                fields = names
            case ["POINTS", text] if text.isdecimal() and len(text) <= _MAX_DIGITS:
                count = int(text)
            case ["DATA", "ascii"]:
                break
            case ["DATA", kind]:
                raise LineError(path, number, f": PCD data must be ascii, got {quote(kind)}")
            case _:
                pass
    else:
        raise FileError(f"{path} ends within its PCD header")
    if not set("xyz") <= set(fields) or count < 1:
        raise FileError(f"{path} holds no points with x, y and z")
    positions = [_row(path, fields, number, line, _AXES) for number, line in rows if line.strip()]
    if len(positions) != count:
        raise FileError(
            f"{path} is damaged: its header announces {count} points, but it has {len(positions)}"
        )
    dimensions = 2 if known.get("dimensions") == 2 else 3
    return SensorMap(
        np.array(positions)[:, :dimensions],
        names=tuple(str(known.get(f"sensor {i}", f"s{i}")) for i in range(count)),
        units=str(known.get("units", "")),
    )
