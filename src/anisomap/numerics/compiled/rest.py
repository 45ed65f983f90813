"""Compiled loops over readings at rest and in contact."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.jit import loop

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@loop()
def count_lowest(readings: NDArray[Any], lowest: NDArray[Any], counts: Ints) -> None:
    """Find the lowest reading of each sensor and the number of frames at it.

    `readings` has shape (T, N); `lowest` must contain the first frame and `counts` zeros.
    """
    for frame in range(len(readings)):
        row = readings[frame]
        for sensor in range(len(row)):
            reading, least = row[sensor], lowest[sensor]
            before = 0 if reading < least else counts[sensor]
            counts[sensor] = before + (1 if reading <= least else 0)
            lowest[sensor] = min(reading, least)


@loop()
def find_active(
    readings: NDArray[Any], rest: tuple[Floats, Floats, Floats], active: NDArray[np.bool_]
) -> None:
    """Set `active`, shape (T, N), where readings exceed the threshold of their sensor.

    `rest` consists of values, sides and thresholds, each of shape (N,).
    """
    value, side, threshold = rest
    for frame in range(len(readings)):
        row, found = readings[frame], active[frame]
        for sensor in range(len(row)):
            beyond = side[sensor] * (np.float64(row[sensor]) - value[sensor])
            found[sensor] = beyond - threshold[sensor] > 0
