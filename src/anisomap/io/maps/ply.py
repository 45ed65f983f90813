"""ASCII PLY point clouds (Turk 1994, "The PLY polygon file format"), for mesh viewers.

They hold the placed sensors, each with its index in the map, component and estimated normal.
Coordinates are doubles, so that they are read back equal.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing import facts as comments
from anisomap.io.parsing.naming import distinct_names
from anisomap.io.parsing.source import open_binary, quote
from anisomap.io.parsing.table import LineError, parse_row
from anisomap.placement import pad_to_3d, surface_normals
from anisomap.recording import Scalar
from anisomap.sensor_map import SensorMap

_MAGIC = b"ply"
_AXES = ("x", "y", "z")
_NORMAL = ("nx", "ny", "nz")
_MAX_DIGITS = 9  # of a number of elements: more are in no file, and Python converts few thousand

Line = tuple[int, str]


@dataclass(frozen=True)
class _Header:
    """Number of lines and column names of each element, in order, and entries in comments."""

    counts: dict[str, int]
    columns: dict[str, list[str]]
    known: dict[str, Scalar]


def recognises(path: Path, head: bytes) -> bool:
    """Recognise a PLY file by its first line."""
    return head.splitlines()[:1] == [_MAGIC]


def read_map(path: Path) -> SensorMap:
    """Read the vertices of an ASCII file as sensors; other elements are skipped.

    Files written by anisomap restore names and components; in other files names are s0, s1, ...
    """
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


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write the placed sensors of a map of up to three dimensions as vertices."""
    numbers = np.flatnonzero(sensor_map.placed).tolist()
    known: dict[str, Scalar] = {
        "method": sensor_map.method,
        "units": sensor_map.units,
        **sensor_map.reference,
        "dimensions": sensor_map.dimensions,
        **{f"sensor {i}": sensor_map.names[i] for i in numbers},
        **{
            f"error {i}": float(sensor_map.errors[i])
            for i in numbers
            if math.isfinite(sensor_map.errors[i])
        },
    }
    estimated = sensor_map.normals is None
    points = np.hstack([pad_to_3d(sensor_map.positions), surface_normals(sensor_map)])
    head = [
        "ply",
        "format ascii 1.0",
        f"comment anisomap map, known up to {sensor_map.known_up_to}",
        *(["comment normals are estimated from the positions"] if estimated else []),
        *(f"comment {key}: {comments.format_value(value)}" for key, value in known.items()),
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


def _row(path: Path, columns: Sequence[str], number: int, line: str) -> list[float]:
    fields = line.split()
    if len(fields) != len(columns):
        problem = f" has {len(fields)} numbers, but the header announces {len(columns)}"
        raise LineError(path, number, problem)
    return parse_row(path, number, fields, dict(enumerate(columns)))


def _integers(path: Path, values: NDArray[np.float64]) -> NDArray[np.intp]:
    if not all(math.isfinite(value) and value == int(value) for value in values.tolist()):
        raise FileError(f"{path}: sensor and component must be integers")
    return values.astype(np.intp)
