"""Modules found as blocks of consecutive sensors of the same shape."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

TOLERANCE = 0.25
"""Largest error of places that count as equal, as a share of the spacing in a group.

Chosen by hand: layouts of curved bodies bend their modules by up to a tenth of the spacing.
"""

_MAX_MODULE = 64  # channels
_MIN_REPEATED = 0.5  # share of the sensors that must be on modules of one shape
_CLEARLY_MORE = 0.1  # a multiple of the true size has a share that is hardly larger
_MAX_SHAPES = 8  # different shapes, the first ones found, of which one should be frequent
_MAX_SIZES = 8  # sizes of modules that are tried, by how periodic the distances are
_N_NEXT = 3  # following channels of which distances are compared
_MIN_PADS = 5  # fewer places are congruent too often by chance


def rigid_repeats(positions: NDArray[np.float64], numbers: NDArray[np.intp]) -> tuple[int, int]:
    """Find modules, blocks of consecutive sensors whose shapes repeat: size and first number.

    positions (N, k). The size is 0 if no shapes repeat.
    """
    best, best_share = (0, 0), _MIN_REPEATED
    sizes = np.arange(_MIN_PADS, min(_MAX_MODULE, len(positions) // 2) + 1)
    periodic = np.array([_share_periodic(positions, numbers, size) for size in sizes.tolist()])
    likely = np.argsort(-periodic, kind="stable")[:_MAX_SIZES]
    for size in sorted(sizes[likely[periodic[likely] >= _MIN_REPEATED]].tolist()):
        first, share = blocks_of_size(positions, numbers, size)
        if share > best_share + _CLEARLY_MORE:
            best, best_share = (size, first), share
    return best


def blocks_of_size(
    positions: NDArray[np.float64], numbers: NDArray[np.intp], size: int
) -> tuple[int, float]:
    """Divide sensors into blocks of `size` consecutive numbers: first number, and share alike.

    Most are congruent, or, if bending makes all unequal, they are as few as possible.
    """
    distances = cdist(positions, positions)
    found = []
    for first in range(size):
        labels = np.unique((numbers - first) // size, return_inverse=True)[1]
        share = _share_congruent(distances, (numbers - first) % size, labels)
        found.append((-round(share, 9), int(labels.max()), first))
    share, _, first = min(found)
    return first, -share


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
