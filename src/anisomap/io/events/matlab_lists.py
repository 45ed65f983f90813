"""Contacts and spike trains in cell arrays and structures of MATLAB.

A cell array of vectors, or a field of a structure array (or of a cell array of structures), holds
either the ids of the sensors of each contact, which are whole numbers, or the spike times of each
channel. A matrix of four columns holds ``x y z id``, one row per sensor of a contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.io.events.event_frames import Events, name_sensors, stream_events
from anisomap.io.stream import Stream

_NUMBERS = "iuf"
_WITH_POINT = 4


@dataclass(frozen=True, eq=False)
class Lists:
    """Lists of numbers of different lengths.

    Parameters
    ----------
    name : str
        Name of the variable, with the field.
    lists : tuple of ndarray
        One per contact or channel.
    contacts : bool
        Whether the lists are ids of sensors; otherwise they are times.
    """

    name: str
    lists: tuple[NDArray[np.float64], ...]
    contacts: bool

    @property
    def summary(self) -> str:
        """Description for display."""
        return f"{len(self.lists)} {'lists of sensors' if self.contacts else 'spike trains'}"


def find_lists(name: str, value: NDArray[Any]) -> tuple[Lists, ...]:
    """Find the lists of contacts or spikes in a variable.

    Parameters
    ----------
    name : str
    value : ndarray
        A cell array, of dtype object, or a structure array, with one field per name of its dtype.

    Returns
    -------
    tuple of Lists
    """
    items = [*value.ravel()]
    if value.dtype.names is None and all(_is_struct(item) for item in items):
        items = [item.ravel()[0] for item in items if item.size == 1]
        fields = items[0].dtype.names if items and len(items) == value.size else ()
        same = all(item.dtype.names == fields for item in items)
        return _of_fields(name, items, fields or ()) if same else ()
    if value.dtype.names is not None:
        return _of_fields(name, items, value.dtype.names)
    found = _lists(name, items)
    return (found,) if found else ()


def stream_lists_of(path: Path, lists: Lists, bin_s: float | None) -> Stream:
    """Create a stream of lists: a frame per contact, or counts of spikes in bins."""
    lengths = [len(each) for each in lists.lists]
    values = np.concatenate(lists.lists)
    if not lists.contacts:
        names = tuple(f"channel{i + 1}" for i in range(len(lengths)))
        events = Events(values, np.repeat(np.arange(len(lengths)), lengths), names)
        return stream_events(
            path, events, bin_s=bin_s, spikes=True, metadata={"format": "spike trains"}
        )
    ids, sensors = np.unique(values.astype(np.int64), return_inverse=True)
    names, _ = name_sensors([str(each) for each in ids.tolist()], "taxel")
    moments = np.repeat(np.arange(float(len(lengths))), np.maximum(lengths, 1))
    active = np.full(len(moments), -1, dtype=np.intp)
    active[np.repeat(np.array(lengths) > 0, np.maximum(lengths, 1))] = sensors
    return stream_events(
        path,
        Events(moments, active, names, timed=False),
        bin_s=bin_s,
        metadata={"format": "list of contacts", "variable": lists.name},
    )


def _is_struct(item: Any) -> bool:
    return isinstance(item, np.ndarray) and item.dtype.names is not None


def _of_fields(name: str, items: Sequence[Any], fields: Sequence[str]) -> tuple[Lists, ...]:
    found = (_lists(f"{name}/{field}", [item[field] for item in items]) for field in fields)
    return tuple(each for each in found if each)


def _lists(name: str, items: Sequence[Any]) -> Lists | None:
    vectors = [_vector(item) for item in items]
    known = [vector for vector in vectors if vector is not None]
    if len(known) < len(items) or max(map(len, known), default=0) < 2:
        return None
    values = np.concatenate(known)
    # Ids in float64 are exact up to 2^53, which no numbering of sensors reaches.
    whole = bool(((values >= 0) & (values == np.floor(values)) & (values < 2**53)).all())
    times = all((np.diff(vector) >= 0).all() for vector in known)
    return Lists(name, tuple(known), contacts=whole) if whole or times else None


def _vector(item: Any) -> NDArray[np.float64] | None:
    """Return a vector as float64, the last column of ``x y z id``, or None for anything else."""
    if not isinstance(item, np.ndarray) or item.dtype.kind not in _NUMBERS or item.ndim != 2:
        return None
    values = item.astype(np.float64)
    if not values.size or 1 in values.shape:
        # A single row of four columns with fractions is a point with an id.
        fractions = bool((values[..., :3] % 1 != 0).any())
        return values[0, 3:] if values.shape == (1, _WITH_POINT) and fractions else values.ravel()
    return values[:, 3] if values.shape[1] == _WITH_POINT else None
