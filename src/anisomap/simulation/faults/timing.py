"""Faults of whole frames and of the clock, which affect all sensors."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording
from anisomap.simulation.checks import INNER_SHARE, at_least
from anisomap.simulation.faults.forms import frame_fault
from anisomap.simulation.faults.log import (
    ALL_SENSORS,
    Fault,
    Spans,
    all_frames,
    injected_faults,
    with_faults,
    with_log,
)

# x the interval to the next frame. Below 0.5, so that adjacent frames stay in order.
_MAX_JITTER = 0.45


@frame_fault(share=INNER_SHARE)
def dropped_frames(
    recording: Recording, rng: np.random.Generator, *, share: float = 0.05
) -> Recording:
    """Remove random frames, like an overloaded logger.

    The frames and their times are removed; the nominal rate is kept. The log marks the frame after
    each gap, but no reading as wrong. Spans of earlier faults are renumbered.

    Parameters
    ----------
    share : float
        Expected share of the frames, between 0 and 1. At least one frame remains.
    """
    lost = rng.random(recording.n_frames) < share
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


@frame_fault(share=INNER_SHARE)
def repeated_frames(
    recording: Recording, rng: np.random.Generator, *, share: float = 0.05
) -> Recording:
    """Replace random frames by the previous frame, like a slow driver.

    Parameters
    ----------
    share : float
        Expected share of the frames, between 0 and 1. The first frame is never replaced.
    """
    stale = rng.random(recording.n_frames) < share
    stale[0] = False
    source = np.maximum.accumulate(np.where(stale, 0, np.arange(recording.n_frames)))
    fault = Fault("repeated-frames", ALL_SENSORS, _single_frames(np.flatnonzero(stale)))
    return with_faults(recording, recording.readings[source], [fault])


@frame_fault(level=INNER_SHARE)
def clock_jitter(
    recording: Recording, rng: np.random.Generator, *, level: float = 0.2
) -> Recording:
    """Add Gaussian jitter to the times of frames.

    The recording must have times, or a rate from which they are computed. The log marks all frames,
    but no reading as wrong.

    Parameters
    ----------
    level : float
        Standard deviation as a share of the median interval, between 0 and 1. Jitter is limited to
        0.45 of the intervals on either side, so that times increase.
    """
    times = recording.times
    if times is None:
        if recording.rate_hz is None:
            raise InputError("clock jitter needs a recording with times or a rate")
        times = np.arange(recording.n_frames) / recording.rate_hz
    gaps = np.diff(times)
    limit = _MAX_JITTER * np.minimum(
        np.append(gaps, gaps[-1:] if len(gaps) else 1.0),
        np.concatenate([gaps[:1] if len(gaps) else [1.0], gaps]),
    )
    typical = float(np.median(gaps)) if len(gaps) else 1.0
    jitter = level * typical * rng.standard_normal(len(times))
    jittered = replace(recording, times=times + np.clip(jitter, -limit, limit))
    fault = Fault("clock-jitter", "", all_frames(recording.n_frames))
    return with_log(jittered, [*injected_faults(recording), fault])


@frame_fault(regions=at_least(2, whole=True))
def separate_regions(
    recording: Recording, rng: np.random.Generator, *, regions: int = 2
) -> Recording:
    """Touch one region of the skin after the other, and nothing else meanwhile.

    The recording must have true positions, which define the regions. During each run, the sensors
    outside its region read their rest value.

    Parameters
    ----------
    regions : int
        Number of regions, at least 2: slices of equal numbers of sensors along the direction in
        which the skin is longest. The recording is divided into as many runs.
    """
    if recording.positions is None:
        raise InputError("separating regions needs a recording with true positions of its sensors")
    if regions > min(recording.n_sensors, recording.n_frames):
        raise InputError(
            f"regions must be at most the number of sensors and of frames, got {regions}"
        )
    centred = recording.positions - recording.positions.mean(axis=0)
    along = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    parts = np.array_split(np.argsort(along, kind="stable"), regions)
    edges = np.linspace(0, recording.n_frames, regions + 1).astype(int)
    rest = estimate_rest(recording.complete("interpolate").readings).value
    readings = np.array(recording.readings)
    faults = []
    for region, span in enumerate(pairwise(edges.tolist())):
        outside = np.concatenate([part for i, part in enumerate(parts) if i != region])
        readings[slice(*span), outside] = rest[outside]
        faults += [Fault("separate-regions", recording.names[i], (span,)) for i in outside.tolist()]
    return with_faults(recording, readings, faults)


def _single_frames(frames: NDArray[np.intp]) -> Spans:
    return tuple((int(frame), int(frame) + 1) for frame in frames)


def _renumbered(spans: Spans, kept: NDArray[np.intp]) -> Spans:
    """Express spans in the numbering of the remaining frames."""
    moved = (tuple(int(edge) for edge in np.searchsorted(kept, span)) for span in spans)
    return tuple((start, stop) for start, stop in moved if stop > start)
