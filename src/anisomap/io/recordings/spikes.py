"""Spike trains, in files of named arrays (HDF5, MATLAB 7.3) and in delimited text.

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
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.source import read_lines
from anisomap.io.parsing.tables import find_delimiter, is_number, parse_number, records
from anisomap.io.recordings.events import Events, stream_events
from anisomap.io.stream import Stream

if TYPE_CHECKING:
    from anisomap.io.recordings.hdf5 import Dataset

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


def stream_table(path: Path, bin_s: float) -> Stream:
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
