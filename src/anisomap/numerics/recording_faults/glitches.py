"""Glitches: single readings far beyond all others of the recording."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.signals import medians

_FAR = (
    10.0  # times the reach of the typical sensor, and of the other readings of its sensor; by hand
)
_SAMPLE = 1024  # frames of which the median is taken
_MAX_SHARE = 0.01  # of the readings of a sensor: more are saturation, or contact


def find_glitches(readings: NDArray[Any]) -> NDArray[np.bool_] | None:
    """Find readings far beyond all others. readings (T, N) -> (T, N), or None without any."""
    n_frames = len(readings)
    count = max(1, int(_MAX_SHARE * n_frames))
    if n_frames <= 4 * count:
        return None
    middle = medians(readings[:: -(-n_frames // _SAMPLE)]).astype(np.float64)
    reach = np.maximum(readings.max(axis=0) - middle, middle - readings.min(axis=0))
    typical = float(np.median(reach[reach > 0])) if (reach > 0).any() else 0.0
    far = np.flatnonzero(reach > _FAR * typical)
    if typical == 0 or not far.size:
        return None
    deviation = np.abs(readings[:, far] - middle[far])
    own = np.partition(deviation, n_frames - 1 - count, axis=0)[n_frames - 1 - count]
    found = np.zeros(readings.shape, dtype=bool)
    found[:, far] = deviation > _FAR * np.maximum(own, typical)
    return found if found.any() else None


def remove_glitches(readings: NDArray[Any], glitches: NDArray[np.bool_]) -> NDArray[Any]:
    """Replace glitches by a line between the readings beside them. readings (T, N) -> (T, N)."""
    mended, frames = np.array(readings), np.arange(len(readings))
    for i in np.flatnonzero(glitches.any(axis=0)).tolist():
        wrong = glitches[:, i]
        mended[wrong, i] = np.interp(frames[wrong], frames[~wrong], readings[~wrong, i])
    return mended
