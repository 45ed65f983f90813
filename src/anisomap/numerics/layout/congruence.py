"""Symmetries of a group of sensors, and groups of the same shape."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from anisomap.numerics.neighbours import nearest_distances

TOLERANCE = 0.25
"""Largest error of places that count as equal, as a share of the spacing in a group.

Chosen by hand: layouts of curved bodies bend their modules by up to a tenth of the spacing.
"""

_MAX_FOLD = 8  # largest order of a rotation that is tried
_MAX_MODULE = 64  # channels
_MIN_REPEATED = 0.5  # share of the sensors that must be on modules of one shape
_CLEARLY_MORE = 0.1  # a multiple of the true size has a share that is hardly larger
_MAX_SHAPES = 8  # different shapes, the first ones found, of which one should be frequent
_MAX_SIZES = 8  # sizes of modules that are tried, by how periodic the distances are
_N_NEXT = 3  # following channels of which distances are compared
_MIN_PADS = 5  # fewer places are congruent too often by chance


@dataclass(frozen=True, eq=False)
class Symmetry:
    """A rotation or reflection that maps a group of places onto itself.

    angle: Of a rotation, in degrees, in (0, 180]; 0 for a reflection.
    order: Sensor i takes the place ``order[i]``.
    """

    reflected: bool
    angle: float
    order: NDArray[np.intp]


def symmetries(points: NDArray[np.float64]) -> tuple[Symmetry, ...]:
    """Find the rotations and reflections that map a nearly flat group of places onto itself.

    points (m, 2).
    """
    n_points = len(points)
    if n_points < 3:
        return ()
    centred = points - points.mean(axis=0)
    basis = np.linalg.svd(centred, full_matrices=False)[2][:2]
    flat = centred @ basis.T
    allowed = TOLERANCE * float(np.median(nearest_distances(flat)))
    angles = [2 * math.pi * k / n for n in range(2, _MAX_FOLD + 1) for k in range(1, n)]
    known, found = {tuple(range(n_points))}, []
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
            if tuple(order.tolist()) not in known:
                degrees = 0.0 if reflected else math.degrees(min(angle, 2 * math.pi - angle))
                found.append(Symmetry(reflected, degrees, order))
            known.add(tuple(order.tolist()))
    return tuple(found)


def congruent(first: NDArray[np.float64], second: NDArray[np.float64]) -> bool:
    """Return whether two groups of places have the same distances, in their given orders."""
    if len(first) != len(second) or len(first) < 2:
        return False
    return _congruent(cdist(first, first), cdist(second, second))


def rigid_repeats(positions: NDArray[np.float64], numbers: NDArray[np.intp]) -> NDArray[np.intp]:
    """Find modules: blocks of consecutive sensors whose shapes repeat. positions (N, k)."""
    best, best_share = np.full(len(positions), -1), _MIN_REPEATED
    sizes = np.arange(_MIN_PADS, min(_MAX_MODULE, len(positions) // 2) + 1)
    periodic = np.array([_share_periodic(positions, numbers, size) for size in sizes.tolist()])
    likely = np.argsort(-periodic, kind="stable")[:_MAX_SIZES]
    for size in sorted(sizes[likely[periodic[likely] >= _MIN_REPEATED]].tolist()):
        labels, share = blocks_of_size(positions, numbers, size)
        if share > best_share + _CLEARLY_MORE:
            best, best_share = labels, share
    return best


def blocks_of_size(
    positions: NDArray[np.float64], numbers: NDArray[np.intp], size: int
) -> tuple[NDArray[np.intp], float]:
    """Divide sensors into blocks of `size` consecutive numbers, such that most are congruent."""
    best, best_share = np.zeros(len(positions), dtype=np.intp), -1.0
    distances = cdist(positions, positions)
    for offset in range(size):
        labels = np.unique((numbers - offset) // size, return_inverse=True)[1]
        share = _share_congruent(distances, (numbers - offset) % size, labels)
        if share > best_share + 1e-9:
            best, best_share = labels, share
    return best, best_share


def _share_periodic(positions: NDArray[np.float64], numbers: NDArray[np.intp], size: int) -> float:
    """Return the share of channels whose next three are as far away as those of `size` later.

    Modules of this size have most distances between nearby channels in common.
    """
    order = np.argsort(numbers)
    channels, places = numbers[order], positions[order]
    last = channels[-1] - channels[0] + 1
    row = np.full(last + size + _N_NEXT, -1)
    row[channels - channels[0]] = np.arange(len(channels))
    here = row[:last]
    same = here >= 0
    compared = np.zeros(last, dtype=bool)
    for step in range(1, _N_NEXT + 1):
        ends = (here, row[step:][:last], row[size:][:last], row[size + step :][:last])
        known = np.all([end >= 0 for end in ends], axis=0)
        first, second, third, fourth = (places[end[known]] for end in ends)
        change = np.linalg.norm(first - second, axis=1) - np.linalg.norm(third - fourth, axis=1)
        same[known] &= np.abs(change) <= TOLERANCE * np.linalg.norm(first - second, axis=1)
        compared |= known
    return float(same[compared].mean()) if compared.any() else 0.0


def _share_congruent(
    distances: NDArray[np.float64], channels: NDArray[np.intp], labels: NDArray[np.intp]
) -> float:
    order = np.argsort(labels, kind="stable")
    blocks = np.split(order, np.flatnonzero(np.diff(labels[order])) + 1)
    shapes: list[tuple[bytes, NDArray[np.float64], int]] = []
    for inside in blocks:
        if len(inside) < _MIN_PADS:
            continue
        present, shape = channels[inside].tobytes(), distances[np.ix_(inside, inside)]
        for k, (known, other, count) in enumerate(shapes):
            if known == present and _congruent(other, shape):
                shapes[k] = (known, other, count + len(inside))
                break
        else:
            if len(shapes) < _MAX_SHAPES:
                shapes.append((present, shape, len(inside)))
    repeated = [count for _, shape, count in shapes if count > len(shape)]
    return max(repeated, default=0) / len(labels)


def _congruent(first: NDArray[np.float64], second: NDArray[np.float64]) -> bool:
    """Return whether two matrices of distances are equal."""
    others = first + np.diag(np.full(len(first), np.inf))
    return float(np.abs(first - second).max()) <= TOLERANCE * float(np.median(others.min(axis=0)))
