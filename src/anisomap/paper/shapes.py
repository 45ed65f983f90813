"""Statistics of the shapes of maps."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist, pdist
from scipy.stats import spearmanr

from anisomap.evaluation import align
from anisomap.numerics.neighbours import nearest_distances, nearest_others

_EQUAL = 1e-6  # largest difference of coordinates on one line of a lattice, in metres


def straightness(positions: ArrayLike, truth: ArrayLike) -> float:
    """Measure how straight the straight lines of sensors are on a map: 1 is straight.

    positions (N, k), truth (N, 3). For triples of sensors of which one is midway between the
    others, at least half as far apart as the farthest: the mean ratio of the distance of the outer
    sensors to that through the middle one; 0.71 for a semicircle, NaN without triples.
    """
    points, true = np.asarray(positions, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    first, last = np.triu_indices(len(true), 1)
    off, middle = map(np.asarray, KDTree(true).query((true[first] + true[last]) / 2))
    inside = off < _EQUAL
    lengths = np.linalg.norm(true[first] - true[last], axis=1)
    inside &= lengths >= lengths[inside].max(initial=0) / 2
    a, b, c = (points[index[inside]] for index in (first, middle, last))
    path = np.linalg.norm(b - a, axis=1) + np.linalg.norm(c - b, axis=1)
    return float(np.mean(np.linalg.norm(c - a, axis=1) / path)) if inside.any() else math.nan


class CylinderShape(NamedTuple):
    """Shape and topology of a map of a cylinder with sensors on lines parallel to its axis.

    All are 1 if correct; `SCORE_COLUMNS` describes them. Scales do not depend on the alignment,
    except the axial scale; orders do not depend on the scale along the axis.
    """

    axial_scale: float
    local_axial_scale: float
    order_around: float
    order_along: float


def cylinder_shape(positions: ArrayLike, truth: ArrayLike) -> CylinderShape:
    """Measure what the paper's Figure 4 shows. positions (N, 3), truth (N, 3)."""
    points, true = np.asarray(positions, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    true = true - true.mean(axis=0)
    aligned = align(points, true).aligned
    outwards = true[:, :2] / np.linalg.norm(true[:, :2], axis=1, keepdims=True)
    axial = float(aligned[:, 2] @ true[:, 2] / (true[:, 2] @ true[:, 2]))
    radial = float(np.mean((aligned[:, :2] * outwards).sum(axis=1)))
    radius = float(np.linalg.norm(true[:, :2], axis=1).mean())
    angles = np.arctan2(true[:, 1], true[:, 0]) % (2 * np.pi - _EQUAL)
    labels = np.unique(np.round(angles / _EQUAL), return_inverse=True)[1]
    lines = [np.flatnonzero(labels == label) for label in range(labels.max() + 1)]
    centroids = np.array([points[line].mean(axis=0) for line in lines])
    _, nearest = nearest_others(centroids, 2)
    steps = (nearest - np.arange(len(lines))[:, None]) % len(lines)
    along = [spearmanr(_rounded(points[line]), _rounded(true[line])).statistic for line in lines]
    return CylinderShape(
        axial / (radial / radius),
        _neighbour_ratio(points, true) / _neighbour_ratio(true, true),
        float(np.isin(steps, [1, len(lines) - 1]).mean()),
        float(np.mean(along)),
    )


def _rounded(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute distances in which ties are exact."""
    distances = pdist(points)
    return np.asarray(np.round(distances / distances.max(), 6))


def _neighbour_ratio(points: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Divide the mean distance of axial neighbours by that of circumferential neighbours."""
    axial = _mean_step(points, truth[:, :2], truth[:, 2:])
    return axial / _mean_step(points, truth[:, 2:], truth[:, :2])


def _mean_step(
    points: NDArray[np.float64], same: NDArray[np.float64], other: NDArray[np.float64]
) -> float:
    """Mean distance of points that are equal in `same` and nearest neighbours in `other`."""
    apart = cdist(other, other)
    line = (cdist(same, same) < _EQUAL) & (apart > _EQUAL)
    nearest = line & (apart < np.min(apart, axis=1, where=line, initial=np.inf)[:, None] + _EQUAL)
    return float(np.mean(cdist(points, points)[nearest]))


def isolation(positions: ArrayLike, sensor: int) -> float:
    """Measure how far a sensor lies from all others on a map. positions (n, k)."""
    points = np.asarray(positions, dtype=np.float64)
    nearest = nearest_distances(points)
    return float(nearest[sensor] / np.median(np.delete(nearest, sensor)))
