"""What the paper says of the shape of maps, as numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from anisomap.evaluation import align

_TOUCHING = 1e-6


def spread_of_radii(positions: ArrayLike) -> float:
    """Tell how far a configuration is from a sphere around its centroid.

    Parameters
    ----------
    positions : array_like of shape (N, k)

    Returns
    -------
    float
        Standard deviation over mean of the distances from the centroid: 0 for a sphere (in the
        plane, a circle), about 0.35 for a square filled evenly.
    """
    points = np.asarray(positions, dtype=np.float64)
    radii = np.linalg.norm(points - points.mean(axis=0), axis=1)
    return float(radii.std() / radii.mean())


@dataclass(frozen=True)
class AxialScale:
    """How much a map of a cylinder is compressed along its axis.

    Attributes
    ----------
    whole : float
        Scale along the axis over scale away from it, of the map laid onto the truth; 1 if the
        proportions are right, less if the cylinder is too short for its width.
    local : float
        Distance of neighbours along the axis over that of neighbours around it, on the map, over
        the same in truth. It needs no alignment.
    """

    whole: float
    local: float


def axial_scale(positions: ArrayLike, truth: ArrayLike) -> AxialScale:
    """Measure the axial compression of the paper's Figure 4.

    Parameters
    ----------
    positions : array_like of shape (N, 3)
        A map of a cylinder in any frame.
    truth : array_like of shape (N, 3)
        True positions: in columns on a cylinder about the z axis.

    Returns
    -------
    AxialScale
        In either number, 1 is right and less is compressed along the axis.
    """
    true = np.asarray(truth, dtype=np.float64)
    true = true - true.mean(axis=0)
    aligned = align(positions, true).aligned
    outwards = true[:, :2] / np.linalg.norm(true[:, :2], axis=1, keepdims=True)
    along = float(aligned[:, 2] @ true[:, 2] / (true[:, 2] @ true[:, 2]))
    radial = float(np.mean((aligned[:, :2] * outwards).sum(axis=1)))
    radius = float(np.linalg.norm(true[:, :2], axis=1).mean())
    found = np.asarray(positions, dtype=np.float64)
    local = _neighbour_ratio(found, true) / _neighbour_ratio(true, true)
    return AxialScale(along / (radial / radius), local)


def _neighbour_ratio(points: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Mean distance of true neighbours along the axis, over that of those around it."""
    return _mean_step(points, truth[:, :2], truth[:, 2:]) / _mean_step(
        points, truth[:, 2:], truth[:, :2]
    )


def _mean_step(
    points: NDArray[np.float64], same: NDArray[np.float64], other: NDArray[np.float64]
) -> float:
    """Mean distance of each point to the nearest in `other` among those with equal `same`."""
    steps = []
    for i in range(len(points)):
        line = np.flatnonzero(np.linalg.norm(same - same[i], axis=1) < _TOUCHING)
        apart = np.linalg.norm(other[line] - other[i], axis=1)
        line, apart = line[apart > _TOUCHING], apart[apart > _TOUCHING]
        nearest = line[apart < apart.min() + _TOUCHING]
        steps += np.linalg.norm(points[nearest] - points[i], axis=1).tolist()
    return float(np.mean(steps))


def isolation(positions: ArrayLike, sensor: int) -> float:
    """Tell how far a sensor lies from all others on a map.

    Parameters
    ----------
    positions : array_like of shape (n, k)
    sensor : int
        Its row.

    Returns
    -------
    float
        Distance to its nearest neighbour, over the median of that distance of all others: about 1
        for a sensor among others.
    """
    points = np.asarray(positions, dtype=np.float64)
    nearest = np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]
    return float(nearest[sensor] / np.median(np.delete(nearest, sensor)))


def spectrum(metric: ArrayLike) -> NDArray[np.float64]:
    """Give the variances of classical scaling, the largest first.

    Parameters
    ----------
    metric : array_like of shape (N, N)
        Finite distances.

    Returns
    -------
    ndarray of shape (N,)
        Eigenvalues of the doubly centred squared distances; negative ones where no space holds
        them.
    """
    squares = np.asarray(metric, dtype=np.float64) ** 2
    rows = squares.mean(axis=0)
    inner = -(squares - np.add.outer(rows, rows) + rows.mean()) / 2
    return np.linalg.eigvalsh(inner)[::-1]


def chosen_dimension(variances: ArrayLike) -> int:
    """Choose how many dimensions to scale into: before the greatest drop of variance.

    Parameters
    ----------
    variances : array_like
        From `spectrum`, largest first.

    Returns
    -------
    int
        The m that makes ``variance[m] - variance[m + 1]`` greatest, counted from 1.

    Notes
    -----
    Pierce & Kuipers (1997), "Map learning with uninterpreted sensors and effectors", Artificial
    Intelligence 92: 169-227, doi:10.1016/S0004-3702(96)00051-3.
    """
    return int(np.argmax(-np.diff(np.asarray(variances, dtype=np.float64)))) + 1
