"""Who is whose neighbour, in the map and in truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

NEIGHBOURS = 6
"""Neighbours that a sensor has on a triangular lattice, the densest there is in the plane."""


def median_spacing(positions: ArrayLike) -> float:
    """Median distance from a sensor to its nearest neighbour, in the units of `positions`."""
    points = np.asarray(positions, dtype=np.float64)
    nearest = np.asarray(KDTree(points).query(points, k=2)[0])
    return float(np.median(nearest[:, 1]))


def neighbour_agreement(
    positions: ArrayLike, truth: ArrayLike, *, neighbours: int = NEIGHBOURS
) -> float:
    """Share of true nearest neighbours that are nearest neighbours in the map, too.

    Parameters
    ----------
    positions, truth : array_like of shape (N, k), (N, l)
        The same sensors in the same order.
    neighbours : int
        How many nearest neighbours a sensor has; at most N - 1 are used.

    Returns
    -------
    float
        In [0, 1]. Chance would give about ``neighbours / (N - 1)``.
    """
    x, y = np.asarray(positions, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    count = min(neighbours, len(x) - 1)
    near = [_nearest(points, count) for points in (x, y)]
    return float(np.mean([len(set(a) & set(b)) for a, b in zip(*near, strict=True)]) / count)


def _nearest(points: NDArray[np.float64], count: int) -> list[list[int]]:
    """List the nearest neighbours of each point: not itself, even if others coincide with it."""
    found = np.asarray(KDTree(points).query(points, k=count + 1)[1])
    return [[j for j in row if j != i][:count] for i, row in enumerate(found.tolist())]
