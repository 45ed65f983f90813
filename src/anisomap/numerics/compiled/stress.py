"""Compiled loops of the raw stress and its gradient."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.parallel import loop

Reals = NDArray[np.floating[Any]]
Singles = NDArray[np.float32]
Range = tuple[int, int]  # first, and last (exclusive)

WIDTH = 512  # columns at a time, which fit into the first-level cache
# Vectorisation requires sums in any order; infinities are still treated correctly.
REORDERED = {"reassoc", "contract", "nsz", "arcp"}


@loop(fastmath=REORDERED, error_model="numpy")
def add_stress(points: Reals, targets: Reals, weights: Reals, rows: Range, slope: Reals) -> float:
    """Return the raw stress of the pairs i < j with i in `rows`; add half its gradient to `slope`.

    points, slope (k, N), weights (N, N), or (1, N) if all rows are equal. Coincident points add
    nothing to the gradient: the smallest normal number keeps its factor finite.
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


@loop(fastmath=REORDERED, error_model="numpy")
def add_spatial_stress(
    points: Reals, targets: Reals, weights: Reals, rows: Range, slope: Reals
) -> float:
    """Return the raw stress as `add_stress` does, for three coordinates, in half the time.

    The first of `rows` must be even, and the last (exclusive) must be even or N. Two rows at a time
    share loads and stores. The second row is also paired with itself, with a target of 0.
    """
    n_points = points.shape[1]
    tiny, one = np.finfo(points.dtype).tiny, points.dtype.type(1)
    total = 0.0
    for i in range(rows[0], rows[1] - 1, 2):
        x1, y1, z1 = points[0, i], points[1, i], points[2, i]
        x2, y2, z2 = points[0, i + 1], points[1, i + 1], points[2, i + 1]
        for start in range(i + 1, n_points, WIDTH):
            stop = min(start + WIDTH, n_points)
            x, y, z = points[0, start:stop], points[1, start:stop], points[2, start:stop]
            slope_x, slope_y = slope[0, start:stop], slope[1, start:stop]
            slope_z = slope[2, start:stop]
            target1, target2 = targets[i, start:stop], targets[i + 1, start:stop]
            weighted = i if len(weights) > 1 else 0
            weight1 = weights[weighted, start:stop]
            weight2 = weights[min(weighted + 1, len(weights) - 1), start:stop]
            partial = points.dtype.type(0)
            pull_x1 = pull_y1 = pull_z1 = points.dtype.type(0)
            pull_x2 = pull_y2 = pull_z2 = points.dtype.type(0)
            for j in range(stop - start):
                dx1, dy1, dz1 = x1 - x[j], y1 - y[j], z1 - z[j]
                dx2, dy2, dz2 = x2 - x[j], y2 - y[j], z2 - z[j]
                square1 = dx1 * dx1 + dy1 * dy1 + dz1 * dz1 + tiny
                square2 = dx2 * dx2 + dy2 * dy2 + dz2 * dz2 + tiny
                inverse1, inverse2 = one / np.sqrt(square1), one / np.sqrt(square2)
                excess1 = square1 * inverse1 - target1[j]
                excess2 = square2 * inverse2 - target2[j]
                share1, share2 = weight1[j] * excess1, weight2[j] * excess2
                partial += share1 * excess1 + share2 * excess2
                share1 *= inverse1
                share2 *= inverse2
                pull_x1 += share1 * dx1
                pull_y1 += share1 * dy1
                pull_z1 += share1 * dz1
                pull_x2 += share2 * dx2
                pull_y2 += share2 * dy2
                pull_z2 += share2 * dz2
                slope_x[j] -= share1 * dx1 + share2 * dx2
                slope_y[j] -= share1 * dy1 + share2 * dy2
                slope_z[j] -= share1 * dz1 + share2 * dz2
            total += float(partial)
            slope[0, i] += pull_x1
            slope[1, i] += pull_y1
            slope[2, i] += pull_z1
            slope[0, i + 1] += pull_x2
            slope[1, i + 1] += pull_y2
            slope[2, i + 1] += pull_z2
    return total
