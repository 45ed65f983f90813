"""Spikes: simultaneous jumps of all sensors of a board for one frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.health.recording_faults import Found, has_contacts, linked_groups
from anisomap.numerics.signals import count_contacts, excerpt_frames, some_sensors, unit_rows
from anisomap.recording import Recording

_MIN_GROUP = 5  # sensors of a board; a flat object may touch three or four equally
_MIN_LEVELS = 8  # distinct heights of jumps: all jumps of sensors with two values are equal
_MIN_SPIKES = 5  # in a recording
_MAX_SPIKES = 0.15  # of the frames; white noise jumps up in a third of them
_MIN_LINK = 0.7  # correlation of the jumps of two sensors of a board; chosen by hand
_MIN_HEIGHT = 0.1  # standard deviations of the readings; less hardly changes correlations
_MIN_EQUAL = 0.5  # share of the common jumps that are spikes; chosen by hand
_MAX_SPREAD = 0.1  # relative spread of the jumps of the sensors of a board; contacts have 0.3
_MAX_SENSORS = 1024  # in which spikes are searched for
_STEEP = 2.0  # height of a spike relative to adjacent changes; less for peaks of contacts; by hand
_MIN_DURATION = 2.0  # of contacts, relative to shuffled frames, which resemble spikes; by hand
_MIN_AT_ONCE = 0.6  # share of the sensors of a board that must jump; the others may be in contact


def find_spikes(recording: Recording) -> Iterator[Found]:
    """Find common spikes of groups of sensors in an excerpt.

    A contact rises and falls over several frames, or is highest in the middle. A spike of a board
    lasts one frame and has equal height in all sensors of the board. Sensors are grouped by the
    correlation of jumps, i.e. the excess of a reading over both adjacent readings. A group without
    contacts, or with contacts of single frames or of one kind only, is not judged.
    """
    excerpt = excerpt_frames(recording.readings)
    readings, chosen = recording.readings[excerpt], some_sensors(recording.n_sensors, _MAX_SENSORS)
    if len(readings) < 100 or chosen.size < _MIN_GROUP:
        return
    jumps = _jumps(readings[:, chosen])
    jumping = np.flatnonzero(np.count_nonzero(jumps, axis=0) >= _MIN_SPIKES)
    for group in linked_groups(unit_rows(jumps)[jumping], _MIN_LINK, _MIN_GROUP):
        members = chosen[jumping[group]]
        frames, height = _common(jumps[:, jumping[group]], readings[:, members])
        touched = recording.signals.touched[excerpt][:, members]
        if (
            frames.size >= _MIN_SPIKES
            and _persist(np.delete(touched, frames, axis=0))
            and has_contacts(Recording(np.delete(readings, frames, axis=0)), members)
        ):
            yield Found(members, frames.size / len(readings), {"height": height})


def _jumps(readings: NDArray[Any]) -> NDArray[np.float32]:
    """Return the excess of readings over both adjacent readings, shape (t, n); at least 0.

    It is 0 in the first and the last frame.
    """
    jumps = np.zeros(readings.shape, dtype=np.float32)
    beside = np.maximum(readings[:-2], readings[2:])
    np.maximum(readings[1:-1] - beside, 0, out=jumps[1:-1], casting="same_kind")
    return jumps


def _common(jumps: NDArray[np.float32], readings: NDArray[Any]) -> tuple[NDArray[np.intp], float]:
    """Return frames and height of the spikes of a group; no frames if jumps are contacts."""
    frames = np.flatnonzero(np.count_nonzero(jumps, axis=1) >= _MIN_AT_ONCE * jumps.shape[1])
    changes = np.pad(np.median(np.abs(np.diff(readings, axis=0)), axis=1), 2)
    beside = np.maximum(changes[frames], changes[frames + 3])
    frames = frames[np.median(jumps[frames], axis=1) > _STEEP * beside]
    heights = np.median(jumps[frames], axis=1)
    spread = np.median(np.abs(jumps[frames] - heights[:, None]), axis=1)
    equal = spread <= _MAX_SPREAD * heights
    height = float(np.median(heights[equal])) if equal.any() else 0.0
    n_distinct = np.unique((heights[equal] / max(heights.max(initial=0), 1e-30)).round(6)).size
    if (
        frames.size > _MAX_SPIKES * len(jumps)
        or np.count_nonzero(equal) < _MIN_EQUAL * equal.size
        or n_distinct < min(_MIN_LEVELS, np.count_nonzero(equal) / 2)
        or height < _MIN_HEIGHT * np.median(readings.std(axis=0))
    ):
        return frames[:0], 0.0
    return frames[equal], height


def _persist(touched: NDArray[np.bool_]) -> bool:
    """Return whether contacts, shape (t, n), last clearly longer than in shuffled frames."""
    n_frames = np.count_nonzero(touched) * (1 - touched.mean())
    return bool(n_frames > _MIN_DURATION * count_contacts(touched).sum())
