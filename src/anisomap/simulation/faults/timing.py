"""What goes wrong with frames and the clock; it befalls all sensors at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from anisomap.errors import InputError
from anisomap.recording import Recording
from anisomap.simulation.faults.log import (
    ALL_SENSORS,
    Fault,
    Spans,
    injected_faults,
    on_record,
    spoilt,
    throughout,
)
from anisomap.simulation.faults.sensors import Randomness


def dropped_frames(recording: Recording, *, rng: Randomness = 0, share: float = 0.05) -> Recording:
    """Lose whole frames, as an overloaded logger does.

    Parameters
    ----------
    recording : Recording
    rng : numpy.random.Generator or int
        Decides which.
    share : float
        Of the frames, between 0 and 1; at least one frame stays.

    Returns
    -------
    Recording
        Without those frames and their times; a rate stays as it was told. On the record is the
        frame after each gap; no reading is wrong. Spans of earlier faults count the frames that
        are left.
    """
    _check_share(share)
    lost = np.random.default_rng(rng).random(recording.n_frames) < share
    if lost.all():
        lost[0] = False
    kept = np.flatnonzero(~lost)
    after_gap = np.flatnonzero(np.diff(kept, prepend=-1) > 1)
    earlier = [
        replace(fault, spans=_left_of(fault.spans, kept)) for fault in injected_faults(recording)
    ]
    times = None if recording.times is None else recording.times[kept]
    shorter = replace(recording, readings=recording.readings[kept], times=times)
    return on_record(shorter, [*earlier, Fault("dropped-frames", "", _single(after_gap))])


def repeated_frames(recording: Recording, *, rng: Randomness = 0, share: float = 0.05) -> Recording:
    """Deliver the last frame again in place of a new one, as a slow driver does.

    Parameters
    ----------
    recording : Recording
    rng : numpy.random.Generator or int
        Decides when.
    share : float
        Of the frames, between 0 and 1; never the first.

    Returns
    -------
    Recording
        As many frames as before.
    """
    _check_share(share)
    stale = np.random.default_rng(rng).random(recording.n_frames) < share
    stale[0] = False
    source = np.maximum.accumulate(np.where(stale, 0, np.arange(recording.n_frames)))
    fault = Fault("repeated-frames", ALL_SENSORS, _single(np.flatnonzero(stale)))
    return spoilt(recording, recording.readings[source], [fault])


def clock_jitter(recording: Recording, *, rng: Randomness = 0, level: float = 0.2) -> Recording:
    """Shake the times of frames.

    Parameters
    ----------
    recording : Recording
        With times, or a rate that gives them.
    rng : numpy.random.Generator or int
        Shakes.
    level : float
        Standard deviation of a frame's time, as a share of the interval between frames, between 0
        and 1. At most 0.45 of the interval to its neighbours, so that times still increase.

    Returns
    -------
    Recording
        With the same readings. On the record are all frames, and no sensor.

    Raises
    ------
    InputError
        If neither times nor rate are known.
    """
    _check_share(level, "level")
    if recording.times is None and recording.rate_hz is None:
        raise InputError("the recording has neither times nor a rate, so no clock can jitter")
    times = recording.times
    if times is None:
        times = np.arange(recording.n_frames) / (recording.rate_hz or 1.0)
    gaps = np.diff(times)
    room = 0.45 * np.minimum(
        np.append(gaps, gaps[-1:] if len(gaps) else 1.0),
        np.concatenate([gaps[:1] if len(gaps) else [1.0], gaps]),
    )
    typical = float(np.median(gaps)) if len(gaps) else 1.0
    shake = level * typical * np.random.default_rng(rng).standard_normal(len(times))
    shaken = replace(recording, times=times + np.clip(shake, -room, room))
    fault = Fault("clock-jitter", "", throughout(recording.n_frames))
    return on_record(shaken, [*injected_faults(recording), fault])


def _check_share(share: float, name: str = "share") -> None:
    if not 0 < share < 1:
        raise InputError(f"{name} is {share:g}; it must be between 0 and 1")


def _single(frames: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Spans:
    return tuple((int(frame), int(frame) + 1) for frame in frames)


def _left_of(spans: Spans, kept: np.ndarray[tuple[int], np.dtype[np.intp]]) -> Spans:
    """Count spans in the frames that are left of them."""
    moved = (tuple(int(edge) for edge in np.searchsorted(kept, span)) for span in spans)
    return tuple((start, stop) for start, stop in moved if stop > start)
