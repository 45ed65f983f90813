"""Nearest neighbours on the map and in the truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

NEIGHBOURS = 6
"""Number of neighbours of a sensor on a triangular lattice, the densest packing in the plane."""


def median_spacing(positions: ArrayLike) -> float:
    """Median distance from a sensor to its nearest neighbour, in the units of `positions`."""
    points = np.asarray(positions, dtype=np.float64)
    nearest = np.asarray(KDTree(points).query(points, k=2)[0])
    return float(np.median(nearest[:, 1]))


def neighbour_agreement(
    positions: ArrayLike, truth: ArrayLike, *, n_neighbours: int = NEIGHBOURS
) -> float:
    """Share of true nearest neighbours that are also nearest neighbours on the map.

    Parameters
    ----------
    positions, truth : array_like of shape (N, k), (N, l)
        The same sensors in the same order.
    n_neighbours : int
        Number of nearest neighbours; at most N - 1 are used.

    Returns
    -------
    float
        In [0, 1]; about ``n_neighbours / (N - 1)`` by chance.
    """
    x, y = np.asarray(positions, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    count = min(n_neighbours, len(x) - 1)
    near = [_nearest(points, count) for points in (x, y)]
    return float(np.mean([len(set(a) & set(b)) for a, b in zip(*near, strict=True)]) / count)


def _nearest(points: NDArray[np.float64], count: int) -> list[list[int]]:
    """List the nearest neighbours of each point, itself excluded even if points coincide."""
    found = np.asarray(KDTree(points).query(points, k=count + 1)[1])
    return [[j for j in row if j != i][:count] for i, row in enumerate(found.tolist())]
