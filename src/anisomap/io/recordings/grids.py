"""Exports of pressure mats.

An export has a header (``ROWS 3``, ``ROW_SPACING 8.4 mm``, ``SECONDS_PER_FRAME 0.01``). For each
frame, a line such as ``Frame 1`` and rows of cells follow; ``B`` is a cell outside the sensor.
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.source import TextLines, lines_of, open_text, quote, warn
from anisomap.io.parsing.tables import read_undamaged
from anisomap.io.presets import UNITS, grid_names, grid_positions
from anisomap.io.stream import Frame, ReadOptions, Stream, stack_frames

# Possessive quantifiers keep the time linear in the length of a line.
_FRAME = re.compile(
    r'\s*+"?frame"?[\s:,;#"]*+\d++"?[\s,;]*+(of\s++\d++[\s,;]*+)?'
    r"([\d.]++\s*+m?s(ec)?\s*+)?$",
    re.IGNORECASE,
)
_ENTRY = re.compile(
    r'\s*+"?([A-Za-z](?:[A-Za-z_]| ++(?=[A-Za-z_]))*+)(?:"?[\s:,;=]++)++"?'
    r'([-+]?\d++(?:[.,]\d++)?+)"?\s*+([A-Za-z]*+)'
)
_CLOCK = re.compile(
    r'\s*+"?time[^\d"]*+"?[\s:,;]*+"?(\d{1,9}):(\d{1,9}):(\d++(?:[.,]\d++)?)', re.IGNORECASE
)
_SIZES = {"rows": "rows", "cols": "columns", "columns": "columns"}
_OUTSIDE = re.compile(r"\b[Bb]\b")
_LENGTHS = {"mm": "mm", "millimeters": "mm", "cm": "cm", "centimeters": "cm", "m": "m"}
_MAX_HEADER, _MAX_CELLS = 1000, 1 << 22
_DAY_S = 86400.0


@dataclass(frozen=True, eq=False)
class _Header:
    """Entries before the first frame, with keys in lower case, and the layout of that frame."""

    entries: dict[str, tuple[float, str]]
    rows: int
    columns: int
    delimiter: str | None
    inside: NDArray[np.bool_]


def is_mat_export(path: Path, head: bytes) -> bool:
    """Recognise an export by lines with frame numbers, and by the size in its header."""
    lines = lines_of(head)
    n_frames = sum(1 for line in lines if _FRAME.match(line))
    sizes = {_SIZES.get(match[1].lower()) for line in lines if (match := _ENTRY.match(line))}
    return n_frames > 1 or (n_frames == 1 and {"rows", "columns"} <= sizes)


@contextmanager
def open_mat_export(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a recording of a pressure mat: the cells inside the sensor, in row-major order."""
    header = _read_header(path)
    names = grid_names(header.rows, header.columns)
    positions, units = _positions(header)
    period, _ = header.entries.get("seconds per frame", (0.0, ""))
    yield Stream(
        path,
        int(np.count_nonzero(header.inside)),
        stack_frames(read_undamaged(path, functools.partial(_frames, path, header), "frames")),
        names=tuple(itertools.compress(names, header.inside)),
        rate_hz=1 / period if period > 0 else None,
        positions=positions[header.inside],
        units=units,
        source=path.name,
        metadata={"format": "pressure mat", "rows": header.rows, "columns": header.columns},
        from_zero=True,
    )


def _read_header(path: Path) -> _Header:
    with open_text(path) as lines:
        entries = _read_entries(path, lines)
    rows, columns = (int(entries.get(key, (0, ""))[0]) for key in ("rows", "columns"))
    if rows * columns > _MAX_CELLS:
        size = f"{rows} x {columns} cells"
        raise FileError(f"{path}: the header gives {size}; at most {_MAX_CELLS} are supported")
    with open_text(path) as lines:
        line, _, first = next(_rows_of_frames(lines, rows), (0, None, []))
    if not first:
        raise FileError(f"{path} has no frame")
    delimiter = next((mark for mark in (";", "\t", ",") if mark in _plain(first[0])), None)
    table = _parsed(path, line, first, delimiter)
    rows, columns = rows or table.shape[0], columns or table.shape[1]
    if table.shape != (rows, columns):
        found = " x ".join(map(str, table.shape))
        raise FileError(f"{path}: the first frame has {found} cells instead of {rows} x {columns}")
    inside = ~np.isnan(table.ravel())
    if not inside.any():
        raise FileError(f"{path}: all cells of the first frame are outside the sensor")
    return _Header(entries, rows, columns, delimiter, inside)


def _read_entries(path: Path, lines: Iterable[str]) -> dict[str, tuple[float, str]]:
    """Read numbers with names and units up to the first line of the first frame."""
    entries: dict[str, tuple[float, str]] = {}
    for line in itertools.islice(lines, _MAX_HEADER):
        if _FRAME.match(line):
            return entries
        if match := _ENTRY.match(line):
            key, unit = match[1].strip().lower().replace("_", " "), match[3].lower()
            stem, _, last = key.rpartition(" ")  # as in ROW_SPACING_MM
            key, unit = (stem, last) if stem and last in _LENGTHS and not unit else (key, unit)
            entries[_SIZES.get(key, key)] = (float(match[2].replace(",", ".")), unit)
    raise FileError(f"{path}: no frame starts in the first {_MAX_HEADER} lines")


def _rows_of_frames(
    lines: Iterable[str], n_rows: int
) -> Iterator[tuple[int, float | None, list[str]]]:
    """Yield line, time of day and rows of each frame: `n_rows` rows, or if 0 up to a blank line."""
    rows, started = list[str](), 0
    clock, before = None, 0.0
    for number, line in enumerate(lines, start=1):
        begins = _FRAME.match(line)
        if rows and (begins or not (n_rows or line.strip(" \t\r\n,;"))):
            yield started, clock, rows
            rows = []
        if begins:
            started, clock = number, None
        elif started and (match := _CLOCK.match(line)):
            clock = before = _after(before, match)
        elif started and _is_data(line):
            rows.append(line)
            if len(rows) in (n_rows, _MAX_CELLS):
                yield started, clock, rows
                rows = []
    if rows:
        yield started, clock, rows


def _frames(path: Path, header: _Header, text: TextLines) -> Iterator[Frame]:
    found = enumerate(_rows_of_frames(text, header.rows))
    for n_frames, (line, clock, rows) in found:
        if len(rows) < header.rows and n_frames and not next(text, ""):
            what = f"truncated in row {len(rows)} of {header.rows} and dropped"
            warn(path, f"the last frame is {what}; read the frames before it: {n_frames}")
            return
        whole = len(rows) == header.rows
        cells = _parsed(path, line, rows, header.delimiter) if whole else np.empty((0, 0))
        if cells.shape[1] != header.columns:
            size = f"{header.rows} rows of {header.columns} numbers"
            raise FileError(f"{path}: the frame at line {line} must have {size}")
        yield Frame(cells.ravel()[header.inside], text.fraction(), clock)


def _after(before: float, clock: re.Match[str]) -> float:
    """Return a time of day in seconds, on the next day if it is far before the preceding time."""
    time = 3600.0 * int(clock[1]) + 60.0 * int(clock[2]) + float(clock[3].replace(",", "."))
    return time + _DAY_S * (time < before - _DAY_S / 2)


def _is_data(line: str) -> bool:
    """Return whether a line is a row of cells, by its first field."""
    field = re.split(r"[,;\s]", line.strip().lstrip('"'), maxsplit=1)[0].strip('"')
    return bool(field) and (field in "Bb" or field.replace(".", "").lstrip("+-").isdecimal())


def _plain(line: str) -> str:
    """Remove quotation marks, and replace decimal commas between them."""
    if '"' not in line:
        return line
    return line.strip().strip('",;').replace('","', ";").replace(",", ".").replace('"', "")


def _parsed(path: Path, line: int, rows: list[str], delimiter: str | None) -> NDArray[np.float64]:
    cleaned = [_OUTSIDE.sub("nan", _plain(row)).strip().rstrip(delimiter or "") for row in rows]
    try:
        return np.loadtxt(cleaned, np.float64, delimiter=delimiter, comments=None, ndmin=2)
    except ValueError as error:
        shown = quote(rows[0].strip())
        message = f"{path}: the frame at line {line} is not a table of numbers: {shown} ..."
        raise FileError(message) from error


def _positions(header: _Header) -> tuple[NDArray[np.float64], str]:
    grid = grid_positions(header.rows, header.columns)
    down, unit = header.entries.get("row spacing", (0.0, ""))
    across, _ = header.entries.get("col spacing", (down, unit))
    if down <= 0 or across <= 0 or unit not in _LENGTHS:
        return grid, UNITS
    return grid * [across, down], _LENGTHS[unit]
