"""Events, contacts or spikes, and their frames.

A frame is one moment, or counts events in a bin of constant width. In text, spikes have one line or
one column of times per channel, with or without names, in seconds::

    A1,0.012,0.85,2.33          A1,A2
    A2,0.020                    0.012,0.020
    A3,0.015,0.86               0.85,
"""

from __future__ import annotations

import functools
import itertools
import math
from array import array
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.base.clocks import words_of
from anisomap.errors import FileError
from anisomap.files.budget import Budget
from anisomap.io.parsing.names import numbers_of
from anisomap.io.parsing.source import read_lines, warn
from anisomap.io.parsing.tables import find_delimiter, is_number, parse_number, records
from anisomap.io.stream import Stream, read_in_blocks
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

    moments: Seconds if they are `timed`, else numbers of events.
    sensors: Index in `names`; -1 for a moment without an active sensor.
    values: Readings; 1 by default.
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
    """Events while they are read, within the budget of their file; each may have a value."""

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


NOUNS = {
    **dict.fromkeys(("id", "ids", "taxel", "taxels", "contacts", "active", "touched"), "taxel"),
    **dict.fromkeys(("sensor", "sensors"), "sensor"),
    **dict.fromkeys(("channel", "channels"), "channel"),
    **dict.fromkeys(("electrode", "electrodes"), "electrode"),
    **dict.fromkeys(("unit", "units", "clusters"), "unit"),
    **dict.fromkeys(("neuron", "neurons"), "neuron"),
}


def noun_of(name: str) -> str:
    """Return what precedes the numbers of sensors in a column: ``channel`` for ``channel_ids``."""
    nouns = (NOUNS.get(word, "taxel") for word in words_of(name))
    return next((noun for noun in nouns if noun != "taxel"), "taxel")


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
    """Create a stream of the values at each moment, or the counts or last values in each bin.

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
    """Create a stream of the counts of spikes whose times are in lines or columns."""
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
    """Return the name and times of each channel; None unless they increase and have fractions."""
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
