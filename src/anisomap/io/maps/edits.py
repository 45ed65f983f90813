"""Changes of lines in a file of positions if places of sensors change; other lines are kept."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.sensor_map import SensorMap

_SAME = 1e-9  # of the extent of a layout: differences by rounding
_DECIMALS = 6  # of numbers that replace whole numbers
_LINE = re.compile(rb"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+\Z")


@dataclass(frozen=True)
class LineEdit:
    """A changed line of a file.

    line: Number of the line, from 1.
    before, after: The line without its end.
    text: Description of the change, in terms of the file.
    """

    line: int
    before: str
    after: str
    text: str


def lines_of(path: Path) -> list[str]:
    """Return the lines of a file with their ends; bytes that are not text are kept."""
    return [line.decode("utf-8", "surrogateescape") for line in _LINE.findall(path.read_bytes())]


def edited(path: Path, edits: Sequence[LineEdit]) -> bytes:
    """Return the contents of a file with changed lines; all other lines are equal in each byte."""
    lines = lines_of(path)
    for edit in edits:
        line = lines[edit.line - 1]
        lines[edit.line - 1] = edit.after + line[len(line.rstrip("\r\n")) :]
    return "".join(lines).encode("utf-8", "surrogateescape")


def replaced(line: str, fields: Mapping[tuple[int, int], str]) -> str:
    """Replace the text in spans of a line."""
    for (start, stop), text in sorted(fields.items(), reverse=True):
        line = line[:start] + text + line[stop:]
    return line


def changed_sensors(stated: SensorMap, corrected: SensorMap) -> NDArray[np.intp]:
    """Return the sensors with changed places."""
    off = np.linalg.norm(corrected.positions - stated.positions, axis=1)
    return np.flatnonzero(off > _rounding(stated))


def _rounding(stated: SensorMap) -> float:
    """Return the largest difference of places that counts as rounding."""
    return _SAME * float(np.ptp(stated.positions[stated.placed], axis=0).max())


def edited_rows(
    stated: SensorMap,
    corrected: SensorMap,
    rows: Mapping[int, tuple[int, str, Sequence[tuple[int, int]]]],
) -> list[LineEdit]:
    """Change the coordinates of sensors in rows of numbers.

    If a sensor takes the place of another, the text of the numbers is copied. Normals are copied
    from the nearest stated place.

    rows: For each sensor: line number, line, and spans of the coordinates, followed by spans of the
        normal, if there is one.
    """
    k = stated.dimensions
    placed = np.flatnonzero(stated.placed)
    changed = changed_sensors(stated, corrected)
    if not changed.size:
        return []
    tree = KDTree(stated.positions[placed])
    distance, nearest = map(np.asarray, tree.query(corrected.positions[changed]))
    rounding = _rounding(stated)
    found = []
    for sensor, off, owner in zip(changed.tolist(), distance, placed[nearest], strict=True):
        number, line, spans = rows[sensor]
        _, other, there = rows[int(owner)]
        old = [line[slice(*span)] for span in spans]
        new = [other[slice(*span)] for span in there]
        if off > rounding:
            values = corrected.positions[sensor].tolist()
            new[:k] = [_like(text, value) for text, value in zip(old, values, strict=False)]
        pairs = {span: text for span, was, text in zip(spans, old, new, strict=True) if was != text}
        there_text = f"{' '.join(old[:k])} -> {' '.join(new[:k])}"
        text = f"{stated.names[sensor]}: {there_text}"
        found.append(LineEdit(number, line, replaced(line, pairs), text))
    return sorted(found, key=lambda edit: edit.line)


def _like(text: str, value: float) -> str:
    """Format a number with the decimal mark and as many decimals as in another text."""
    mark = "," if "," in text else "."
    decimals = len(re.split("[eE]", text.partition(mark)[2])[0])
    written = f"{value:.{decimals if decimals > 1 else _DECIMALS}f}"
    if decimals <= 1:
        written = written.rstrip("0").rstrip(".")
    return ("0" if float(written) == 0 else written).replace(".", mark)
