"""Statistics of the shapes of maps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.spatial.distance import cdist, pdist
from scipy.stats import spearmanr

from anisomap.evaluation import align
from anisomap.numerics.neighbours import nearest_distances, nearest_others

_EQUAL = 1e-6  # largest difference of coordinates on one line of a lattice, in metres


def sphericity(positions: ArrayLike) -> float:
    """Measure how much nearer sensors are to the best sphere than to the best plane.

    positions (N, 3). RMS distance from the least-squares plane minus RMS distance from the
    least-squares sphere, relative to the RMS distance from the centroid, and scaled to 1 for a
    whole sphere. It is 0 for a plane, which is a sphere of infinite radius.
    """
    points = np.asarray(positions, dtype=np.float64)
    points = points - points.mean(axis=0)
    points /= np.sqrt(np.mean(np.sum(points**2, axis=1)))
    from_plane = np.linalg.svd(points, compute_uv=False)[-1] / np.sqrt(len(points))
    # |x|^2 = 2 c.x + k is linear in the centre c and k; the solution is the start of the search.
    design = np.column_stack([2 * points, np.ones(len(points))])
    centre = np.linalg.lstsq(design, np.sum(points**2, axis=1), rcond=None)[0][:3]

    def residuals(c: NDArray[np.float64]) -> NDArray[np.float64]:
        distances = np.linalg.norm(points - c, axis=1)
        return np.asarray(distances - distances.mean())

    from_sphere = np.sqrt(np.mean(least_squares(residuals, centre).fun ** 2))
    return float(np.sqrt(3) * (from_plane - min(from_plane, from_sphere)))


class CylinderShape(NamedTuple):
    """Shape and topology of a map of a cylinder with sensors on lines parallel to its axis.

    All values are 1 if the map is correct; see `SCORE_COLUMNS`. Scales except the axial scale do
    not depend on the alignment; orders do not depend on the scale along the axis.
    """

    axial_scale: float
    local_axial_scale: float
    order_around: float
    order_along: float


def cylinder_shape(positions: ArrayLike, truth: ArrayLike) -> CylinderShape:
    """Measure the properties shown in the paper's Figure 4. positions (N, 3), truth (N, 3)."""
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
    along = [_order(points[line], true[line]) for line in lines]
    return CylinderShape(
        axial / (radial / radius),
        _neighbour_ratio(points, true) / _neighbour_ratio(true, true),
        float(np.isin(steps, [1, len(lines) - 1]).mean()),
        float(np.mean(along)),
    )


def _order(points: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Correlate the ranks of distances; ties must be exact; 0 if all points coincide."""
    found = [pdist(each) for each in (points, truth)]
    if not found[0].any():
        return 0.0
    return float(spearmanr(*(np.round(each / each.max(), 6) for each in found)).statistic)


def _neighbour_ratio(points: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Return the ratio of mean distances of axial and of circumferential neighbours."""
    axial = _mean_step(points, truth[:, :2], truth[:, 2:])
    return axial / _mean_step(points, truth[:, 2:], truth[:, :2])


def _mean_step(
    points: NDArray[np.float64], same: NDArray[np.float64], other: NDArray[np.float64]
) -> float:
    """Return the mean distance of points with equal `same` that are neighbours in `other`."""
    apart = cdist(other, other)
    line = (cdist(same, same) < _EQUAL) & (apart > _EQUAL)
    nearest = line & (apart < np.min(apart, axis=1, where=line, initial=np.inf)[:, None] + _EQUAL)
    return float(np.mean(cdist(points, points)[nearest]))


def isolation(positions: ArrayLike, sensor: int) -> float:
    """Measure the distance of a sensor from all others on a map. positions (n, k)."""
    points = np.asarray(positions, dtype=np.float64)
    nearest = nearest_distances(points)
    return float(nearest[sensor] / np.median(np.delete(nearest, sensor)))
