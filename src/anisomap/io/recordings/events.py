"""Events, contacts or spikes, and their frames; and lists of events in text and JSON.

A frame is one moment, or counts events in a bin of constant width.

A row of text holds one sensor (``0.12,17``, with an optional value) or a list of them
(``0.12,"3 4 17"``, ``0.12,[3; 4; 17]``), and an empty list for a moment without contact. Rows of
one moment form a frame. A header names the columns; lists of varying length are recognised without
one. JSON is a list of objects, or one object per line: ``{"time": 0.12, "taxels": [3, 4, 17]}``.

Spikes may also have one line or one column of times per channel, with or without names, in
seconds::

    A1,0.012,0.85,2.33          A1,A2
    A2,0.020                    0.012,0.020
    A3,0.015,0.86               0.85,
"""

from __future__ import annotations

import csv
import functools
import itertools
import json
import math
import re
from array import array
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.names import is_time, numbers_of, units_per_second, words_of
from anisomap.io.parsing.source import open_text, quote, read_head, read_json, read_lines, warn
from anisomap.io.parsing.tables import (
    DELIMITERS,
    LineError,
    find_delimiter,
    is_number,
    parse_number,
    parse_row,
    read_sample,
    read_undamaged,
    records,
)
from anisomap.io.stream import ReadOptions, Stream, read_in_blocks
from anisomap.memory import Budget
from anisomap.recording import Scalar

DEFAULT_BIN_S = 1.0
"""Width of bins in seconds if none is given.

The reader of the retinal wave repository counts in intervals of this length by default (Eglen et
al. 2014, GigaScience 3:3, doi:10.1186/2047-217X-3-3).
"""

_Key = TypeVar("_Key", bound=Hashable)

_EVENT_BYTES = 64
"""Memory per event: moment, sensor and value (24), and the arrays that sort them by moment."""

# Chosen by hand: a recording in which fewer than one bin in a thousand holds an event has a wrong
# time or bin width. Short recordings may have more empty bins.
_MAX_BINS_PER_EVENT, _MIN_REFUSED_BINS = 1000, 1 << 16
# Decimal times on the edge of a bin are not exact in binary; in widths of a bin.
_EDGE_DECIMALS = 6
# Chosen by hand: contacts of a skin touch several sensors, spikes of neurons rarely coincide.
_MAX_SHARE_ALONE = 0.9


@dataclass(frozen=True, eq=False)
class Events:
    """Sensors that were active, and when; an entry is one sensor at one moment.

    moments: Times in seconds, or numbers of events.
    sensors: Index in `names`; -1 for a moment without an active sensor.
    names: Names of the sensors.
    values: Readings; 1 by default.
    timed: Whether `moments` are times.
    """

    moments: NDArray[np.float64]
    sensors: NDArray[np.intp]
    names: tuple[str, ...]
    values: NDArray[np.float64] | None = None
    timed: bool = True

    def __post_init__(self) -> None:
        order = np.argsort(self.moments, kind="stable")
        for field, values in vars(self).copy().items():
            if isinstance(values, np.ndarray):
                object.__setattr__(self, field, values[order])


class EventList(Generic[_Key]):
    """Events while they are read, within the budget of their file.

    moments, values: One entry per event; `values` is a second number of each.
    """

    def __init__(self, path: Path) -> None:
        self.moments, self.values = array("d"), array("d")
        self._numbers = array("q")
        self._seen: dict[_Key, int] = {}
        self._budget = Budget(path)

    @property
    def sensors(self) -> list[_Key]:
        """All sensors, in the order of their first event."""
        return list(self._seen)

    def add(self, moment: float, active: Sequence[_Key], value: float = 1.0) -> None:
        """Add the active sensors of a moment; none is an event without a sensor."""
        count = max(1, len(active))
        self._budget.spend(_EVENT_BYTES * count, "its list of contacts")
        self.moments.extend([moment] * count)
        self.values.extend([value] * count)
        seen = self._seen
        self._numbers.extend([seen.setdefault(key, len(seen)) for key in active] or [-1])

    def indices(self, index: Mapping[_Key, int]) -> NDArray[np.intp]:
        """Return the index of the sensor of each event, -1 for none or one without an index."""
        places = np.array([*(index.get(key, -1) for key in self._seen), -1], dtype=np.intp)
        return places[np.asarray(self._numbers, dtype=np.intp)]


def name_sensors(ids: Sequence[str], noun: str) -> tuple[tuple[str, ...], dict[str, int]]:
    """Name the sensors of events, in the order of their numbers, else of appearance."""
    found = list(dict.fromkeys(ids))
    if all(text.isascii() and text.isdecimal() for text in found) and numbers_of(found):
        found.sort(key=int)
    else:
        noun = ""
    return tuple(f"{noun}{text}" for text in found), {text: i for i, text in enumerate(found)}


def stream_events(
    path: Path,
    events: Events,
    *,
    bin_s: float | None = None,
    span: tuple[float, float] | None = None,
    spikes: bool | None = None,
    metadata: Mapping[str, Scalar],
    **known: Any,
) -> Stream:
    """Create a stream of frames from events.

    Without bins, a frame is one moment, in order of time; a reading is 1 if the sensor was active,
    or its value. With bins, a reading is the number of events in the bin, or the last value.

    spikes: Whether the events need bins; None to decide by how many share a moment.
    known: Further fields of the stream.
    """
    if not (events.sensors >= 0).any():
        raise FileError(f"{path} holds no event")
    if not np.isfinite(events.moments).all():
        raise FileError(f"{path}: the time of an event is not finite")
    if bin_s is not None and not events.timed:
        raise FileError(f"{path} numbers its events without times, so bins do not apply to it")
    if spikes is None and events.timed:
        _, counts = np.unique(events.moments[events.sensors >= 0], return_counts=True)
        spikes = bool(np.mean(counts == 1) > _MAX_SHARE_ALONE)
    if bin_s is None and spikes:
        bin_s = DEFAULT_BIN_S
        problem = f"events are counted in bins of {bin_s:g} s, the default width"
        warn(path, f"{problem}; choose another with --bin-width (bin_s in Python)")
    facts: dict[str, Scalar]
    if bin_s is None:
        times, frames = np.unique(events.moments, return_inverse=True)
        facts = {"frames": "one per time" if events.timed else "one per event"}
    else:
        frames, n_bins = _bins(path, events.moments, bin_s, span)
        times = np.asarray(np.arange(n_bins) * bin_s, dtype=np.float64)
        facts = {"bin_s": bin_s}
    n_frames, n_sensors = len(times), len(events.names)
    what = f"a recording of {n_frames} frames and {n_sensors} sensors"
    Budget(path).check_readings(n_frames, n_sensors, 4, what)
    return Stream(
        path,
        n_sensors,
        read_in_blocks(
            functools.partial(_frames, events, frames, counted=bin_s is not None),
            n_frames,
            4 * n_sensors,
            times=times if events.timed else None,
        ),
        names=events.names,
        rate_hz=None if bin_s is None else 1 / bin_s,
        source=path.name,
        metadata={**metadata, **facts},
        from_zero=True,
        silent_are_zero=True,
        **known,
    )


def stream_trains(
    path: Path,
    trains: Sequence[ArrayLike],
    bin_s: float | None,
    names: tuple[str, ...] = (),
    **known: Any,
) -> Stream:
    """Create a stream of the counts of spikes, whose times are given for each channel."""
    times = [np.asarray(train, dtype=np.float64).ravel() for train in trains]
    channels = np.repeat(np.arange(len(times)), [len(train) for train in times])
    names = names or tuple(f"channel{i + 1}" for i in range(len(times)))
    events, facts = Events(np.concatenate(times), channels, names), {"format": "spike trains"}
    return stream_events(path, events, bin_s=bin_s, spikes=True, metadata=facts, **known)


def _bins(
    path: Path, moments: NDArray[np.float64], width: float, span: tuple[float, float] | None
) -> tuple[NDArray[np.intp], int]:
    """Return the bin of each event, and the number of bins."""
    edges = [float(moments[0]), float(moments[-1]), *(span or ())]
    start, end = min(edges), max(edges)
    places = np.round((moments - start) / width, _EDGE_DECIMALS)
    n_last = math.ceil(round((end - start) / width, _EDGE_DECIMALS))
    n_bins = max(math.floor(places[-1]) + 1, n_last)
    if n_bins > max(_MIN_REFUSED_BINS, _MAX_BINS_PER_EVENT * len(moments)):
        raise FileError(
            f"{path}: {len(moments)} events from {start:g} to {end:g} s would fill {n_bins} bins "
            f"of {width:g} s; choose wider bins with --bin-width, or correct the times"
        )
    return np.floor(places).astype(np.intp), n_bins


def _frames(
    events: Events, frames: NDArray[np.intp], first: int, last: int, *, counted: bool
) -> NDArray[np.floating]:
    """Return the readings of a range of frames; `frames` gives the frame of each event."""
    inside = slice(*np.searchsorted(frames, [first, last]))
    rows, columns = frames[inside] - first, events.sensors[inside]
    active = columns >= 0
    where = rows[active], columns[active]
    kind = np.float32 if events.values is None else np.float64
    readings = np.zeros((last - first, len(events.names)), kind)
    if counted and events.values is None:
        np.add.at(readings, where, 1)
    else:
        readings[where] = 1 if events.values is None else events.values[inside][active]
    return readings


def stream_spike_table(path: Path, bin_s: float) -> Stream:
    """Create a stream of the counts of spikes whose times are in lines or columns.

    Times increase along each channel and have fractions, so that readings are not taken for times.
    """
    lines = read_lines(path)
    delimiter = find_delimiter(lines[:1000])
    rows = [fields for _, fields in records(lines, delimiter)]
    # Lines differ in length, and either all begin with a name or none does.
    lined = len(set(map(len, rows))) > 1 and len({is_number(row[0]) for row in rows if row}) == 1
    columns = list(itertools.zip_longest(*rows, fillvalue=""))
    trains = (_trains(rows) if lined else None) or _trains(columns)
    if not trains:
        raise FileError(
            f"{path} (delimited text) holds readings, not events: its numbers do not increase "
            "along all lines or all columns, as the times of spikes do; leave out --bin-width"
        )
    names, times = zip(*trains, strict=True)
    return stream_trains(path, times, bin_s, names)


def _trains(channels: Sequence[Sequence[str]]) -> list[tuple[str, list[float]]] | None:
    """Return the name and times of each channel; None unless all are times that increase."""
    named = any(not is_number(fields[0]) for fields in channels if fields)
    found = []
    fractions = False
    for i, fields in enumerate(channels):
        name = fields[0].strip() if named else ""
        try:
            times = [parse_number(field) for field in fields[named:]]
        except ValueError:
            return None
        known = [time for time in times if not np.isnan(time)]
        # Gaps inside a train are missing readings of a table.
        if any(not np.isnan(time) for time in times[len(known) :]) or known != sorted(known):
            return None
        fractions = fractions or any(time % 1 for time in known)
        found.append((name or f"channel{i + 1}", known))
    return found if fractions else None


NOUNS = {
    **dict.fromkeys(("id", "ids", "taxel", "taxels", "contacts", "active", "touched"), "taxel"),
    **dict.fromkeys(("sensor", "sensors"), "sensor"),
    **dict.fromkeys(("channel", "channels"), "channel"),
    **dict.fromkeys(("electrode", "electrodes"), "electrode"),
    **dict.fromkeys(("unit", "units", "clusters"), "unit"),
    **dict.fromkeys(("neuron", "neurons"), "neuron"),
}
_OF_SENSORS = {*NOUNS, "index", "indices", "list", "activated", "contact", "number", "no"}
_MOMENTS = {"event", "events", "contact", "touch", "frame", "sample", "index", "no", "number"}
_VALUES = {"value", "values", "pressure", "force", "amplitude", "reading", "weight"}

_IN_LIST = re.compile(r"[^\s,;|]+")
_BRACKETS = str.maketrans("[](){}", "      ")
_ROWS_LOOKED_AT = 50
# Chosen by hand: rows of at least three lengths are not a table with a damaged line.
_MIN_BARE_ROWS, _MIN_LENGTHS = 4, 3
_SELECTED = re.compile(r"([^:]+):([^:]+)")

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


def noun_of(name: str) -> str:
    """Return what precedes the numbers of sensors in a column: ``channel`` for ``channel_ids``."""
    nouns = (NOUNS.get(word, "taxel") for word in words_of(name))
    return next((noun for noun in nouns if noun != "taxel"), "taxel")


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
    def numbers(self) -> dict[int, str]:
        """The columns of numbers."""
        return dict.fromkeys([self.moment, self.value][: 1 + (self.value >= 0)], "")

    def ids(self, fields: Sequence[str]) -> list[str]:
        """Return the ids in a row; fields beyond the header continue a ragged list."""
        cells = fields[self.sensor : None if self.ragged else self.sensor + 1]
        return [text for cell in cells for text in _listed(cell)]


def is_text(path: Path, head: bytes) -> bool:
    """Recognise a header of a time or number and of sensors, above rows of whole numbers or lists.

    Further columns, other than a value, make the file a table of readings. Without a header, rows
    must hold a number that does not decrease and different whole numbers, and differ in length.
    """
    return _layout_of(head) is not None


def _layout_of(head: bytes) -> _Layout | None:
    """Return the layout of a list of contacts by its first bytes; see `is_text`."""
    if b"\0" in head or b"\n" not in head:
        return None
    lines = head.decode("utf-8-sig", "replace").splitlines(keepends=True)
    # The last line may be incomplete.
    lines = lines if lines[-1].endswith("\n") else lines[:-1]
    try:
        layout = _find_layout(lines)
        if layout is None:
            return _find_bare_layout(lines)
        found = _rows(lines, layout.delimiter)[1:]
    except csv.Error:
        return None
    # Ids are whole numbers, or words that are no numbers.
    fits = found and all(
        (layout.ragged or len(fields) <= len(layout.header))
        and len(fields) > max(layout.numbers)
        and is_number(fields[layout.moment])
        and all(text.isdecimal() or not is_number(text) for text in layout.ids(fields))
        for fields in found
    )
    return layout if fits else None


@contextmanager
def open_text_list(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a list of contacts or spikes."""
    layout = _layout_of(read_head(path))
    if layout is None:
        raise FileError(f"{path} lacks a header that names a time and the sensors")
    yield stream_contacts(path, _read_text(path, layout), options.bin_s)


def selects_columns(select: str) -> bool:
    """Return whether a selection names two columns: ``event:taxel``, or ``1:5`` from 1."""
    return bool(_SELECTED.fullmatch(select))


def stream_columns(path: Path, options: ReadOptions) -> Stream:
    """Create a stream of two columns of any table: the moment and the sensor of contacts.

    `options.select` names the columns, or gives their numbers from 1, as ``event:taxel``.
    """
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
            problem = f"has no column {quote(text)}; it has {len(first)} columns{names}"
            raise FileError(f"{path} {problem}")
    layout = _Layout(delimiter, header, moment=columns[0], sensor=columns[1])
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
    """Return the layout of rows without a header: a moment, and a varying number of sensors.

    A table of readings has rows of equal length, or repeated values in a damaged one.
    """
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
                raise LineError(path, line, f" has {len(fields)} fields; it must have {needed}")
            moment, *values = parse_row(path, line, fields, layout.numbers)
            ids = [_whole(text) for text in layout.ids(fields)] if np.isfinite(moment) else []
            if None in ids:
                wrong = quote(layout.ids(fields)[ids.index(None)])
                problem = f", column {layout.sensor + 1}: {wrong} must be the id of a sensor"
                raise LineError(path, line, problem)
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
    return not alone and isinstance(found, dict) and _find_columns(list(found)) is not None


@contextmanager
def open_json_list(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a list of contacts or spikes; further properties are ignored."""
    contacts = (_contact(f"{path}, {where}", found) for where, found in _objects(path))
    yield stream_contacts(path, contacts, options.bin_s)


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


def _contact(where: str, found: Any) -> _Contact:
    keys = list(found) if isinstance(found, dict) else []
    columns = _find_columns(keys)
    if columns is None:
        raise FileError(f"{where}: must be an object with a time and sensors")
    moment, sensor, *rest = (keys[i] for i in columns if i >= 0)
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
