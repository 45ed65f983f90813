"""Symmetries of a group of sensors, and groups of the same shape."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

TOLERANCE = 0.25
"""Largest error of places that count as equal, as a share of the spacing in a group.

Chosen by hand: layouts of curved bodies bend their modules by up to a tenth of the spacing.
"""

_MAX_FOLD = 8  # largest order of a rotation that is tried
_MAX_MODULE = 64  # sensors


def symmetries(points: NDArray[np.float64]) -> list[tuple[bool, NDArray[np.intp]]]:
    """Find the rotations and reflections that map a nearly flat group of places onto itself.

    Parameters
    ----------
    points : ndarray of shape (m, 2) or (m, 3)
        Distinct places.

    Returns
    -------
    list of (bool, ndarray of int)
        Whether it is a reflection, and the permutation: sensor i takes the place
        ``permutation[i]``. Without the identity; rotations first.
    """
    n_points = len(points)
    if n_points < 3:
        return []
    centred = points - points.mean(axis=0)
    basis = np.linalg.svd(centred, full_matrices=False)[2][:2]
    flat = centred @ basis.T
    allowed = TOLERANCE * _spacing(flat)
    angles = [2 * math.pi * k / n for n in range(2, _MAX_FOLD + 1) for k in range(1, n)]
    found: dict[tuple[int, ...], bool] = {tuple(range(n_points)): False}
    radius = np.linalg.norm(flat, axis=1)
    outer = int(radius.argmax())
    alike = np.flatnonzero(np.abs(radius - radius[outer]) <= allowed)
    direction = np.arctan2(flat[:, 1], flat[:, 0])
    turns = [(False, angle) for angle in sorted(set(angles))]
    # A reflection maps an outermost place to one that is as far out.
    turns += [(True, float(direction[outer] + direction[i])) for i in alike]
    for reflected, angle in turns:
        cos, sin = math.cos(angle), math.sin(angle)
        side = -1 if reflected else 1
        image = flat @ np.array([[cos, sin], [-side * sin, side * cos]])
        distances = cdist(image, flat)
        order = linear_sum_assignment(distances**2)[1]
        if distances[np.arange(n_points), order].max() <= allowed:
            found.setdefault(tuple(order.tolist()), reflected)
    images = sorted(((flag, order) for order, flag in list(found.items())[1:]), key=lambda x: x[0])
    return [(flag, np.array(order)) for flag, order in images]


def congruent(first: NDArray[np.float64], second: NDArray[np.float64]) -> bool:
    """Return whether two groups of places have the same distances, in their given orders."""
    if len(first) != len(second) or len(first) < 2:
        return False
    own, other = cdist(first, first), cdist(second, second)
    return float(np.abs(own - other).max()) <= TOLERANCE * _spacing(first)


def rigid_repeats(positions: NDArray[np.float64], numbers: NDArray[np.intp]) -> NDArray[np.intp]:
    """Find modules: blocks of consecutive sensors whose shapes repeat.

    Parameters
    ----------
    positions : ndarray of shape (N, k)
    numbers : ndarray of int, shape (N,)
        Numbers of the sensors; gaps, of channels without a sensor, are allowed.

    Returns
    -------
    ndarray of int, shape (N,)
        Module of each sensor; -1 for all if shapes do not repeat. The smallest size of a block is
        chosen with which more than half of the sensors are in blocks of the most frequent shape.
    """
    best, best_share = np.full(len(positions), -1), 0.5
    for size in range(3, min(_MAX_MODULE, len(positions) // 2) + 1):
        labels, share = blocks_of_size(positions, numbers, size)
        if share > best_share + 0.1:  # a multiple of the true size is hardly better
            best, best_share = labels, share
    return best


def blocks_of_size(
    positions: NDArray[np.float64], numbers: NDArray[np.intp], size: int
) -> tuple[NDArray[np.intp], float]:
    """Divide sensors into blocks of `size` consecutive numbers, such that most are congruent.

    Parameters
    ----------
    positions, numbers
        See `rigid_repeats`.
    size : int
        Channels of a module, those without a sensor included.

    Returns
    -------
    labels : ndarray of int, shape (N,)
        Block of each sensor.
    share : float
        Share of the sensors in blocks of the most frequent shape.
    """
    best, best_share = np.zeros(len(positions), dtype=np.intp), -1.0
    for offset in range(size):
        labels = (numbers - offset) // size
        labels = np.unique(labels, return_inverse=True)[1]
        share = _share_congruent(positions, numbers - offset, labels, size)
        if share > best_share + 1e-9:
            best, best_share = labels, share
    return best, best_share


def _share_congruent(
    positions: NDArray[np.float64],
    numbers: NDArray[np.intp],
    labels: NDArray[np.intp],
    size: int,
) -> float:
    shapes: list[tuple[tuple[int, ...], NDArray[np.float64], int]] = []
    for label in range(int(labels.max()) + 1):
        inside = np.flatnonzero(labels == label)
        if len(inside) < 3:
            continue
        channels, places = tuple((numbers[inside] % size).tolist()), positions[inside]
        for k, (known, shape, count) in enumerate(shapes):
            if known == channels and congruent(shape, places):
                shapes[k] = (known, shape, count + len(inside))
                break
        else:
            shapes.append((channels, places, len(inside)))
    repeated = [count for _, places, count in shapes if count > len(places)]
    return max(repeated, default=0) / len(positions)


def _spacing(points: NDArray[np.float64]) -> float:
    distances = cdist(points, points)
    np.fill_diagonal(distances, np.inf)
    return float(np.median(distances.min(axis=0)))
