"""The iCub's files of taxel positions: one line a value of the port, in metres.

Four lines of header, then ``x y z nx ny nz`` for each value of the port, zeros where there is no
taxel. ``taxel2Repr`` tells for each value which taxel stands for it, -1 for none. One program that
reads these files drops the last line, so it is one of zeros; another trips over leading blanks.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError, InputError
from anisomap.io.parsing.source import opened_text, quoted
from anisomap.io.parsing.table import LineError, parse_number
from anisomap.placement import taxels
from anisomap.sensor_map import SensorMap

_BOARD = 192  # values a board: 16 triangles of 12
_MOST_VALUES = 100_000
_NUMBERED = re.compile(r".*?(\d+)")


def recognises(path: Path, head: bytes) -> bool:
    """Tell such a file by the word that no other has."""
    return b"taxel2Repr" in head


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map for the iCub's software.

    Parameters
    ----------
    sensor_map : SensorMap
        With a scale, in one piece. If every name ends in a number of its own (``taxel97``), that is
        the index on the port; else the sensors are numbered in their order.
    path : pathlib.Path

    Raises
    ------
    InputError
        If the map has no scale, is in pieces, or a number is beyond any port.
    """
    skin = taxels(sensor_map, "a file of taxel positions")
    ports = _port_indices(sensor_map.names)[skin.indices]
    if ports.max() >= _MOST_VALUES:
        raise InputError(
            f"sensor {skin.names[int(ports.argmax())]} would be value {ports.max()} of a port, "
            "and no port has so many; rename the sensors"
        )
    # Whole boards, and at least one line of zeros after the last taxel.
    n_values = (int(ports.max()) // _BOARD + 1) * _BOARD
    rows = np.zeros((n_values + 1, 6))
    rows[ports] = np.hstack([skin.positions, skin.normals])
    stands_for = np.full(n_values + 1, -1)
    stands_for[ports] = ports
    lines = [
        f"name {re.sub(r'[^A-Za-z0-9_.-]', '_', skin.frame) or 'skin'}",
        "spatial_sampling taxel",
        f"taxel2Repr ( {' '.join(map(str, stands_for.tolist()))} )",
        "[calibration]",
        *(" ".join("0" if v == 0 else repr(v) for v in row) for row in rows.tolist()),
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_map(path: Path) -> SensorMap:
    """Read taxel positions.

    Parameters
    ----------
    path : pathlib.Path

    Returns
    -------
    SensorMap
        The taxels, without the values of the port that have none, named after their index on the
        port: ``taxel97``. Metres.

    Raises
    ------
    FileError
        With the line of what cannot be read, or if there is no taxel.
    """
    with opened_text(path) as stream:
        lines = [line.strip() for line in stream]
    if "[calibration]" not in lines:
        raise FileError(f"{path} has no line [calibration], after which the positions stand")
    start = lines.index("[calibration]") + 1
    header = " ".join(lines[: start - 1])
    listed = re.search(r"taxel2Repr\s*\(([^)]*)\)", header)
    if listed is None:
        raise FileError(f"{path}: taxel2Repr must be followed by numbers between brackets")
    stands_for = listed[1].split()
    places = {}
    body = [(start + i + 1, line) for i, line in enumerate(lines[start:]) if line]
    for value, (number, line) in enumerate(body):
        row = _row(path, number, line)
        absent = value < len(stands_for) and stands_for[value] == "-1"
        if not absent and any(row):
            places[f"taxel{value}"] = row[:3]
    if not places:
        raise FileError(f"{path} holds no taxel: every line is zeros")
    return SensorMap(np.array(list(places.values())), names=tuple(places), units="m")


def _row(path: Path, number: int, line: str) -> list[float]:
    fields = line.split()
    if len(fields) not in (6, 7):
        raise LineError(path, number, f" has {len(fields)} numbers; it must be x y z nx ny nz")
    try:
        row = [parse_number(field) for field in fields[:6]]
    except ValueError:
        raise LineError(path, number, f": {quoted(line)} are not numbers") from None
    if not np.isfinite(row).all():
        raise LineError(path, number, f": {quoted(line)} is no place")
    return row


def _port_indices(names: tuple[str, ...]) -> NDArray[np.intp]:
    found = [_NUMBERED.fullmatch(name) for name in names]
    indices = [int(match[1]) for match in found if match and len(match[1]) < 10]
    if len(indices) == len(names) == len(set(indices)):
        return np.array(indices, dtype=np.intp)
    return np.arange(len(names))
