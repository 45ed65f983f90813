"""Nearest neighbours of points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree


def nearest_others(
    points: NDArray[np.float64], count: int, rows: NDArray[np.intp] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Find the nearest neighbours of points, all by default, and their distances, nearest first.

    A point is no neighbour of itself, even if others coincide with it. Returns distances and
    indices, (n, count), or fewer columns.
    """
    rows = np.arange(len(points)) if rows is None else rows
    count = min(count, len(points) - 1)
    if count < 1:
        return np.empty((len(rows), 0)), np.empty((len(rows), 0), dtype=np.intp)
    distances, found = KDTree(points).query(points[rows], k=count + 1)
    itself = found == rows[:, None]
    itself[~itself.any(axis=1), -1] = True  # crowded out by coincident points: drop the last
    shape = (len(rows), count)
    return np.asarray(distances)[~itself].reshape(shape), np.asarray(found)[~itself].reshape(shape)


def nearest_distances(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance of each of at least 2 points to the nearest other one, shape (n,)."""
    return nearest_others(points, 1)[0][:, 0]


def padded(points: NDArray[np.float64], dimensions: int) -> NDArray[np.float64]:
    """Append coordinates of 0 to points of fewer dimensions, shape (n, dimensions)."""
    return np.pad(points, ((0, 0), (0, dimensions - points.shape[1])))
