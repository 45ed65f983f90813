"""Compiled loop of the raw stress and its gradient."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.jit import loop

Reals = NDArray[np.floating[Any]]
Range = tuple[int, int]  # from the first to before the last

WIDTH = 512  # columns at a time, which fit into the first-level cache
# Allows sums in any order, for vectorisation; infinities keep their meaning.
REORDERED = {"reassoc", "contract", "nsz", "arcp"}


@loop(fastmath=REORDERED, error_model="numpy")
def add_stress(points: Reals, targets: Reals, weights: Reals, rows: Range, slope: Reals) -> float:
    """Return the raw stress of the pairs i < j with i in `rows`.

    Half its gradient is added to `slope`.

    `points` and `slope` have shape (k, N), one row per coordinate; `weights` has shape (N, N), or
    (1, N) if all rows are equal. Coincident points add nothing to the gradient: their difference
    is 0, and the smallest normal number keeps its factor finite.
    """
    dimensions, n_points = points.shape
    tiny, one = np.finfo(points.dtype).tiny, points.dtype.type(1)
    buffer = np.empty(WIDTH, points.dtype)
    total = 0.0
    for i in range(rows[0], rows[1]):
        weighted = i if len(weights) > 1 else 0
        for start in range(i + 1, n_points, WIDTH):
            stop = min(start + WIDTH, n_points)
            size = stop - start
            factors = buffer[:size]
            factors[:] = tiny
            for axis in range(dimensions):
                mine, theirs = points[axis, i], points[axis, start:stop]
                for j in range(size):
                    difference = mine - theirs[j]
                    factors[j] += difference * difference
            target, weight = targets[i, start:stop], weights[weighted, start:stop]
            partial = points.dtype.type(0)
            for j in range(size):
                inverse = one / np.sqrt(factors[j])
                excess = factors[j] * inverse - target[j]
                weighted_excess = weight[j] * excess
                partial += weighted_excess * excess
                factors[j] = weighted_excess * inverse
            total += float(partial)
            for axis in range(dimensions):
                mine, theirs = points[axis, i], points[axis, start:stop]
                pulled = slope[axis, start:stop]
                pull = points.dtype.type(0)
                for j in range(size):
                    share = factors[j] * (mine - theirs[j])
                    pull += share
                    pulled[j] -= share
                slope[axis, i] += pull
    return total
