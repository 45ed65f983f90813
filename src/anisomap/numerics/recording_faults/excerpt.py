"""Excerpts of large recordings, in which faults are searched."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_FRAMES = 4096
"""Consecutive frames of an excerpt; chosen by hand: statistics change little beyond."""

MAX_SENSORS = 256
"""Sensors of an excerpt; chosen by hand: matrices of all pairs then take milliseconds."""


def middle_frames(n_frames: int, most: int = MAX_FRAMES) -> slice:
    """Return consecutive frames from the middle of a recording."""
    start = max(0, (n_frames - most) // 2)
    return slice(start, start + most)


def some_sensors(n_sensors: int, most: int = MAX_SENSORS) -> NDArray[np.intp]:
    """Return evenly spaced indices of sensors."""
    return np.unique(np.linspace(0, n_sensors - 1, min(n_sensors, most)).astype(np.intp))


def standardised(readings: NDArray[Any]) -> NDArray[np.float32]:
    """Scale each sensor to mean 0 and variance 1; constant sensors become 0."""
    values = readings.astype(np.float32)
    values -= values.mean(axis=0)
    deviation = values.std(axis=0)
    values /= np.where(deviation > 0, deviation, 1)
    return values


def deviation_from_median(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median absolute deviation of each column, shape (N,)."""
    return np.asarray(np.median(np.abs(values - np.median(values, axis=0)), axis=0))
