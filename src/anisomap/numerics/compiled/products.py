"""Compiled loop of products of sparse readings."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.jit import loop

Reals = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]


@loop()
def add_products(panel: Reals, first: int, sensors: Ints, values: Reals, begins: Ints) -> None:
    """Add products of values in the same frame to ``panel[i - first, j]`` for all j >= i.

    Values of frame f, by increasing sensor, are those from ``begins[f]`` to ``begins[f + 1]``.
    Four rows are filled at a time, so that the other sensors and their values are loaded once for
    all; of these rows, some elements with j < i are changed, too.
    """
    last = first + len(panel)
    for frame in range(len(begins) - 1):
        entry, end = begins[frame], begins[frame + 1]
        beyond = end
        while entry < beyond:  # bisection for the first sensor of the panel
            middle = (entry + beyond) // 2
            if sensors[middle] < first:
                entry = middle + 1
            else:
                beyond = middle
        while entry + 3 < end and sensors[entry + 3] < last:
            row, value = panel[sensors[entry] - first], values[entry]
            row1, value1 = panel[sensors[entry + 1] - first], values[entry + 1]
            row2, value2 = panel[sensors[entry + 2] - first], values[entry + 2]
            row3, value3 = panel[sensors[entry + 3] - first], values[entry + 3]
            for other in range(entry, end):
                sensor, factor = sensors[other], values[other]
                row[sensor] += value * factor
                row1[sensor] += value1 * factor
                row2[sensor] += value2 * factor
                row3[sensor] += value3 * factor
            entry += 4
        while entry < end and sensors[entry] < last:
            row, value = panel[sensors[entry] - first], values[entry]
            for other in range(entry, end):
                row[sensors[other]] += value * values[other]
            entry += 1
