"""Contacts and spikes in NumPy archives: one array of times, one of the sensors at them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.events.event_frames import Events, stream_events
from anisomap.io.parsing.archive import NUMBERS, WHOLE, Archive
from anisomap.io.parsing.naming import distinct_names
from anisomap.io.stream import Stream

_TIMES, _NUMBERED = ("times", "time", "spike_times"), ("events", "event")
_SENSORS = {
    **dict.fromkeys(("ids", "taxels", "contacts"), "taxel"),
    **dict.fromkeys(("sensors", "sensor"), "sensor"),
    **dict.fromkeys(("channels", "channel"), "channel"),
    **dict.fromkeys(("electrodes", "electrode"), "electrode"),
    **dict.fromkeys(("units", "unit", "spike_clusters"), "unit"),
}


def _first(archive: Archive, names: tuple[str, ...]) -> str:
    return next((name for name in names if name in archive.names), "")


def holds_events(archive: Archive) -> bool:
    """Return whether an archive has an array of times or numbers, and one of sensors."""
    return bool(_first(archive, (*_TIMES, *_NUMBERED)) and _sensors_of(archive))


def _sensors_of(archive: Archive) -> str:
    # The unit of the positions has the name of an array of units.
    return _first(
        archive,
        tuple(name for name in _SENSORS if name != "units" or "positions" not in archive.names),
    )


def stream_archived(archive: Archive, bin_s: float | None) -> Stream:
    """Create a stream of the events in an archive.

    Parameters
    ----------
    archive : Archive
        With ``times`` in seconds, or ``events``, and ``taxels``, ``sensors``, ``channels`` or the
        like, of shape (E,). ``names`` and ``positions``, one per sensor, make the numbers of
        sensors indices, and tell which sensors were silent.
    bin_s : float or None
        Width of bins.

    Returns
    -------
    Stream

    Raises
    ------
    FileError
        If shapes differ, or a number is not the index of a sensor.
    """
    path = archive.path
    at, which = _first(archive, (*_TIMES, *_NUMBERED)), _sensors_of(archive)
    moments = archive.required(at, NUMBERS).astype(np.float64)
    sensors = archive.required(which, WHOLE).astype(np.int64)
    if moments.ndim != 1 or moments.shape != sensors.shape:
        raise FileError(
            f"{path}: {at} and {which} must be lists of equal length, got shapes {moments.shape} "
            f"and {sensors.shape}"
        )
    if sensors.min(initial=0) < 0:
        raise FileError(f"{path}: {which} must be numbers of sensors from 0")
    names = distinct_names(path, archive.texts("names"))
    positions: NDArray[np.float64] | None = archive.array("positions", NUMBERS)
    noun = _SENSORS[which]
    n_known = len(names) or (0 if positions is None else len(positions))
    if n_known:
        if sensors.max(initial=0) >= n_known:
            raise FileError(
                f"{path}: {which} holds {sensors.max()}, but there are {n_known} sensors"
            )
        names = names or tuple(f"{noun}{i}" for i in range(n_known))
    else:
        numbers, sensors = np.unique(sensors, return_inverse=True)
        names = tuple(f"{noun}{number}" for number in numbers.tolist())
    return stream_events(
        path,
        Events(moments, sensors.astype(np.intp), names, timed=at in _TIMES),
        bin_s=bin_s,
        spikes=noun in ("channel", "electrode", "unit") and at in _TIMES,
        positions=positions,
        metadata={"format": "NumPy archive of events"},
    )
