"""Files ``*.ini`` by which the display of an iCub's skin (skinGui) places its triangles.

A line ``triangle_10pad NUMBER x y degrees gain mirror`` places a triangle, in millimetres. Where
the mirror is 1, the display shows a patch from behind: pads are reflected before they are turned.
Pads 6 and 10 of a triangle measure temperature.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.base.wording import counted
from anisomap.errors import FileError, InputError
from anisomap.io.parsing.source import quote, read_lines
from anisomap.io.parsing.tables import LineError, parse_row
from anisomap.numerics.procrustes import fit_similarity
from anisomap.placement.frames import METRES
from anisomap.placement.modules import MIN_PADS, channel_name, channels_of, modules_by_size
from anisomap.sensor_map import DEFAULT_FRAME, SensorMap

_TRIANGLE = "triangle_10pad"
_PADS = 12  # numbers per triangle
_THERMAL = (6, 10)
_COLUMNS = {2: "x", 3: "y", 4: "degrees"}
_MAX_TRIANGLE = 10_000
_MAX_MISFIT = 0.5  # mm; root mean square distance of the pads of a triangle
_GAIN = 4  # of displays in use
_MARGIN = 50  # of the picture, mm

PADS = np.array(
    [
        (6.533, 0.0), (9.8, -5.66), (3.267, -5.66), (0.0, 0.0), (-3.267, -5.66), (-9.8, -5.66),
        (-6.51, -3.75), (-6.533, 0.0), (-3.267, 5.66), (0.0, 11.317), (0.0, 7.507), (3.267, 5.66),
    ]
)  # fmt: skip
"""Positions of the pads of a triangle, in millimetres."""


def is_display(path: Path, head: bytes) -> bool:
    """Recognise the file by its section of sensors."""
    return re.search(rb"^[ \t]*+\[SENSORS\][ \t\r]*$", head, re.MULTILINE) is not None


def read_display(path: Path) -> SensorMap:
    """Read the pads as the display shows them, by triangle, with the names of the preset icub."""
    placed: dict[int, NDArray[np.float64]] = {}
    part, inside = "", False
    for number, line in enumerate(read_lines(path), 1):
        fields = line.partition("#")[0].split()
        if not fields:
            continue
        if fields[0].startswith("["):
            inside = fields[0] == "[SENSORS]"
        elif not inside:
            part = fields[1] if fields[0] == "robotPart" and len(fields) > 1 else part
        elif fields[0] != _TRIANGLE:
            problem = f": {quote(fields[0])} is not {_TRIANGLE}; only triangles can be read"
            raise LineError(path, number, problem)
        else:
            triangle, pads = _read_triangle(path, number, fields)
            if triangle in placed:
                raise LineError(path, number, f": triangle {triangle} is placed twice")
            placed[triangle] = pads
    if not placed:
        raise FileError(f"{path} has no line {_TRIANGLE} below [SENSORS]")
    kept = [pad for pad in range(_PADS) if pad not in _THERMAL]
    indices = [_PADS * triangle + pad for triangle in sorted(placed) for pad in kept]
    positions = np.concatenate([placed[triangle][kept] for triangle in sorted(placed)])
    names = tuple(map(channel_name, indices))
    return SensorMap(positions, names=names, units="mm", frame=part or DEFAULT_FRAME)


def _read_triangle(path: Path, line: int, fields: list[str]) -> tuple[int, NDArray[np.float64]]:
    if len(fields) not in (5, 6, 7):
        found = counted(len(fields), "field")
        problem = f" has {found}; it must be {_TRIANGLE} number x y degrees gain mirror"
        raise LineError(path, line, problem)
    if not (fields[1].isascii() and fields[1].isdigit() and int(fields[1]) < _MAX_TRIANGLE):
        raise LineError(path, line, f": {quote(fields[1])} is not the number of a triangle")
    x, y, degrees = parse_row(path, line, fields, _COLUMNS)
    mirror = fields[6] if len(fields) > 6 else "0"
    if mirror not in ("0", "1") or not np.isfinite([x, y, degrees]).all():
        problem = f": {quote(' '.join(fields))} must have finite numbers, and a mirror of 0 or 1"
        raise LineError(path, line, problem)
    angle, side = np.radians(degrees), -1 if mirror == "1" else 1
    cos, sin = np.cos(angle), np.sin(angle)
    return int(fields[1]), PADS * [side, 1] @ [[cos, sin], [-sin, cos]] + [x, y]


def write_display(sensor_map: SensorMap, path: Path) -> None:
    """Write a flat layout of triangles of an iCub, whose names give boards, triangles and pads."""
    placed = sensor_map.select(np.flatnonzero(sensor_map.placed))
    indices = channels_of(placed.names)
    if indices is None:
        raise InputError(
            "a display of an iCub's skin needs names of its pads, as b0.t3.k11 or taxel47, which "
            f"count {_PADS} pads of each triangle, but the map has {quote(placed.names[0])}"
        )
    if placed.dimensions != 2 or placed.units not in METRES:
        raise InputError("a display of an iCub's skin needs a map of 2 dimensions in mm, cm or m")
    positions = placed.positions * (METRES[placed.units] / METRES["mm"])
    numbers = [f"p{index}" for index in indices]
    modules = modules_by_size(numbers, _PADS, first=0)
    lines = []
    for m in range(modules.n_modules):
        members = modules.members(m)
        triangle = int(indices[members[0]]) // _PADS
        pads = PADS[modules.pads[members]]
        fit = None
        if len(members) >= MIN_PADS:
            fit = fit_similarity(pads, positions[members], scaling=False, reflection=None)
        off = np.inf if fit is None else fit.apply(pads) - positions[members]
        if fit is None or np.sqrt(np.mean(np.square(off)) * 2) > _MAX_MISFIT:
            raise InputError(
                f"the places of {placed.names[members[0]]} to {placed.names[members[-1]]} are not "
                f"those of a triangle of {_PADS} pads in millimetres"
            )
        turn = fit.rotation * ([-1, 1] if fit.reflected else [1, 1])
        degrees = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
        x, y = fit.translation.tolist()
        row = (_TRIANGLE, triangle, *(f"{0.0 + round(v, 3):g}" for v in (x, y, degrees)))
        lines.append("\t".join(map(str, (*row, _GAIN, int(fit.reflected)))))
    part = re.sub(r"[^A-Za-z0-9_.-]", "_", sensor_map.frame)
    width, height = (np.ptp(positions, axis=0) + 2 * _MARGIN).round().astype(int).tolist()
    head = [f"robotPart {part}", f"width {width}", f"height {height}", "", "[SENSORS]"]
    path.write_text("\n".join([*head, *lines, ""]), encoding="utf-8")
