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
        while entry < end and sensors[entry] < last:
            row, value = panel[sensors[entry] - first], values[entry]
            for other in range(entry, end):
                row[sensors[other]] += value * values[other]
            entry += 1
