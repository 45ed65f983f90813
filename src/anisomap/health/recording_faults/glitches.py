"""Glitches: single readings far beyond all others of the recording."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.health.recording_faults.found import Found, in_readings
from anisomap.numerics.signals import medians
from anisomap.recording import Recording

# Times the reach of the typical sensor, and of the other readings of its sensor; chosen by hand.
_FAR = 10.0
_SAMPLE = 1024  # frames of which the median is taken
_MAX_SHARE = 0.01  # of the readings of a sensor: more are saturation, or contact


def find_glitches(recording: Recording) -> Iterator[Found]:
    """Find readings far beyond all others."""
    readings, n_frames = recording.readings, recording.n_frames
    count = max(1, int(_MAX_SHARE * n_frames))
    if n_frames <= 4 * count:
        return
    middle = medians(readings[:: -(-n_frames // _SAMPLE)]).astype(np.float64)
    lowest, highest = recording.extremes
    reach = np.maximum(highest - middle, middle - lowest)
    typical = float(np.median(reach[reach > 0])) if (reach > 0).any() else np.inf
    far = np.flatnonzero(reach > _FAR * typical)
    deviation = np.abs(readings[:, far] - middle[far])
    own = np.partition(deviation, n_frames - 1 - count, axis=0)[n_frames - 1 - count]
    wrong = deviation > _FAR * np.maximum(own, typical)
    affected, number = far[wrong.any(axis=0)], np.count_nonzero(wrong)
    if number:
        yield Found(
            affected,
            float(number),
            f"{number} readings of {affected.size} sensors are far beyond all others",
            in_readings(lambda readings: _interpolated(readings, far, wrong)),
        )


def _interpolated(
    readings: NDArray[Any], sensors: NDArray[np.intp], wrong: NDArray[np.bool_]
) -> NDArray[Any]:
    """Replace readings of some sensors, (T, n), by a line between the readings beside them."""
    mended, frames = np.array(readings), np.arange(len(readings))
    for i, bad in zip(sensors.tolist(), wrong.T, strict=True):
        mended[bad, i] = np.interp(frames[bad], frames[~bad], readings[~bad, i])
    return mended
