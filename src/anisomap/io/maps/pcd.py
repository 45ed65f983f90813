"""ASCII PCD point clouds with normals, for the Point Cloud Library and its viewers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from anisomap.errors import FileError
from anisomap.io.parsing import facts as comments
from anisomap.io.parsing.source import quote, read_lines
from anisomap.io.parsing.table import LineError, parse_row
from anisomap.placement import pad_to_3d, surface_normals
from anisomap.recording import Scalar
from anisomap.sensor_map import SensorMap

_FIELDS = ("x", "y", "z", "normal_x", "normal_y", "normal_z")
_MAX_DIGITS = 9  # of a number of points: more are in no file, and Python converts few thousand


def recognises(path: Path, head: bytes) -> bool:
    """Recognise a PCD file by VERSION in its first line that is not a comment."""
    lines = (line.strip() for line in head.splitlines())
    return next((line for line in lines if line and line[:1] != b"#"), b"")[:8] == b"VERSION "


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write the placed sensors of a map of up to three dimensions as points with normals."""
    indices = np.flatnonzero(sensor_map.placed)
    points = np.hstack([pad_to_3d(sensor_map.positions), surface_normals(sensor_map)])[indices]
    known: dict[str, Scalar] = {
        "units": sensor_map.units,
        "dimensions": sensor_map.dimensions,
        **sensor_map.reference,
        "normals": "estimated from the positions" if sensor_map.normals is None else "of the map",
        **{f"sensor {row}": sensor_map.names[i] for row, i in enumerate(indices)},
        **{
            f"error {row}": float(sensor_map.errors[i])
            for row, i in enumerate(indices)
            if np.isfinite(sensor_map.errors[i])
        },
    }
    count = len(indices)
    head = [
        *(f"# {key}: {comments.format_value(value)}" for key, value in known.items()),
        "VERSION 0.7",
        f"FIELDS {' '.join(_FIELDS)}",
        f"SIZE {' '.join('8' for _ in _FIELDS)}",
        f"TYPE {' '.join('F' for _ in _FIELDS)}",
        f"COUNT {' '.join('1' for _ in _FIELDS)}",
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA ascii",
    ]
    body = [" ".join(map(repr, row)) for row in points.tolist()]
    path.write_text("\n".join([*head, *body, ""]), encoding="utf-8")


def read_map(path: Path) -> SensorMap:
    """Read the points of an ASCII file as sensors.

    Files written by anisomap restore the names; in other files they are s0, s1, ...
    """
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
    positions = [_position(path, fields, number, line) for number, line in rows if line.strip()]
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


def _position(path: Path, fields: list[str], number: int, line: str) -> list[float]:
    words = line.split()
    if len(words) != len(fields):
        problem = f" has {len(words)} numbers, but the header announces {len(fields)}"
        raise LineError(path, number, problem)
    return parse_row(path, number, words, {fields.index(axis): axis for axis in "xyz"})
