"""Lists of contacts or spikes as JSON: a list of objects, or one object per line.

For example ``{"time": 0.12, "taxels": [3, 4, 17]}``; further properties are ignored.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from anisomap.errors import FileError
from anisomap.io.parsing.columns import is_time, units_per_second
from anisomap.io.parsing.source import open_text, quote, read_json_items
from anisomap.io.parsing.table import LineError, read_undamaged
from anisomap.io.recordings.events import (
    EventColumns,
    EventList,
    Events,
    find_columns,
    name_sensors,
    noun_of,
    stream_events,
)
from anisomap.io.stream import ReadOptions, Stream


def recognises(path: Path, head: bytes) -> bool:
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
    return not alone and isinstance(found, dict) and find_columns(list(found)) is not None


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a list of contacts or spikes."""
    events_read = EventList[str](path)
    name = noun = ""
    valued = False
    for where, found in _objects(path):
        columns = find_columns(list(found)) if isinstance(found, dict) else None
        if columns is None:
            raise FileError(f"{path}, {where}: must be an object with a time and sensors")
        keys = list(found)
        name, noun = keys[columns.moment], noun_of(keys[columns.sensor])
        valued = valued or columns.value >= 0
        moment, active, value = _parsed(f"{path}, {where}", found, keys, columns)
        events_read.add(moment, active, value)
    names, index = name_sensors(events_read.sensors, noun)
    at = np.array(events_read.moments, dtype=np.float64)
    timed = is_time(name)
    events = Events(
        at / units_per_second(name, at) if timed else at,
        events_read.indices(index),
        names,
        np.array(events_read.values) if valued else None,
        timed=timed,
    )
    yield stream_events(path, events, bin_s=options.bin_s, metadata={"format": "list of contacts"})


def _objects(path: Path) -> Iterator[tuple[str, Any]]:
    """Yield the objects of a list, or of all lines, each with its place."""
    with open_text(path) as stream:
        start = next((line for line in stream if line.strip()), "")
    if start.lstrip("\ufeff \t").startswith("["):
        yield from ((f"contact {i}", found) for i, found in enumerate(read_json_items(path)))
        return

    def parse(lines: Iterable[str]) -> Iterator[tuple[str, Any]]:
        for number, line in enumerate(lines, start=1):
            if line.strip():
                yield f"line {number}", _decoded(path, number, line)

    yield from read_undamaged(path, parse, "contacts")


def _decoded(path: Path, number: int, line: str) -> Any:
    try:
        return json.loads(line)
    except json.JSONDecodeError as error:
        raise LineError(path, number, f": not valid JSON ({error.msg})") from error
    except (ValueError, RecursionError) as error:
        raise LineError(path, number, f": not valid JSON ({error})") from error


def _parsed(
    where: str, found: dict[str, Any], keys: list[str], columns: EventColumns
) -> tuple[float, list[str], float]:
    """Return the moment, ids and value of a contact."""
    moment = _number(where, keys[columns.moment], found[keys[columns.moment]])
    listed = found[keys[columns.sensor]]
    listed = listed if isinstance(listed, list) else [listed]
    for each in listed:
        whole = isinstance(each, int) and not isinstance(each, bool) and each >= 0
        if not whole and not (isinstance(each, str) and each.strip()):
            raise FileError(f"{where}: {quote(str(each))} must be the id of a sensor")
    key = keys[columns.value] if columns.value >= 0 else ""
    return moment, [str(each) for each in listed], _number(where, key, found[key]) if key else 1.0


def _number(where: str, key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise FileError(f"{where}: {key} must be a number, got {quote(str(value))}")
    return float(value)
