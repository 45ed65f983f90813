"""Lists of events and their frames.

A frame is one moment, or counts events in a bin of constant width.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.naming import numbers_of
from anisomap.io.parsing.source import warn
from anisomap.io.stream import BLOCK_BYTES, Block, Stream
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
