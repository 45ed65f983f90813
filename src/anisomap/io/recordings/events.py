"""Events, contacts or spikes, and their frames; and spike trains in arrays and text.

A frame is one moment, or counts events in a bin of constant width.

Three layouts of arrays are known: the times of all units in one vector, beside the number of spikes
of each unit (``spikes``, ``sCount``: the retinal wave repository, Eglen et al. 2014, GigaScience
3:3, doi:10.1186/2047-217X-3-3), or beside the end of each unit in the vector (``spike_times``,
``spike_times_index``: Neurodata Without Borders), or a group with one vector of times per unit,
whose names hold numbers.

Text has one line or one column of times per channel, with or without names, in seconds::

    A1,0.012,0.85,2.33          A1,A2
    A2,0.020                    0.012,0.020
    A3,0.015,0.86               0.85,
"""

from __future__ import annotations

import itertools
import math
import re
from array import array
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.names import numbers_of
from anisomap.io.parsing.source import read_lines, warn
from anisomap.io.parsing.tables import find_delimiter, is_number, parse_number, records
from anisomap.io.stream import BLOCK_BYTES, Block, Stream
from anisomap.memory import Budget
from anisomap.recording import Scalar

if TYPE_CHECKING:
    from anisomap.io.recordings.hdf5 import Dataset

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
        """Return the index of the sensor of each event, -1 for none."""
        places = np.array([*(index[key] for key in self._seen), -1], dtype=np.intp)
        return places[np.asarray(self._numbers, dtype=np.intp)]


def name_sensors(ids: Sequence[str], noun: str) -> tuple[tuple[str, ...], dict[str, int]]:
    """Name the sensors of events, in the order of their numbers, else of appearance."""
    found = list(dict.fromkeys(ids))
    if all(text.isascii() and text.isdecimal() for text in found) and numbers_of(found):
        found.sort(key=int)
        return tuple(f"{noun}{text}" for text in found), {text: i for i, text in enumerate(found)}
    return tuple(found), {text: i for i, text in enumerate(found)}


def stream_events(
    path: Path,
    events: Events,
    *,
    bin_s: float | None = None,
    span: tuple[float, float] | None = None,
    spikes: bool = False,
    contacts: bool = False,
    metadata: Mapping[str, Scalar],
    **known: Any,
) -> Stream:
    """Create a stream of frames from events.

    Without bins, a frame is one moment, in order of time; a reading is 1 if the sensor was active,
    or its value. With bins, a reading is the number of events in the bin, or the last value.

    known: Further fields of the stream.
    """
    if not (events.sensors >= 0).any():
        raise FileError(f"{path} holds no event")
    if not np.isfinite(events.moments).all():
        raise FileError(f"{path}: the time of an event is not finite")
    if bin_s is not None and not events.timed:
        raise FileError(f"{path} numbers its events without times, so bins do not apply to it")
    needs_bins = spikes
    if events.timed and not (spikes or contacts):
        _, counts = np.unique(events.moments[events.sensors >= 0], return_counts=True)
        needs_bins = bool(np.mean(counts == 1) > _MAX_SHARE_ALONE)
    if bin_s is None and needs_bins:
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
        _blocks(events, frames, times, counted=bin_s is not None),
        names=events.names,
        rate_hz=None if bin_s is None else 1 / bin_s,
        source=path.name,
        metadata={**metadata, **facts},
        from_zero=True,
        silent_are_zero=True,
        **known,
    )


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


def _blocks(
    events: Events, frames: NDArray[np.intp], times: NDArray[np.float64], *, counted: bool
) -> Iterator[Block]:
    n_frames, n_sensors = len(times), len(events.names)
    step = max(1, BLOCK_BYTES // (4 * n_sensors))
    for first in range(0, n_frames, step):
        last = min(first + step, n_frames)
        inside = slice(*np.searchsorted(frames, [first, last]))
        rows, columns = frames[inside] - first, events.sensors[inside]
        active = columns >= 0
        where = rows[active], columns[active]
        kind = np.float32 if events.values is None else np.float64
        readings = np.zeros((last - first, n_sensors), kind)
        if counted and events.values is None:
            np.add.at(readings, where, 1)
        else:
            readings[where] = 1 if events.values is None else events.values[inside][active]
        yield Block(readings, last / n_frames, times[first:last] if events.timed else None)


_NUMBERS = "iuf"
_MIN_UNITS = 2
_DIGIT = re.compile(r"\d")


@dataclass(frozen=True)
class SpikeTrains:
    """The arrays that hold the spike times of several units.

    name: Name to select them by.
    times: Times of all units, or one array per unit.
    index: Divides the times among the units; None for one array per unit.
    counted: Whether it gives the number of spikes of each unit, or else the end of the unit.
    """

    name: str
    times: tuple[Dataset, ...]
    index: Dataset | None = None
    counted: bool = True

    @property
    def n_units(self) -> int:
        """Number of units."""
        return math.prod(self.index.shape) if self.index else len(self.times)

    @property
    def members(self) -> set[str]:
        """Names of all arrays."""
        return {each.name for each in (*self.times, self.index) if each}


def find_spike_trains(arrays: Sequence[Dataset]) -> tuple[SpikeTrains, ...]:
    """Find the spike trains of each group."""
    groups: dict[str, list[Dataset]] = {}
    for each in arrays:
        groups.setdefault(each.group, []).append(each)
    return tuple(found for group, members in groups.items() if (found := _in_group(group, members)))


def _in_group(group: str, members: Sequence[Dataset]) -> SpikeTrains | None:
    vectors = {each.key: each for each in members if _is_vector(each)}
    for times, index in (("spikes", "scount"), ("spike_times", "spike_times_index")):
        if times in vectors and index in vectors:
            found = vectors[times]
            return SpikeTrains(found.name, (found,), vectors[index], index == "scount")
    one_each = group and len(vectors) == len(members) >= _MIN_UNITS
    numbered = all(each.kind == "f" and _DIGIT.search(key) for key, each in vectors.items())
    lengths = {math.prod(each.shape) for each in vectors.values()}
    # Vectors of equal length are readings or properties of sensors.
    if one_each and numbered and len(lengths) > 1:
        return SpikeTrains(group, tuple(members))
    return None


def _is_vector(array: Dataset) -> bool:
    """Return whether an array is a vector of numbers, which MATLAB stores as a matrix."""
    return array.kind in _NUMBERS and sum(size != 1 for size in array.shape) <= 1


def stream_spikes(
    path: Path,
    trains: SpikeTrains,
    bin_s: float | None,
    *,
    names: tuple[str, ...] = (),
    **known: Any,
) -> Stream:
    """Create a stream of spike counts; `known` are further arguments of `stream_events`."""
    vectors = [each.whole().astype(np.float64).ravel() for each in trains.times]
    times = np.concatenate(vectors)
    if trains.index is None:
        counts = np.array([len(vector) for vector in vectors])
        names = names or tuple(each.name.rpartition("/")[2] for each in trains.times)
    else:
        counts = _counts(path, trains, trains.index, len(times))
    units = np.repeat(np.arange(len(counts)), counts)
    events = Events(times, units, names or tuple(f"e{i}" for i in range(len(counts))))
    facts = {"format": "spike trains"}
    return stream_events(path, events, bin_s=bin_s, spikes=True, metadata=facts, **known)


def _counts(path: Path, trains: SpikeTrains, index: Dataset, n_spikes: int) -> NDArray[np.intp]:
    """Return the number of spikes of each unit."""
    values = index.whole().astype(np.float64).ravel()
    counts = values if trains.counted else np.diff(values, prepend=0)
    whole = bool(np.isfinite(counts).all() and (counts == np.floor(counts)).all())
    if not whole or counts.min(initial=0) < 0 or counts.sum() != n_spikes:
        raise FileError(
            f"{path}: {index.name} must divide the {n_spikes} times of {trains.name} among the "
            f"units, but it gives {counts.sum():g}"
        )
    return counts.astype(np.intp)


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
    events = Events(
        np.array([time for _, times in trains for time in times], dtype=np.float64),
        np.repeat(np.arange(len(trains)), [len(times) for _, times in trains]),
        tuple(name for name, _ in trains),
    )
    facts = {"format": "spike trains"}
    return stream_events(path, events, bin_s=bin_s, spikes=True, metadata=facts)


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
