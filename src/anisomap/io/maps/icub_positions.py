"""Taxel position files of the iCub: one line per value of a port, in metres.

Four header lines are followed by ``x y z nx ny nz`` for each value, zeros without a taxel.
``taxel2Repr`` gives the representative taxel of each value, -1 for none. The last line is zeros,
because one reader of these files drops it; lines do not start with blanks, which another rejects.
"""

from __future__ import annotations

import re
import string
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError, InputError
from anisomap.io.parsing.source import quote, read_lines
from anisomap.io.parsing.table import LineError, parse_number
from anisomap.placement import to_taxels
from anisomap.sensor_map import SensorMap

_BOARD = 192  # values per board: 16 triangles of 12
_MAX_VALUES = 100_000
_REPRESENTATIVES = re.compile(r"taxel2Repr\s*+\(")


def recognises(path: Path, head: bytes) -> bool:
    """Recognise the file by its keyword taxel2Repr."""
    return b"taxel2Repr" in head


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map with a scale and one component.

    If all names end in unique numbers (``taxel97``), these are the indices on the port; otherwise
    sensors are numbered in order.
    """
    skin = to_taxels(sensor_map, "a file of taxel positions")
    ports = _port_indices(sensor_map.names)[skin.indices]
    if ports.max() >= _MAX_VALUES:
        raise InputError(
            f"sensor {skin.names[int(ports.argmax())]} has port index {ports.max()}, which must be "
            f"below {_MAX_VALUES}; rename the sensors"
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
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def read_map(path: Path) -> SensorMap:
    """Read the taxels, named by port index (``taxel97``), without values that have no taxel."""
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
    body = [(start + i + 1, line) for i, line in enumerate(lines[start:]) if line]
    for value, (number, line) in enumerate(body):
        row = _row(path, number, line)
        absent = value < len(representatives) and representatives[value] == "-1"
        if not absent and any(row):
            positions[f"taxel{value}"] = row[:3]
    if not positions:
        raise FileError(f"{path} holds no taxel: all lines are zeros")
    return SensorMap(np.array(list(positions.values())), names=tuple(positions), units="m")


def _row(path: Path, number: int, line: str) -> list[float]:
    fields = line.split()
    if len(fields) not in (6, 7):
        raise LineError(path, number, f" has {len(fields)} fields; it must be x y z nx ny nz")
    try:
        row = [parse_number(field) for field in fields[:6]]
    except ValueError:
        raise LineError(path, number, f": {quote(line)} must hold numbers") from None
    if not np.isfinite(row).all():
        raise LineError(path, number, f": {quote(line)} must hold finite numbers")
    return row


def _port_indices(names: tuple[str, ...]) -> NDArray[np.intp]:
    ends = [name[len(name.rstrip(string.digits)) :] for name in names]
    indices = [int(digits) for digits in ends if 0 < len(digits) < 10]
    if len(indices) == len(names) == len(set(indices)):
        return np.array(indices, dtype=np.intp)
    return np.arange(len(names))
