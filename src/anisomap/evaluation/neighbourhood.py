"""Nearest neighbours on the map and in the truth."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from anisomap.errors import InputError

NEIGHBOURS = 6
"""Number of neighbours of a sensor on a triangular lattice, the densest packing in the plane."""

TIE = 1e-3
"""Relative difference below which two distances are equal.

Files store positions as float32 or with four to six digits, so that equal distances of a lattice
differ by up to about 1e-4; the errors of maps are far larger.
"""

_SHELLS = 16  # neighbours that are looked for around a tie, per neighbour asked for


def median_spacing(positions: ArrayLike) -> float:
    """Median distance from a sensor to its nearest neighbour, in the units of `positions`."""
    return float(np.median(_nearest_distances(positions)))


def spacing_variation(positions: ArrayLike) -> float:
    """Variation of the distances from sensors to their nearest neighbours.

    Parameters
    ----------
    positions : array_like of shape (N, k)

    Returns
    -------
    float
        Standard deviation divided by the mean: 0 if all sensors are equally far from their nearest
        neighbour, about .5 if sensors lie at random on a surface. 0 if all coincide.
    """
    nearest = _nearest_distances(positions)
    mean = float(nearest.mean())
    return float(nearest.std()) / mean if mean > 0 else 0.0


def _nearest_distances(positions: ArrayLike) -> NDArray[np.float64]:
    """Return the distance from each sensor to its nearest neighbour."""
    points = np.asarray(positions, dtype=np.float64)
    return np.asarray(KDTree(points).query(points, k=2)[0])[:, 1]


def check_distances(positions: NDArray[np.float64], what: str) -> None:
    """Check that positions differ, and that the squares of their distances are finite.

    Parameters
    ----------
    positions : ndarray of shape (N, k)
        Sensors without a position are ignored.
    what : str
        The positions, for messages.

    Raises
    ------
    InputError
        If all positions are the same, or so far apart that distances cannot be computed.
    """
    placed = positions[np.isfinite(positions).all(axis=1)]
    with np.errstate(over="ignore", under="ignore"):
        square = float(((placed.max(axis=0) - placed.min(axis=0)) ** 2).sum()) if len(placed) else 0
    if square == 0:
        raise InputError(f"all sensors of {what} have the same position; there is no distance")
    if not np.isfinite(square):
        raise InputError(
            f"the distances of {what} are out of the range of floating-point numbers; "
            "check its units"
        )


def neighbour_agreement(
    positions: ArrayLike, truth: ArrayLike, *, n_neighbours: int = NEIGHBOURS
) -> float:
    """Share of the nearest neighbours on the map that are nearest neighbours in the truth.

    Parameters
    ----------
    positions, truth : array_like of shape (N, k), (N, l)
        The same sensors in the same order.
    n_neighbours : int
        Number of nearest neighbours; at most N - 1 are used.

    Returns
    -------
    float
        In [0, 1]; about ``n_neighbours / (N - 1)`` by chance, and more by the share of ties.

    Notes
    -----
    Distances that differ by less than 0.1 % are ties. In the truth, all sensors tied with the last
    neighbour count as neighbours. On the map, the sensors tied with the last neighbour share the
    remaining places equally, so that a map on which sensors coincide gains nothing. Ties are
    looked for among the ``16 * n_neighbours`` nearest sensors.
    """
    x, y = np.asarray(positions, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    count = min(n_neighbours, len(x) - 1)
    reach = (1 + TIE) * _nearest(y, count)[0][:, -1]
    distances, neighbours = _nearest(x, count + 1)
    found = _share(distances, _near(y, neighbours, reach), count)
    tied = distances[:, -1] <= (1 + TIE) * distances[:, count - 1]
    if tied.any() and count < len(x) - 1:
        distances, neighbours = _nearest(x, _SHELLS * count, np.flatnonzero(tied))
        found[tied] = _share(distances, _near(y, neighbours, reach, tied), count)
    return float(found.mean())


def _share(
    distances: NDArray[np.float64], right: NDArray[np.bool_], count: int
) -> NDArray[np.float64]:
    """Share of true neighbours among the `count` nearest of each row, in any order of its ties."""
    last = distances[:, count - 1, None]
    certain, within = distances < (1 - TIE) * last, distances <= (1 + TIE) * last
    tied = within & ~certain
    places = (count - certain.sum(axis=1)) / tied.sum(axis=1)
    return np.asarray(((certain & right).sum(axis=1) + places * (tied & right).sum(axis=1)) / count)


def _near(
    points: NDArray[np.float64],
    neighbours: NDArray[np.intp],
    reach: NDArray[np.float64],
    rows: NDArray[np.bool_] | slice = slice(None),
) -> NDArray[np.bool_]:
    """Tell which of the listed neighbours of each point lie within its reach."""
    apart = np.linalg.norm(points[rows, None] - points[neighbours], axis=2)
    return np.asarray(apart <= reach[rows, None])


def _nearest(
    points: NDArray[np.float64], count: int, rows: NDArray[np.intp] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Find the nearest neighbours of points, all by default, and their distances, nearest first.

    A point is no neighbour of itself, even if others coincide with it.
    """
    rows = np.arange(len(points)) if rows is None else rows
    count = min(count, len(points) - 1)
    distances, found = KDTree(points).query(points[rows], k=count + 1)
    itself = found == rows[:, None]
    itself[~itself.any(axis=1), -1] = True  # crowded out by coincident points: drop the last
    shape = (len(rows), count)
    return np.asarray(distances)[~itself].reshape(shape), np.asarray(found)[~itself].reshape(shape)
