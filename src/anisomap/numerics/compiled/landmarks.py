"""Compiled loops of approximate maps: products of pairs, paths from landmarks, and stress."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.jit import loop
from anisomap.numerics.compiled.stress import REORDERED

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int64]
Range = tuple[int, int]  # half-open


@loop(fastmath=REORDERED)
def add_products(
    series: Singles, still: NDArray[np.bool_], pairs: tuple[Ints, Ints], totals: Floats, part: Range
) -> None:
    """Add to `totals` the inner products of pairs of rows of `series`.

    Rows marked by `still` are constant, as are most sensors within a chunk; they are not multiplied
    frame by frame.
    """
    firsts, seconds = pairs
    n_frames = series.shape[1]
    for pair in range(part[0], part[1]):
        i, j = firsts[pair], seconds[pair]
        if still[i] and still[j]:
            totals[pair] += n_frames * np.float64(series[i, 0]) * series[j, 0]
            continue
        if still[i]:
            i, j = j, i
        left, right = series[i], series[j]
        total = np.float32(0)
        if still[j]:
            for t in range(n_frames):
                total += left[t]
            total *= right[0]
        else:
            for t in range(n_frames):
                total += left[t] * right[t]
        totals[pair] += total


@loop()
def relax_from(
    tile: Singles, sources: Ints, order: Ints, edges: tuple[Ints, Ints, Singles]
) -> None:
    """Fill ``tile[u, s]`` with the length of the shortest path from ``sources[s]`` to node u.

    Bellman-Ford from several sources: sweeps over the nodes in alternating `order` until no path
    becomes shorter. ``stamps[u]`` contains the times of the last improvement and of the last visit
    of node u: neighbours that have not improved since the visit are skipped.
    """
    offsets, ends, lengths = edges
    tile[:] = np.inf
    stamps = np.zeros((len(tile), 2), np.int64)
    for column in range(len(sources)):
        tile[sources[column], column] = 0
        stamps[sources[column], 0] = 1
    clock, step, any_shorter = 1, 1, True
    while any_shorter:
        any_shorter = False
        for node in order[::step]:
            clock += 1
            row = tile[node]
            shorter = 0
            for edge in range(offsets[node], offsets[node + 1]):
                if stamps[ends[edge], 0] > stamps[node, 1]:
                    other, length = tile[ends[edge]], lengths[edge]
                    for source in range(len(row)):
                        through = other[source] + length
                        shorter |= through < row[source]
                        row[source] = min(row[source], through)
            stamps[node, 1] = clock
            if shorter:
                stamps[node, 0] = clock
                any_shorter = True
        step = -step


@loop(fastmath=REORDERED, error_model="numpy")
def add_rows_stress(
    points: Singles, anchors: Singles, targets: Singles, rows: Range, slopes: tuple[Floats, Floats]
) -> float:
    """Sum the raw stress of points i in `rows` with all anchors.

    `points` is (k, N), `anchors` (k, L), one row per coordinate; `targets` is (N, L). Half the
    gradient is added to `slopes`, by the points (k, N) and by the anchors (k, L). The gradient of
    coincident points is 0: their difference is 0, and the tiny constant keeps its factor finite.
    """
    slope, pulled = slopes
    dimensions, n_anchors = anchors.shape
    factors = np.empty(n_anchors, np.float32)
    pulls = np.zeros((dimensions, n_anchors), np.float32)
    one, tiny = np.float32(1), np.float32(1e-30)
    total = 0.0
    for i in range(rows[0], rows[1]):
        target = targets[i]
        factors[:] = tiny
        for axis in range(dimensions):
            mine, theirs = points[axis, i], anchors[axis]
            for j in range(n_anchors):
                factors[j] += (mine - theirs[j]) * (mine - theirs[j])
        partial = np.float32(0)
        for j in range(n_anchors):
            inverse = one / np.sqrt(factors[j])
            excess = factors[j] * inverse - target[j]
            partial += excess * excess
            factors[j] = excess * inverse
        total += float(partial)
        for axis in range(dimensions):
            mine, theirs, back = points[axis, i], anchors[axis], pulls[axis]
            pull = np.float32(0)
            for j in range(n_anchors):
                share = factors[j] * (mine - theirs[j])
                pull += share
                back[j] -= share
            slope[axis, i] += pull
        if i % 256 == 255 or i == rows[1] - 1:  # bounds the rounding error of float32 sums
            pulled += pulls
            pulls[:] = 0
    return total


@loop()
def add_edges_stress(
    points: Floats, edges: tuple[Ints, Ints, Singles], weight: float, slope: Floats, rows: Range
) -> float:
    """Sum the weighted raw stress of the edges of some nodes, each edge from both ends.

    `points` and `slope` are (k, N). Half the gradient is added to `slope`. Each edge occurs
    twice in the sum over all nodes, with half its weight.
    """
    offsets, ends, lengths = edges
    dimensions = len(points)
    total = 0.0
    for i in range(rows[0], rows[1]):
        for edge in range(offsets[i], offsets[i + 1]):
            j = ends[edge]
            square = 0.0
            for axis in range(dimensions):
                square += (points[axis, i] - points[axis, j]) ** 2
            distance = np.sqrt(square)
            excess = distance - lengths[edge]
            total += weight * excess * excess / 2
            if distance > 1e-150:
                for axis in range(dimensions):
                    away = points[axis, i] - points[axis, j]
                    slope[axis, i] += weight * excess / distance * away
    return total
