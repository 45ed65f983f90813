"""Lists of contacts or spikes as delimited text: a time or number, and the sensors at it.

A row holds one sensor (``0.12,17``, with an optional value) or a list of them (``0.12,"3 4 17"``,
``0.12,[3; 4; 17]``), and an empty list for a moment without contact. Rows of one moment form a
frame. A header names the columns; lists of varying length are recognised without one.
"""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anisomap.errors import FileError
from anisomap.io.parsing import delimited
from anisomap.io.parsing.columns import is_time, units_per_second
from anisomap.io.parsing.source import open_text, quote
from anisomap.io.parsing.table import (
    LineError,
    is_number,
    is_skipped,
    parse_number,
    parse_row,
    read_undamaged,
)
from anisomap.io.recordings.events import (
    EventList,
    Events,
    find_columns,
    name_sensors,
    noun_of,
    stream_events,
)
from anisomap.io.stream import ReadOptions, Stream

_IN_LIST = re.compile(r"[^\s,;|]+")
_BRACKETS = str.maketrans("[](){}", "      ")
_DELIMITERS = (";", "\t", ",", None)
_ROWS_LOOKED_AT = 50
# Chosen by hand: rows of at least three lengths are not a table with a damaged line.
_MIN_BARE_ROWS, _MIN_LENGTHS = 4, 3
_SELECTED = re.compile(r"([^:]+):([^:]+)")


@dataclass(frozen=True)
class _Layout:
    """Columns of a list of contacts, by index from 0; -1 for no values.

    If `ragged`, all fields from the sensor on are sensors.
    """

    delimiter: str | None
    header: tuple[str, ...]
    moment: int
    sensor: int
    value: int = -1
    ragged: bool = False

    @property
    def noun(self) -> str:
        """What a number of a sensor is preceded with in its name."""
        return noun_of(self.header[self.sensor]) if self.header else "taxel"


def recognises(path: Path, head: bytes) -> bool:
    """Recognise a header of a time or number and of sensors, above rows of whole numbers or lists.

    Further columns, other than a value, make the file a table of readings. Without a header, rows
    must hold a number that does not decrease and different whole numbers, and differ in length.
    """
    if b"\0" in head or b"\n" not in head:
        return False
    lines = head.decode("utf-8-sig", "replace").splitlines(keepends=True)
    # The last line may be incomplete.
    lines = lines if lines[-1].endswith("\n") else lines[:-1]
    try:
        layout = _find_layout(lines)
        if layout is None:
            return _find_bare_layout(lines) is not None
        rows = itertools.islice(delimited.records(lines, layout.delimiter), 1, _ROWS_LOOKED_AT)
        found = [fields for _, fields in rows]
        width = max(map(len, found), default=0)
        if not found or (width > len(layout.header) and not layout.ragged):
            return False
        return all(_is_row(layout, fields) for fields in found)
    except csv.Error:
        return False


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a list of contacts or spikes."""
    with open_text(path) as stream:
        sample = delimited.read_sample(stream)
    layout = _find_layout(sample) or _find_bare_layout(sample)
    if layout is None:
        raise FileError(f"{path} lacks a header that names a time and the sensors")
    yield _stream(path, layout, options)


def selects_columns(select: str) -> bool:
    """Return whether a selection names two columns: ``event:taxel``, or ``1:5`` from 1."""
    return bool(_SELECTED.fullmatch(select))


@contextmanager
def open_columns(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open two columns of any table as the moment and the sensor of contacts.

    `options.select` names the columns, or gives their numbers from 1, as ``event:taxel``.
    """
    with open_text(path) as stream:
        sample = delimited.read_sample(stream)
    delimiter = delimited.find_delimiter(sample)
    first = next((fields for _, fields in delimited.records(sample, delimiter)), [])
    named = not all(is_number(field, delimiter) for field in first)
    header = tuple(field.strip() for field in first) if named else ()
    moment, sensor = (
        _column(path, text.strip(), header, len(first)) for text in options.select.split(":")
    )
    yield _stream(path, _Layout(delimiter, header, moment, sensor), options)


def _column(path: Path, text: str, header: Sequence[str], width: int) -> int:
    if text in header:
        return header.index(text)
    if text.isascii() and text.isdecimal() and 1 <= int(text[:9]) <= width:
        return int(text) - 1
    names = f", named {', '.join(map(quote, header[:8]))}" if header else ""
    raise FileError(f"{path} has no column {quote(text)}; it has {width} columns{names}")


def _find_layout(lines: Sequence[str]) -> _Layout | None:
    """Return the layout that the header gives, if it names a moment, sensors and perhaps values."""
    for delimiter in _DELIMITERS:
        first = next((fields for _, fields in delimited.records(lines, delimiter)), [])
        header = tuple(field.strip() for field in first)
        columns = find_columns(header)
        if columns and len(header) == 2 + (columns.value >= 0):
            ragged = columns.sensor == len(header) - 1
            return _Layout(delimiter, header, columns.moment, columns.sensor, columns.value, ragged)
    return None


def _find_bare_layout(lines: Sequence[str]) -> _Layout | None:
    """Return the layout of rows without a header: a moment, and a varying number of sensors.

    A table of readings has rows of equal length, or repeated values in a damaged one.
    """
    for delimiter in _DELIMITERS:
        rows = [
            fields
            for _, fields in itertools.islice(delimited.records(lines, delimiter), _ROWS_LOOKED_AT)
        ]
        if len(rows) < _MIN_BARE_ROWS or max(map(len, rows)) < 3:
            continue
        moments = [row[0] for row in rows]
        ids = [[field.strip() for field in row[1:] if field.strip()] for row in rows]
        if not all(is_number(moment, ",") for moment in moments):
            continue
        at = [parse_number(moment) for moment in moments]
        different = all(len(set(row)) == len(row) for row in ids)
        whole = all(map(str.isdecimal, itertools.chain.from_iterable(ids)))
        if at == sorted(at) and different and whole and len(set(map(len, ids))) >= _MIN_LENGTHS:
            return _Layout(delimiter, (), 0, 1, ragged=True)
    return None


def _is_row(layout: _Layout, fields: Sequence[str]) -> bool:
    """Return whether a row holds a number and ids: whole numbers, or words that are no numbers."""
    if len(fields) <= max(layout.moment, layout.value) or not is_number(fields[layout.moment], ","):
        return False
    return all(text.isdecimal() or not is_number(text, ",") for text in _ids(layout, fields))


def _ids(layout: _Layout, fields: Sequence[str]) -> list[str]:
    """Return the ids of a row; fields beyond the header continue a ragged list."""
    end = None if layout.ragged else layout.sensor + 1
    cells = fields[layout.sensor : end]
    return [text for cell in cells for text in _listed(cell)]


def _listed(cell: str) -> list[str]:
    if cell.isdecimal():
        return [cell]
    inside = cell.translate(_BRACKETS) if cell.strip()[:1] in ("[", "(", "{") else cell
    found = _IN_LIST.findall(inside)
    # A name may contain blanks; ids in a list may not.
    return (
        found
        if len(found) > 1 and all(map(str.isdecimal, found))
        else [*filter(None, [inside.strip()])]
    )


def _stream(path: Path, layout: _Layout, options: ReadOptions) -> Stream:
    def parse(lines: Iterable[str]) -> Iterator[tuple[float | None, list[str], float]]:
        return (_parsed(path, line, fields, layout) for line, fields in _rows(lines, layout))

    found = EventList[str](path)
    for moment, active, value in read_undamaged(path, parse, "contacts"):
        if moment is not None:
            found.add(moment, active, value)
    names, index = name_sensors(found.sensors, layout.noun)
    at = np.array(found.moments, dtype=np.float64)
    name = layout.header[layout.moment] if layout.header else ""
    # Without a name of a time, whole numbers count events.
    timed = is_time(name, layout.moment) or bool((at != np.floor(at)).any())
    if timed:
        at /= units_per_second(name, at)
    events = Events(
        at,
        found.indices(index),
        names,
        np.array(found.values) if layout.value >= 0 else None,
        timed=timed,
    )
    return stream_events(path, events, bin_s=options.bin_s, metadata={"format": "list of contacts"})


def _rows(lines: Iterable[str], layout: _Layout) -> Iterator[delimited.Record]:
    """Yield the records below the header, each with its last line.

    One reader for all lines is several times faster than `delimited.records`, which starts one per
    line; there may be millions of spikes.
    """
    skipped = 1 if layout.header else 0
    if layout.delimiter is None:
        yield from itertools.islice(delimited.records(lines, None), skipped, None)
        return
    number = 0

    def filled() -> Iterator[str]:
        nonlocal number
        for number, line in enumerate(lines, start=1):  # noqa: B007 - the records need the number
            if not is_skipped(line, layout.delimiter):
                yield line

    reader = csv.reader(filled(), delimiter=layout.delimiter, skipinitialspace=True, strict=True)
    try:
        for fields in itertools.islice(reader, skipped, None):
            yield number, fields
    except csv.Error as error:
        raise csv.Error(f"line {number}: {error}") from error


def _parsed(
    path: Path, line: int, fields: Sequence[str], layout: _Layout
) -> tuple[float | None, list[str], float]:
    """Return the moment, ids and value of a row; a row without a moment is None."""
    if len(fields) <= max(layout.moment, layout.value):
        needed = max(layout.moment, layout.sensor, layout.value) + 1
        raise LineError(path, line, f" has {len(fields)} fields; it must have {needed}")
    columns = [layout.moment, layout.value][: 1 + (layout.value >= 0)]
    moment, *values = parse_row(path, line, fields, dict.fromkeys(columns, ""))
    if not np.isfinite(moment):
        return None, [], 0.0
    found = []
    for text in _ids(layout, fields):
        whole = _whole(text)
        if whole is None:
            where = f", column {layout.sensor + 1}: "
            raise LineError(path, line, f"{where}{quote(text)} must be the id of a sensor")
        found += [whole] if whole else []
    return moment, found, values[0] if values else 1.0


def _whole(text: str) -> str | None:
    """Return an id without decimals (``17.0`` is ``17``), empty for NaN, None for a fraction."""
    if text.isascii() and text.isdecimal() and text[0] != "0":
        return text
    if not is_number(text, ","):
        return text
    number = parse_number(text)
    if np.isnan(number):
        return ""
    return str(int(number)) if number >= 0 and number.is_integer() else None
