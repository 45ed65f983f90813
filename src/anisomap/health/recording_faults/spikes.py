"""Spikes: all sensors of a board jump by the same amount for one frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from anisomap.health.recording_faults.found import Found, in_readings
from anisomap.numerics.signals import middle_frames, some_sensors, unit_rows
from anisomap.recording import Recording

_MIN_GROUP = 5  # sensors of a board; three or four may be touched alike by a flat object
_MIN_LEVELS = 8  # distinct heights of jumps: sensors with two values always jump by the same
_MIN_SPIKES = 5  # in a recording
_MAX_SHARE = 0.15  # of the frames; white noise jumps up in a third of them
_MIN_LINK = 0.7  # correlation of the jumps of two sensors of a board; chosen by hand
_MIN_HEIGHT = 0.1  # standard deviations of the readings; less changes no correlation
_MIN_EQUAL = 0.5  # share of the common jumps that are spikes; chosen by hand
_MIN_JUDGED = 20  # common jumps from which half that share tells contacts; chosen by hand
_MAX_SPREAD = 0.1  # relative spread of the jumps of the sensors of a board; contacts have 0.3
_FRAMES_AT_ONCE, _SENSORS_AT_ONCE = 4096, 64  # of which jumps are computed; they fit in the cache
_MAX_SENSORS = 1024  # in which spikes are searched
_STEEP = 2.0  # height of a spike over the changes beside it; tops of contacts have less; by hand
_MIN_AT_ONCE = 0.6  # share of the sensors of a board that must jump: the others are in contact


def find_spikes(recording: Recording) -> Iterator[Found]:
    """Find spikes that groups of sensors share.

    A contact rises and falls over several frames or is highest in the middle; a spike of a board
    lasts one frame and is equally high in all of its sensors. Sensors are grouped by the
    correlation of their jumps, the excess of a reading over both readings beside it.
    """
    n_frames, n_sensors = recording.readings.shape
    if n_frames < 100 or n_sensors < _MIN_GROUP:
        return
    chosen = some_sensors(n_sensors, _MAX_SENSORS)
    jumps = _jumps(recording.readings, chosen, middle_frames(n_frames))
    jumping = np.count_nonzero(jumps, axis=1) >= _MIN_SPIKES
    if np.count_nonzero(jumping) < _MIN_GROUP:
        return
    chosen, jumps = chosen[jumping], jumps[jumping]
    rows = unit_rows(jumps.T)
    _, group = connected_components(rows @ rows.T > _MIN_LINK, directed=False)
    for number in np.flatnonzero(np.bincount(group) >= _MIN_GROUP).tolist():
        members = chosen[group == number]
        if _may_be_equal(jumps[group == number]):
            yield from _shared(recording, members)


def _jumps(readings: NDArray[Any], sensors: NDArray[np.intp], frames: slice) -> NDArray[np.float32]:
    """Return the excess of readings over both readings beside them, shape (n, t); at least 0.

    It is 0 in the first and the last frame.
    """
    jumps = np.zeros((sensors.size, len(range(len(readings))[frames])), dtype=np.float32)
    for begin in range(0, sensors.size, _SENSORS_AT_ONCE):
        part = slice(begin, begin + _SENSORS_AT_ONCE)
        values = readings.T[sensors[part], frames].astype(np.float32)
        beside = np.maximum(values[:, :-2], values[:, 2:])
        np.subtract(values[:, 1:-1], beside, out=beside)
        np.maximum(beside, 0, out=jumps[part, 1:-1])
    return jumps


def _may_be_equal(jumps: NDArray[np.float32]) -> bool:
    """Return whether jumps of a group, shape (n, t), can be spikes, or are too few to tell."""
    frames = _jumping_together(jumps)
    if frames.size < _MIN_JUDGED:
        return frames.size > 0
    return bool(np.mean(_equal(jumps[:, frames])[1]) >= _MIN_EQUAL / 2)


def _jumping_together(jumps: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the frames in which most sensors jump."""
    return np.flatnonzero(np.count_nonzero(jumps, axis=0) >= _MIN_AT_ONCE * len(jumps))


def _equal(heights: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the median height of jumps, shape (n, t), and where all are about equally high."""
    height = np.median(heights, axis=0)
    spread = np.median(np.abs(heights - height), axis=0) / np.maximum(height, 1e-30)
    return height, spread <= _MAX_SPREAD


def _shared(recording: Recording, members: NDArray[np.intp]) -> Iterator[Found]:
    """Find the spikes of a group; there are none if its jumps differ, as those of contacts do."""
    readings, n_frames = recording.readings, recording.n_frames
    often, tall = [], []
    for begin in range(1, n_frames - 1, _FRAMES_AT_ONCE):
        stop = min(begin + _FRAMES_AT_ONCE, n_frames - 1)
        jumps = _jumps(readings, members, slice(begin - 1, stop + 1))[:, 1:-1]
        found = _jumping_together(jumps)
        often.append(begin + found)
        tall.append(jumps[:, found])
    frames, heights = np.concatenate(often), np.concatenate(tall, axis=1)
    around = np.clip(frames + np.array([[-2], [-1], [1], [2]]), 0, n_frames - 1)
    beside = readings[around[..., None], members].astype(np.float32)
    changes = np.maximum(np.abs(beside[1] - beside[0]), np.abs(beside[2] - beside[3]))
    steep = np.median(heights, axis=0) > _STEEP * np.median(changes, axis=1)
    frames, (height, equal) = frames[steep], _equal(heights[:, steep])
    if not _MIN_SPIKES <= frames.size <= _MAX_SHARE * n_frames:
        return
    frames, height = frames[equal], height[equal]
    if (
        frames.size < max(_MIN_SPIKES, _MIN_EQUAL * equal.size)
        or np.unique(height.round(6)).size < min(_MIN_LEVELS, frames.size / 2)
        or np.median(height) < _MIN_HEIGHT * np.median(readings[:, members].std(axis=0))
    ):
        return
    yield Found(
        members,
        frames.size / n_frames,
        f"a group of {members.size} sensors jumps for single frames, {frames.size} times by ",
        in_readings(lambda readings: _smoothed(readings, frames, members)),
        height=float(np.median(height)),
    )


def _smoothed(
    readings: NDArray[Any], frames: NDArray[np.intp], sensors: NDArray[np.intp]
) -> NDArray[Any]:
    """Replace readings of some sensors in some frames by the mean of the frames beside them."""
    mended = np.array(readings)
    beside = (readings[frames - 1] + readings[frames + 1]) / 2
    mended[np.ix_(frames, sensors)] = beside[:, sensors]
    return mended
