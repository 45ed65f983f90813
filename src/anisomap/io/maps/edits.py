"""Lines of a file of positions that change when some sensors get other places; the rest stays."""

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
_DECIMALS = 6  # of a number that is written where whole numbers were
_LINE = re.compile(rb"[^\r\n]*(?:\r\n|\r|\n)|[^\r\n]+\Z")


@dataclass(frozen=True)
class LineEdit:
    """A line of a file that changes.

    line: Its number, from 1.
    before, after: The line without its end.
    text: What changes, in the terms of the file.
    """

    line: int
    before: str
    after: str
    text: str


def lines_of(path: Path) -> list[str]:
    """Return the lines of a file with their ends; bytes that are no text are kept, too."""
    return [line.decode("utf-8", "surrogateescape") for line in _LINE.findall(path.read_bytes())]


def edited(path: Path, edits: Sequence[LineEdit]) -> bytes:
    """Return the contents of a file with some of its lines changed, all others byte for byte."""
    lines = lines_of(path)
    for edit in edits:
        line = lines[edit.line - 1]
        lines[edit.line - 1] = edit.after + line[len(line.rstrip("\r\n")) :]
    return "".join(lines).encode("utf-8", "surrogateescape")


def replaced(line: str, fields: Mapping[tuple[int, int], str]) -> str:
    """Return a line with other text in some of its spans."""
    for (start, stop), text in sorted(fields.items(), reverse=True):
        line = line[:start] + text + line[stop:]
    return line


def changed_sensors(stated: SensorMap, corrected: SensorMap) -> NDArray[np.intp]:
    """Return the sensors with another place."""
    off = np.linalg.norm(corrected.positions - stated.positions, axis=1)
    return np.flatnonzero(off > _rounding(stated))


def _rounding(stated: SensorMap) -> float:
    """Return the largest difference of places that is taken for rounding."""
    return _SAME * float(np.ptp(stated.positions[stated.placed], axis=0).max())


def edited_rows(
    stated: SensorMap,
    corrected: SensorMap,
    rows: Mapping[int, tuple[int, str, Sequence[tuple[int, int]]]],
) -> list[LineEdit]:
    """Change the coordinates of sensors in rows of numbers.

    A sensor that takes the place of another takes the text of its numbers. Normals are those of the
    nearest stated place.

    rows: Number of the line of each sensor, the line, and where its coordinates are, then its
        normal, if it has one.
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
    """Format a number with as many decimals as another one, and its decimal mark."""
    mark = "," if "," in text else "."
    decimals = len(re.split("[eE]", text.partition(mark)[2])[0])
    written = f"{value:.{decimals if decimals > 1 else _DECIMALS}f}"
    if decimals <= 1:
        written = written.rstrip("0").rstrip(".")
    return ("0" if float(written) == 0 else written).replace(".", mark)
