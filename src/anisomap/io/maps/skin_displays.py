"""Files ``*.ini`` with the places of triangles in the display of an iCub's skin (skinGui).

A line ``triangle_10pad NUMBER x y degrees gain mirror`` places a triangle, in millimetres. If the
mirror is 1, the display shows a patch from behind: pads are reflected before they are turned.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.base import METRES
from anisomap.base.channels import PADS, TACTILE, channel_name, channels_of
from anisomap.base.wording import join_items
from anisomap.errors import FileError, InputError
from anisomap.io.maps.edits import LineEdit, changed_sensors, lines_of, replaced
from anisomap.io.parsing.source import quote, read_lines, warn
from anisomap.io.parsing.tables import LineError, parse_row
from anisomap.numerics.procrustes import fit_similarity
from anisomap.placement.modules import MIN_PADS, modules_by_size
from anisomap.sensor_map import DEFAULT_FRAME, SensorMap

_TRIANGLE = "triangle_10pad"
_PADS = 12  # numbers per triangle
_COLUMNS = {2: "x", 3: "y", 4: "degrees"}
_CENTRE = 3  # pad at the centre of a triangle
_LEAST = 14.0  # minimum distance of centres of triangles in mm; 18 for adjacent triangles
_MAX_NAMED = 6
_MIRROR = 6  # field of a line; optional
_ROUND = 0.05  # mm or degrees: stated numbers that differ by less are kept
_MAX_TRIANGLE = 10_000
_MAX_MISFIT = 0.5  # mm; root mean square distance of the pads of a triangle
_GAIN = 4  # of displays in use
_MARGIN = 50  # of the picture, mm


def is_display(path: Path, head: bytes) -> bool:
    """Recognise the file by its section of sensors."""
    return re.search(rb"^[ \t]*+\[SENSORS\][ \t\r]*$", head, re.MULTILINE) is not None


def read_display(path: Path) -> SensorMap:
    """Read the pads as displayed, by triangle, with the names of the preset icub."""
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
    _warn_of_overlaps(path, {triangle: pads[_CENTRE] for triangle, pads in placed.items()})
    indices = [_PADS * triangle + pad for triangle in sorted(placed) for pad in TACTILE]
    positions = np.concatenate([placed[triangle][[*TACTILE]] for triangle in sorted(placed)])
    names = tuple(map(channel_name, indices))
    return SensorMap(positions, names=names, units="mm", frame=part or DEFAULT_FRAME)


def _warn_of_overlaps(path: Path, centres: dict[int, NDArray[np.float64]]) -> None:
    numbers = sorted(centres)
    places = np.array([centres[number] for number in numbers])
    near = [
        f"{numbers[i]} and {numbers[j]}, {np.linalg.norm(places[i] - places[j]):.3g} mm apart"
        for i, j in sorted(KDTree(places).query_pairs(_LEAST))
    ]
    if near:
        least = "triangles side by side are 18 mm apart"
        warn(path, f"triangles lie on each other: {join_items(near, _MAX_NAMED)}; {least}")


def _read_triangle(path: Path, line: int, fields: list[str]) -> tuple[int, NDArray[np.float64]]:
    if len(fields) not in (5, 6, 7):
        problem = f" must be {_TRIANGLE} number x y degrees gain mirror, got {len(fields)} fields"
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
    """Write a flat layout of iCub triangles; names must give boards, triangles and pads."""
    placed = sensor_map.select(np.flatnonzero(sensor_map.placed))
    indices = channels_of(placed.names)
    if indices is None:
        first = quote(placed.names[0])
        raise InputError(f"a display needs names of pads, as b0.t3.k11 or taxel47, got {first}")
    if placed.dimensions != 2 or placed.units not in METRES:
        raise InputError("a display of an iCub's skin needs a map of 2 dimensions in mm, cm or m")
    positions = placed.positions * (METRES[placed.units] / METRES["mm"])
    numbers = [f"p{index}" for index in indices]
    modules = modules_by_size(numbers, _PADS, first=0)
    lines = []
    for m in range(modules.n_modules):
        members = modules.members(m)
        triangle = int(indices[members[0]]) // _PADS
        names = [placed.names[i] for i in members.tolist()]
        *pose, mirror = _pose(positions[members], modules.pads[members], names)
        row = (_TRIANGLE, triangle, *(f"{0.0 + round(v, 3):g}" for v in pose), _GAIN, mirror)
        lines.append("\t".join(map(str, row)))
    part = re.sub(r"[^A-Za-z0-9_.-]", "_", sensor_map.frame)
    width, height = (np.ptp(positions, axis=0) + 2 * _MARGIN).round().astype(int).tolist()
    head = [f"robotPart {part}", f"width {width}", f"height {height}", "", "[SENSORS]"]
    path.write_text("\n".join([*head, *lines, ""]), encoding="utf-8")


def _pose(
    positions: NDArray[np.float64], pads: NDArray[np.intp], names: Sequence[str]
) -> tuple[float, float, float, int]:
    """Return x, y, angle and mirror of a triangle from positions of its pads in mm."""
    fit = None
    if len(pads) >= MIN_PADS:
        fit = fit_similarity(PADS[pads], positions, scaling=False, reflection=None)
    off = np.inf if fit is None else fit.apply(PADS[pads]) - positions
    if fit is None or np.sqrt(np.mean(np.square(off)) * 2) > _MAX_MISFIT:
        raise InputError(f"{names[0]} to {names[-1]} are not placed as pads of a triangle, in mm")
    turn = fit.rotation * ([-1, 1] if fit.reflected else [1, 1])
    degrees = float(np.degrees(np.arctan2(turn[1, 0], turn[0, 0])))
    x, y = fit.translation.tolist()
    return x, y, degrees, int(fit.reflected)


def edit_display(path: Path, stated: SensorMap, corrected: SensorMap) -> list[LineEdit]:
    """Return the lines of triangles with changed places; correct numbers are kept."""
    indices = channels_of(stated.names)
    wrong = changed_sensors(stated, corrected)
    if indices is None or not wrong.size:
        return []
    triangles, pads = np.divmod(indices, _PADS)
    found, inside = [], False
    for number, ended in enumerate(lines_of(path), 1):
        line = ended.rstrip("\r\n")
        spans = [match.span() for match in re.finditer(r"\S+", line.partition("#")[0])]
        fields = [line[slice(*span)] for span in spans]
        if fields and fields[0].startswith("["):
            inside = fields[0] == "[SENSORS]"
        if not inside or fields[:1] != [_TRIANGLE]:
            continue
        members = np.flatnonzero(triangles == int(fields[1]))
        if not np.isin(members, wrong).any():
            continue
        names = [stated.names[i] for i in members.tolist()]
        x, y, degrees, mirror = _pose(corrected.positions[members], pads[members], names)
        old = float(fields[4])
        near = old + (degrees - old + 180) % 360 - 180  # as near to the stated angle as possible
        whole = round(near)
        values = {2: x, 3: y, 4: float(whole) if abs(near - whole) < _ROUND else near}
        new = {
            i: f"{0.0 + round(value, 3):g}"
            for i, value in values.items()
            if abs(value - float(fields[i])) > _ROUND
        }
        before = fields[_MIRROR] if len(fields) > _MIRROR else "0"
        if int(before) != mirror:
            new[_MIRROR] = str(mirror)
        after = replaced(line, {spans[i]: text for i, text in new.items() if i < len(fields)})
        if _MIRROR in new and len(fields) <= _MIRROR:
            end = spans[-1][1] + len(after) - len(line)
            gain = "" if len(fields) == _MIRROR else f"\t{_GAIN}"
            after = f"{after[:end]}{gain}\t{mirror}{after[end:]}"
        words = {2: "x", 3: "y", 4: "orientation", _MIRROR: "mirror"}
        was = {**dict(enumerate(fields)), _MIRROR: before}
        text = ", ".join(f"{words[i]} {was[i]} -> {new[i]}" for i in sorted(new))
        found.append(LineEdit(number, line, after, f"triangle {fields[1]}: {text}"))
    return found
