"""Maps as PLY point clouds, in ASCII, for viewers of meshes and clouds.

Only sensors that have a position are in them, each with its number in the map, its component, and
its normal as the positions tell it.
The format is that of Turk (1994), "The PLY polygon file format"; numbers are doubles, so that
nothing is lost.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError, InputError
from anisomap.io.parsing import comments
from anisomap.io.parsing.source import opened, quoted
from anisomap.io.parsing.table import LineError, parse_number
from anisomap.placement import in_space, normals_of
from anisomap.recording import Scalar
from anisomap.sensor_map import SensorMap

_MAGIC = b"ply"
_AXES = ("x", "y", "z")
_NORMAL = ("nx", "ny", "nz")
_MOST_LINES = 1 << 31

Line = tuple[int, str]


@dataclass(frozen=True)
class _Header:
    """What stands before the body: kinds of lines in their order, their columns, and comments."""

    counts: dict[str, int]
    columns: dict[str, list[str]]
    known: dict[str, Scalar]


def recognises(path: Path, head: bytes) -> bool:
    """Tell a PLY file by its first line."""
    return head.splitlines()[:1] == [_MAGIC]


def read_map(path: Path) -> SensorMap:
    """Read the vertices of a PLY file as positions.

    Parameters
    ----------
    path : pathlib.Path
        An ASCII file whose vertices have x, y and z. Faces and other properties are passed over.

    Returns
    -------
    SensorMap
        A sensor a vertex. In files of ours they have the names and components that they had in
        the map, where sensors without a position are missing; others are named s0, s1, ...

    Raises
    ------
    FileError
        With the line of what cannot be read, or if the file is a binary PLY.
    """
    with opened(path) as stream:
        lines = enumerate((line.decode("utf-8", "replace").strip() for line in stream), start=1)
        header = _read_header(path, lines)
        rows = _read_vertices(path, header, lines)
    values = dict(zip(header.columns["vertex"], np.array(rows).T, strict=True))
    numbers = _whole(path, values.get("sensor", np.arange(len(rows), dtype=np.float64)))
    dimensions = 2 if header.known.get("dimensions") == 2 else len(_AXES)
    return SensorMap(
        np.column_stack([values[axis] for axis in _AXES[:dimensions]]),
        names=tuple(str(header.known.get(f"sensor {i}", f"s{i}")) for i in numbers),
        component=_whole(path, values.get("component", np.empty(0))),
        units=str(header.known.get("units", "")),
    )


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write the sensors of a map that have a position as vertices.

    Parameters
    ----------
    sensor_map : SensorMap
        In up to three dimensions; those that are missing become 0.
    path : pathlib.Path
        Where.

    Raises
    ------
    InputError
        If the map has more than three dimensions.
    """
    if sensor_map.dimensions > len(_AXES):
        raise InputError(f"PLY holds points in space, but the map has {sensor_map.dimensions} axes")
    numbers = np.flatnonzero(sensor_map.placed).tolist()
    known: dict[str, Scalar] = {
        "method": sensor_map.method,
        "units": sensor_map.units,
        **sensor_map.reference,
        "dimensions": sensor_map.dimensions,
        **{f"sensor {i}": sensor_map.names[i] for i in numbers},
    }
    points = np.hstack([in_space(sensor_map.positions), normals_of(sensor_map)])
    head = [
        "ply",
        "format ascii 1.0",
        f"comment anisomap map, known up to {sensor_map.known_up_to}",
        "comment normals are estimated from the positions",
        *(f"comment {key}: {comments.written(value)}" for key, value in known.items()),
        f"element vertex {len(numbers)}",
        *(f"property double {column}" for column in (*_AXES, *_NORMAL)),
        "property int sensor",
        "property int component",
        "end_header",
    ]
    body = [
        f"{' '.join(map(repr, points[i].tolist()))} {i} {sensor_map.component[i]}" for i in numbers
    ]
    path.write_text("\n".join((*head, *body)) + "\n", encoding="utf-8")


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
                raise LineError(path, number, f": this PLY is {kind}; save it as ASCII")
            case ["comment", *_]:
                remarks.append(line.removeprefix("comment"))
            case ["element", element, count] if count.isdecimal() and int(count) < _MOST_LINES:
                counts[element], columns[element] = int(count), []
            case ["property", _, *_, name] if element:
                columns[element].append(name)
            case ["ply"] | ["format", *_] | ["obj_info", *_] | []:
                pass
            case _:
                raise LineError(path, number, f": {quoted(line)} does not belong into a PLY header")
    else:
        raise FileError(f"{path} ends before the end of its PLY header")
    if not counts.get("vertex") or not set(_AXES) <= set(columns["vertex"]):
        raise FileError(f"{path} is a PLY file without vertices that have x, y and z")
    return _Header(counts, columns, dict(comments.read_comments(remarks, "")[0]))


def _read_vertices(path: Path, header: _Header, lines: Iterator[Line]) -> list[list[float]]:
    before = itertools.takewhile(lambda name: name != "vertex", header.counts)
    skipped = sum(header.counts[name] for name in before)
    body = itertools.islice(lines, skipped, skipped + header.counts["vertex"])
    rows = [_row(path, header.columns["vertex"], number, line) for number, line in body]
    if len(rows) < header.counts["vertex"]:
        raise FileError(
            f"{path} is cut short: {len(rows)} of {header.counts['vertex']} vertices are in it"
        )
    return rows


def _row(path: Path, columns: Sequence[str], number: int, line: str) -> list[float]:
    fields = line.split()
    if len(fields) != len(columns):
        problem = f" has {len(fields)} numbers, but the header announces {len(columns)}"
        raise LineError(path, number, problem)
    values = []
    for column, field in enumerate(fields):
        try:
            values.append(parse_number(field))
        except ValueError:
            problem = f", column {column + 1} ({columns[column]}): {quoted(field)} is not a number"
            raise LineError(path, number, problem) from None
    return values


def _whole(path: Path, values: NDArray[np.float64]) -> NDArray[np.intp]:
    if not all(math.isfinite(value) and value == int(value) for value in values.tolist()):
        raise FileError(f"{path}: sensor and component must be whole numbers")
    return values.astype(np.intp)
