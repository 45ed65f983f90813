"""Lists of contacts or spikes in text and JSON.

A row of text holds one sensor (``0.12,17``, with an optional value) or a list of them
(``0.12,"3 4 17"``, ``0.12,[3; 4; 17]``), and an empty list for a moment without contact. Rows of
one moment form a frame. A header names the columns; lists of varying length are recognised without
one. JSON is a list of objects, or one object per line: ``{"time": 0.12, "taxels": [3, 4, 17]}``.
"""

from __future__ import annotations

import csv
import itertools
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from anisomap.base.clocks import is_time, units_per_second, words_of
from anisomap.base.wording import counted, noun_and_items
from anisomap.errors import FileError
from anisomap.io.parsing.source import (
    lines_of,
    open_text,
    quote,
    quote_if_needed,
    read_head,
    read_json,
    warn,
)
from anisomap.io.parsing.tables import (
    DELIMITERS,
    LineError,
    field_error,
    find_delimiter,
    is_number,
    parse_number,
    parse_row,
    read_sample,
    read_undamaged,
    records,
)
from anisomap.io.recordings.events import (
    NOUNS,
    EventList,
    Events,
    name_sensors,
    noun_of,
    stream_events,
)
from anisomap.io.stream import ReadOptions, Stream
from anisomap.recording import Scalar

_OF_SENSORS = {*NOUNS, "index", "indices", "list", "activated", "contact", "number", "no"}
_MOMENTS = {"event", "events", "contact", "touch", "frame", "sample", "index", "no", "number"}
_VALUES = {"value", "values", "v", "val", "raw", "adc", "reading"}
_VALUES |= {"pressure", "force", "amplitude", "weight"}

_IN_LIST = re.compile(r"[^\s,;|]+")
_BRACKETS = str.maketrans("[](){}", "      ")
_ROWS_LOOKED_AT = 50
# Chosen by hand: rows of at least three lengths are not a table with a damaged line.
_MIN_BARE_ROWS, _MIN_LENGTHS = 4, 3
_MIN_EQUAL = 5  # lists of equal length that are readings
_SELECTED = re.compile(r"([^:]+):([^:]+)(?::([^:]+))?")

_Contact: TypeAlias = tuple[tuple[str, str], float, list[str], float | None]
"""Names of the moment and the sensors; the moment, the ids of the sensors, and a value."""


def stream_contacts(
    path: Path, contacts: Iterable[_Contact], bin_s: float | None, **facts: Scalar
) -> Stream:
    """Create a stream of contacts, or of spikes."""
    found, valued = EventList[str](path), False
    names = "", ""
    for contact in contacts:
        names, moment, active, value = contact
        valued = valued or value is not None
        found.add(moment, active, 1.0 if value is None else value)
    sensors, index = name_sensors(found.sensors, noun_of(names[1]))
    at = np.array(found.moments, dtype=np.float64)
    # Without a name of a time, whole numbers count events.
    timed = is_time(names[0]) or bool((at != np.floor(at)).any())
    events = Events(
        at / units_per_second(names[0], at) if timed else at,
        found.indices(index),
        sensors,
        np.array(found.values) if valued else None,
        timed=timed,
    )
    facts = {"format": "list of contacts", **facts}
    return stream_events(path, events, bin_s=bin_s, metadata=facts)


def _find_columns(names: Sequence[str]) -> tuple[int, int, int] | None:
    """Find the columns of moments, of sensors and of values, -1 without one, by their names."""
    words = [words_of(name) for name in names]
    moments = [
        i
        for i, name in enumerate(names)
        if is_time(name, i) or (words[i] and _MOMENTS.issuperset(words[i]))
    ]
    sensors = [
        i
        for i, each in enumerate(words)
        if _OF_SENSORS.issuperset(each) and any(word in NOUNS for word in each)
    ]
    values = [i for i, each in enumerate(words) if each and _VALUES.issuperset(each)]
    if (len(moments), len(sensors)) != (1, 1) or moments == sensors or len(values) > 1:
        return None
    return moments[0], sensors[0], (values or [-1])[0]


@dataclass(frozen=True)
class _Layout:
    """Columns of a list of contacts; if `ragged`, all fields from the sensor on are sensors."""

    delimiter: str | None
    header: tuple[str, ...]
    moment: int
    sensor: int
    value: int = -1
    ragged: bool = False

    @property
    def numbers(self) -> dict[int, str]:
        """The columns of numbers."""
        return dict.fromkeys([self.moment, self.value][: 1 + (self.value >= 0)], "")

    def ids(self, fields: Sequence[str]) -> list[str]:
        """Return the ids in a row; fields beyond the header continue a ragged list."""
        cells = fields[self.sensor : None if self.ragged else self.sensor + 1]
        return [text for cell in cells for text in _listed(cell)]


def is_text(path: Path, head: bytes) -> bool:
    """Recognise a header of a moment, sensors and no more than a value, or rows of many lengths."""
    return _layout_of(head) is not None


def _layout_of(head: bytes) -> _Layout | None:
    """Return the layout of a list of contacts by its first bytes; see `is_text`."""
    lines = lines_of(head)
    if lines and not lines[-1].endswith("\n"):  # it may be incomplete
        del lines[-1]
    try:
        layout = _find_layout(lines)
        if layout is None:
            return _find_bare_layout(lines)
        found = _rows(lines, layout.delimiter)[1:]
    except csv.Error:
        return None
    fits = found and all(
        (layout.ragged or len(fields) <= len(layout.header))
        and len(fields) > max(layout.numbers)
        and is_number(fields[layout.moment])
        and _are_ids(layout.ids(fields))
        for fields in found
    )
    return layout if fits else None


def _are_ids(texts: Sequence[str]) -> bool:
    """Return whether texts are whole numbers or words, each once; readings repeat."""
    whole = all(text.isdecimal() or not is_number(text) for text in texts)
    return whole and len(set(texts)) == len(texts)


@contextmanager
def open_text_list(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a list of contacts or spikes."""
    layout = _layout_of(read_head(path))
    if layout is None:
        raise FileError(f"{path} lacks a header that names a time and the sensors")
    yield stream_contacts(path, _read_text(path, layout), options.bin_s)


def selects_columns(select: str) -> bool:
    """Return whether a selection names columns: ``event:taxel``, ``1:5`` from 1; or three."""
    return bool(_SELECTED.fullmatch(select))


def stream_columns(path: Path, options: ReadOptions) -> Stream:
    """Create a stream of the moments, sensors and perhaps values in columns of any table."""
    sample = read_sample(path)
    delimiter = find_delimiter(sample)
    first = next((fields for _, fields in records(sample, delimiter)), [])
    named = not all(is_number(field, delimiter) for field in first)
    header = tuple(field.strip() for field in first) if named else ()
    columns = list[int]()
    for text in map(str.strip, options.select.split(":")):
        if text in header:
            columns.append(header.index(text))
        elif text.isascii() and text.isdecimal() and 1 <= int(text[:9]) <= len(first):
            columns.append(int(text) - 1)
        else:
            names = f", named {', '.join(map(quote, header[:8]))}" if header else ""
            problem = f"has no column {quote(text)}; it has {counted(len(first), 'column')}{names}"
            raise FileError(f"{path} {problem}")
    moment, sensor, *value = columns
    layout = _Layout(delimiter, header, moment, sensor, value[0] if value else -1)
    return stream_contacts(path, _read_text(path, layout), options.bin_s)


def _rows(lines: Sequence[str], delimiter: str | None) -> list[list[str]]:
    first = itertools.islice(records(lines, delimiter), _ROWS_LOOKED_AT)
    return [fields for _, fields in first]


def _find_layout(lines: Sequence[str]) -> _Layout | None:
    """Return the layout that the header gives, if it names a moment, sensors and perhaps values."""
    for delimiter in DELIMITERS:
        first = next((fields for _, fields in records(lines, delimiter)), [])
        header = tuple(field.strip() for field in first)
        columns = _find_columns(header)
        if columns and len(header) == 2 + (columns[2] >= 0):
            return _Layout(delimiter, header, *columns, ragged=columns[1] == len(header) - 1)
    return None


def _find_bare_layout(lines: Sequence[str]) -> _Layout | None:
    """Return the layout of rows without a header: a moment, and a varying number of sensors."""
    for delimiter in DELIMITERS:
        rows = _rows(lines, delimiter)
        if len(rows) < _MIN_BARE_ROWS or max(map(len, rows)) < 3:
            continue
        ids = [[field.strip() for field in row[1:] if field.strip()] for row in rows]
        if not all(is_number(row[0]) for row in rows):
            continue
        at = [parse_number(row[0]) for row in rows]
        different = all(len(set(row)) == len(row) for row in ids)
        whole = all(map(str.isdecimal, itertools.chain.from_iterable(ids)))
        if at == sorted(at) and different and whole and len(set(map(len, ids))) >= _MIN_LENGTHS:
            return _Layout(delimiter, (), 0, 1, ragged=True)
    return None


def _listed(cell: str) -> list[str]:
    if cell.isdecimal():
        return [cell]
    inside = cell.translate(_BRACKETS) if cell.strip()[:1] in ("[", "(", "{") else cell
    found = _IN_LIST.findall(inside)
    # A name may contain blanks; ids in a list may not.
    if len(found) > 1 and all(map(str.isdecimal, found)):
        return found
    return [inside.strip()] if inside.strip() else []


def _read_text(path: Path, layout: _Layout) -> Iterator[_Contact]:
    names = "", ""
    if layout.header:
        names = layout.header[layout.moment], layout.header[layout.sensor]

    def parse(lines: Iterable[str]) -> Iterator[_Contact | None]:
        rows = records(lines, layout.delimiter)
        for line, fields in itertools.islice(rows, 1 if layout.header else 0, None):
            if len(fields) <= max(layout.numbers):
                needed = max(*layout.numbers, layout.sensor) + 1
                raise LineError(
                    path, line, f" has {counted(len(fields), 'field')}; it must have {needed}"
                )
            moment, *values = parse_row(path, line, fields, layout.numbers)
            ids = [_whole(text) for text in layout.ids(fields)] if np.isfinite(moment) else []
            if None in ids:
                wrong, problem = layout.ids(fields)[ids.index(None)], "must be the id of a sensor"
                raise field_error(path, line, layout.sensor, wrong, problem=problem)
            known = [text for text in ids if text]
            # A row without a moment counts as read, so that a truncated line after it is dropped.
            row = names, moment, known, values[0] if values else None
            yield row if np.isfinite(moment) else None

    return filter(None, read_undamaged(path, parse, "contacts"))


def _whole(text: str) -> str | None:
    """Return an id without decimals (``17.0`` is ``17``), empty for NaN, None for a fraction."""
    if (text.isascii() and text.isdecimal() and text[0] != "0") or not is_number(text):
        return text
    number = parse_number(text)
    if np.isnan(number):
        return ""
    return str(int(number)) if number >= 0 and number.is_integer() else None


def is_json(path: Path, head: bytes) -> bool:
    """Recognise the first object by its properties: a time or number, and sensors."""
    text = head.decode("utf-8-sig", "ignore").lstrip()
    listed = text.startswith("[")
    first = text[1:].lstrip() if listed else text
    if not first.startswith("{"):
        return False
    try:
        found, end = json.JSONDecoder().raw_decode(first)
    except (ValueError, RecursionError):
        return False
    # A map is one object over several lines.
    alone = not listed and first[end:].lstrip(" \t\r")[:1] not in ("", "\n")
    columns = _find_columns(list(found)) if isinstance(found, dict) else None
    if alone or columns is None:
        return False
    return listed or not _hold_readings(text, list(found)[columns[1]])


def _hold_readings(text: str, key: str) -> bool:
    """Return whether lists in lines of JSON are readings: numbers that repeat, or of one length."""
    found = []
    for line in text.splitlines()[:_ROWS_LOOKED_AT]:
        with suppress(ValueError, RecursionError, TypeError, KeyError):
            found.append(json.loads(line)[key])
    lists = [each for each in found if isinstance(each, list) and len(each) > 1]
    repeat = any(len(set(map(str, each))) < len(each) for each in lists)
    equal = len(lists) == len(found) >= _MIN_EQUAL and len(set(map(len, lists))) == 1
    return repeat or (equal and len(lists[0]) > _MIN_LENGTHS)


@contextmanager
def open_json_list(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a list of contacts or spikes; further properties are ignored."""
    ignored = dict[str, None]()
    contacts = (_contact(f"{path}, {where}", found, ignored) for where, found in _objects(path))
    stream = stream_contacts(path, contacts, options.bin_s)
    if ignored:
        warn(path, f"ignored the {noun_and_items('property', [*map(quote_if_needed, ignored)])}")
    yield stream


def _objects(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the objects of a list, or of all lines, each with its place."""
    with open_text(path) as stream:
        start = next((line for line in stream if line.strip()), "")
    if start.lstrip("\ufeff \t").startswith("["):
        yield from ((f"contact {i}", found) for i, found in enumerate(read_json(path)))
        return

    def parse(lines: Iterable[str]) -> Iterator[tuple[str, Any]]:
        for number, line in enumerate(lines, start=1):
            if line.strip():
                try:
                    yield f"line {number}", json.loads(line)
                except (ValueError, RecursionError) as error:
                    reason = error.msg if isinstance(error, json.JSONDecodeError) else error
                    raise LineError(path, number, f": not valid JSON ({reason})") from error

    yield from read_undamaged(path, parse, "contacts")


def _contact(where: str, found: Any, ignored: dict[str, None]) -> _Contact:
    keys = list(found) if isinstance(found, dict) else []
    columns = _find_columns(keys)
    if columns is None:
        raise FileError(f"{where}: must be an object with a time and sensors")
    moment, sensor, *rest = (keys[i] for i in columns if i >= 0)
    others = (key for key in keys if key not in (moment, sensor, *rest))
    ignored |= dict.fromkeys(key for key in others if type(found[key]) in (int, float))
    for key in (moment, *rest):
        if type(found[key]) not in (int, float):
            raise FileError(f"{where}: {key} must be a number, got {quote(str(found[key]))}")
    listed = found[sensor] if isinstance(found[sensor], list) else [found[sensor]]
    for each in listed:
        whole = type(each) is int and each >= 0
        if not whole and not (isinstance(each, str) and each.strip()):
            raise FileError(f"{where}: {quote(str(each))} must be the id of a sensor")
    value = float(found[rest[0]]) if rest else None
    return (moment, sensor), float(found[moment]), [str(each) for each in listed], value
