"""Glitches: single readings far beyond all others of the recording."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_FAR = (
    10.0  # times the reach of the typical sensor, and of the other readings of its sensor; by hand
)
_MAX_SHARE = 0.01  # of the readings of a sensor: more are saturation, or contact


def find_glitches(readings: NDArray[Any]) -> NDArray[np.bool_] | None:
    """Find readings far beyond all others. readings (T, N) -> (T, N), or None without any."""
    n_frames = len(readings)
    count = max(1, int(_MAX_SHARE * n_frames))
    if n_frames <= 4 * count:
        return None
    deviation = np.abs(readings.astype(np.float64) - np.median(readings, axis=0))
    largest = np.partition(deviation, n_frames - 1 - count, axis=0)
    own, reach = largest[n_frames - 1 - count], deviation.max(axis=0)
    typical = float(np.median(reach[reach > 0])) if (reach > 0).any() else 0.0
    found = deviation > _FAR * np.maximum(own, typical)
    return found if typical > 0 and found.any() else None


def remove_glitches(readings: NDArray[Any], glitches: NDArray[np.bool_]) -> NDArray[Any]:
    """Replace glitches by a line between the readings beside them. readings (T, N) -> (T, N)."""
    mended, frames = np.array(readings), np.arange(len(readings))
    for i in np.flatnonzero(glitches.any(axis=0)).tolist():
        wrong = glitches[:, i]
        mended[wrong, i] = np.interp(frames[wrong], frames[~wrong], readings[~wrong, i])
    return mended
