"""Faults of whole frames and of the clock, which affect all sensors."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording
from anisomap.simulation.faults.log import (
    ALL_SENSORS,
    Fault,
    Spans,
    all_frames,
    injected_faults,
    with_faults,
    with_log,
)
from anisomap.simulation.faults.sensors import Randomness

# x the interval to the next frame. Below 0.5, so that adjacent frames stay in order.
_MAX_JITTER = 0.45


def dropped_frames(recording: Recording, *, rng: Randomness = 0, share: float = 0.05) -> Recording:
    """Remove random frames, like an overloaded logger.

    Parameters
    ----------
    recording : Recording
    rng : numpy.random.Generator or int
    share : float
        Expected share of the frames, between 0 and 1. At least one frame remains.

    Returns
    -------
    Recording
        The frames and their times are removed; the nominal rate is kept. The log marks the frame
        after each gap, but no reading as wrong. Spans of earlier faults are renumbered.

    Raises
    ------
    InputError
        If `share` is not between 0 and 1.
    """
    _check_share(share)
    lost = np.random.default_rng(rng).random(recording.n_frames) < share
    if lost.all():
        lost[0] = False
    kept = np.flatnonzero(~lost)
    after_gap = np.flatnonzero(np.diff(kept, prepend=-1) > 1)
    earlier = [
        replace(fault, spans=_renumbered(fault.spans, kept)) for fault in injected_faults(recording)
    ]
    times = None if recording.times is None else recording.times[kept]
    shorter = replace(recording, readings=recording.readings[kept], times=times)
    return with_log(shorter, [*earlier, Fault("dropped-frames", "", _single_frames(after_gap))])


def repeated_frames(recording: Recording, *, rng: Randomness = 0, share: float = 0.05) -> Recording:
    """Replace random frames by the previous frame, like a slow driver.

    Parameters
    ----------
    recording : Recording
    rng : numpy.random.Generator or int
    share : float
        Expected share of the frames, between 0 and 1. The first frame is never replaced.

    Returns
    -------
    Recording

    Raises
    ------
    InputError
        If `share` is not between 0 and 1.
    """
    _check_share(share)
    stale = np.random.default_rng(rng).random(recording.n_frames) < share
    stale[0] = False
    source = np.maximum.accumulate(np.where(stale, 0, np.arange(recording.n_frames)))
    fault = Fault("repeated-frames", ALL_SENSORS, _single_frames(np.flatnonzero(stale)))
    return with_faults(recording, recording.readings[source], [fault])


def clock_jitter(recording: Recording, *, rng: Randomness = 0, level: float = 0.2) -> Recording:
    """Add Gaussian jitter to the times of frames.

    Parameters
    ----------
    recording : Recording
        With times, or with a rate from which times are computed.
    rng : numpy.random.Generator or int
    level : float
        Standard deviation as a share of the median interval, between 0 and 1. Jitter is limited to
        0.45 of the intervals on either side, so that times increase.

    Returns
    -------
    Recording
        Readings are unchanged. The log marks all frames, but no reading as wrong.

    Raises
    ------
    InputError
        If the recording has neither times nor a rate, or `level` is not between 0 and 1.
    """
    _check_share(level, "level")
    if recording.times is None and recording.rate_hz is None:
        raise InputError("clock jitter needs a recording with times or a rate")
    times = recording.times
    if times is None:
        times = np.arange(recording.n_frames) / (recording.rate_hz or 1.0)
    gaps = np.diff(times)
    limit = _MAX_JITTER * np.minimum(
        np.append(gaps, gaps[-1:] if len(gaps) else 1.0),
        np.concatenate([gaps[:1] if len(gaps) else [1.0], gaps]),
    )
    typical = float(np.median(gaps)) if len(gaps) else 1.0
    jitter = level * typical * np.random.default_rng(rng).standard_normal(len(times))
    jittered = replace(recording, times=times + np.clip(jitter, -limit, limit))
    fault = Fault("clock-jitter", "", all_frames(recording.n_frames))
    return with_log(jittered, [*injected_faults(recording), fault])


def separate_regions(recording: Recording, *, rng: Randomness = 0, regions: int = 2) -> Recording:
    """Touch one region of the skin after the other, and nothing else meanwhile.

    Parameters
    ----------
    recording : Recording
        With true positions, which define the regions.
    rng : numpy.random.Generator or int
        Not used.
    regions : int
        Number of regions, at least 2: slices of equal numbers of sensors along the direction in
        which the skin is longest. The recording is divided into as many runs.

    Returns
    -------
    Recording
        During each run, the sensors outside its region read their rest value.

    Raises
    ------
    InputError
        If the recording has no positions, or `regions` is out of range.
    """
    if recording.positions is None:
        raise InputError("separating regions needs a recording with true positions of its sensors")
    if not 2 <= regions <= min(recording.n_sensors, recording.n_frames):
        raise InputError(
            "regions must be at least 2 and at most the number of sensors and of frames, got "
            f"{regions}"
        )
    centred = recording.positions - recording.positions.mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    parts = np.array_split(np.argsort(along, kind="stable"), regions)
    edges = np.linspace(0, recording.n_frames, regions + 1).astype(int)
    rest = estimate_rest(recording.complete("interpolate").readings).value
    readings = np.array(recording.readings)
    faults = []
    for region, (start, stop) in enumerate(pairwise(edges.tolist())):
        outside = np.concatenate([part for i, part in enumerate(parts) if i != region])
        readings[start:stop, outside] = rest[outside]
        faults += [
            Fault("separate-regions", recording.names[int(i)], ((start, stop),)) for i in outside
        ]
    return with_faults(recording, readings, faults)


def _check_share(share: float, name: str = "share") -> None:
    if not 0 < share < 1:
        raise InputError(f"{name} must be above 0 and below 1, got {share:g}")


def _single_frames(frames: NDArray[np.intp]) -> Spans:
    return tuple((int(frame), int(frame) + 1) for frame in frames)


def _renumbered(spans: Spans, kept: NDArray[np.intp]) -> Spans:
    """Express spans in the numbering of the remaining frames."""
    moved = (tuple(int(edge) for edge in np.searchsorted(kept, span)) for span in spans)
    return tuple((start, stop) for start, stop in moved if stop > start)
