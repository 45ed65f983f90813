"""Statistics of the shape of maps, for the paper's statements about shapes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from anisomap.evaluation import align

_EQUAL = 1e-6  # largest difference of coordinates on one line of a lattice, in metres


def spread_of_radii(positions: ArrayLike) -> float:
    """Compute the relative spread of the distances from the centroid.

    Parameters
    ----------
    positions : array_like of shape (N, k)

    Returns
    -------
    float
        Standard deviation divided by mean: 0 for a sphere (in 2D, a circle), about 0.35 for a
        filled square.
    """
    points = np.asarray(positions, dtype=np.float64)
    radii = np.linalg.norm(points - points.mean(axis=0), axis=1)
    return float(radii.std() / radii.mean())


@dataclass(frozen=True)
class AxialScale:
    """Axial compression of a map of a cylinder: 1 is correct, less is compressed.

    Attributes
    ----------
    whole : float
        Axial scale divided by radial scale, after alignment with the true positions.
    local : float
        Distance of axial neighbours divided by distance of circumferential neighbours, relative to
        the same ratio of the true positions; independent of the alignment.
    """

    whole: float
    local: float


def axial_scale(positions: ArrayLike, truth: ArrayLike) -> AxialScale:
    """Measure the axial compression shown in the paper's Figure 4.

    Parameters
    ----------
    positions : array_like of shape (N, 3)
        A map of a cylinder in any coordinate frame.
    truth : array_like of shape (N, 3)
        True positions: columns on a cylinder about the z axis.

    Returns
    -------
    AxialScale
    """
    true = np.asarray(truth, dtype=np.float64)
    true = true - true.mean(axis=0)
    aligned = align(positions, true).aligned
    outwards = true[:, :2] / np.linalg.norm(true[:, :2], axis=1, keepdims=True)
    axial = float(aligned[:, 2] @ true[:, 2] / (true[:, 2] @ true[:, 2]))
    radial = float(np.mean((aligned[:, :2] * outwards).sum(axis=1)))
    radius = float(np.linalg.norm(true[:, :2], axis=1).mean())
    points = np.asarray(positions, dtype=np.float64)
    local = _neighbour_ratio(points, true) / _neighbour_ratio(true, true)
    return AxialScale(axial / (radial / radius), local)


def _neighbour_ratio(points: NDArray[np.float64], truth: NDArray[np.float64]) -> float:
    """Divide the mean distance of axial neighbours by that of circumferential neighbours."""
    axial = _mean_step(points, truth[:, :2], truth[:, 2:])
    return axial / _mean_step(points, truth[:, 2:], truth[:, :2])


def _mean_step(
    points: NDArray[np.float64], same: NDArray[np.float64], other: NDArray[np.float64]
) -> float:
    """Mean distance of points that are equal in `same` and nearest neighbours in `other`."""
    steps = []
    for i in range(len(points)):
        line = np.flatnonzero(np.linalg.norm(same - same[i], axis=1) < _EQUAL)
        distances = np.linalg.norm(other[line] - other[i], axis=1)
        line, distances = line[distances > _EQUAL], distances[distances > _EQUAL]
        nearest = line[distances < distances.min() + _EQUAL]
        steps += np.linalg.norm(points[nearest] - points[i], axis=1).tolist()
    return float(np.mean(steps))


def isolation(positions: ArrayLike, sensor: int) -> float:
    """Measure how far a sensor lies from all others on a map.

    Parameters
    ----------
    positions : array_like of shape (n, k)
    sensor : int
        Its row.

    Returns
    -------
    float
        Distance to its nearest neighbour, divided by the median of that distance over all other
        sensors: about 1 for a sensor among others.
    """
    points = np.asarray(positions, dtype=np.float64)
    nearest = np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]
    return float(nearest[sensor] / np.median(np.delete(nearest, sensor)))


def spectrum(metric: ArrayLike) -> NDArray[np.float64]:
    """Compute the variances of classical scaling.

    Parameters
    ----------
    metric : array_like of shape (N, N)
        Finite distances.

    Returns
    -------
    ndarray of shape (N,)
        Eigenvalues of the doubly centred squared distances in descending order; negative ones if
        the metric is not Euclidean.
    """
    squares = np.asarray(metric, dtype=np.float64) ** 2
    rows = squares.mean(axis=0)
    inner = -(squares - np.add.outer(rows, rows) + rows.mean()) / 2
    return np.linalg.eigvalsh(inner)[::-1]


def n_dimensions(variances: ArrayLike) -> int:
    """Choose the number of dimensions by the largest drop in variance.

    Parameters
    ----------
    variances : array_like
        From `spectrum`, in descending order.

    Returns
    -------
    int
        The m, counted from 1, that maximises ``variance[m] - variance[m + 1]``.

    References
    ----------
    Pierce & Kuipers (1997), "Map learning with uninterpreted sensors and effectors", Artificial
    Intelligence 92: 169-227, doi:10.1016/S0004-3702(96)00051-3.
    """
    return int(np.argmax(-np.diff(np.asarray(variances, dtype=np.float64)))) + 1
