"""Overlapping blocks of sensors, for fits of too many sensors to use all pairs at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def overlapping_blocks(positions: ArrayLike, max_size: int) -> list[NDArray[np.intp]]:
    """Assign sensors to blocks such that most near pairs and many far pairs share a block.

    Parameters
    ----------
    positions : array_like of shape (N, k)
    max_size : int
        Maximum number of sensors per block.

    Returns
    -------
    list of ndarray of int
        Sorted indices: one block if all sensors fit into it. Otherwise blocks of neighbours, blocks
        of neighbours shifted by half a block, and blocks of every n-th sensor of the whole skin.
    """
    points = np.asarray(positions, dtype=np.float64)
    n_points = len(points)
    if n_points <= max_size:
        return [np.arange(n_points)]
    order = _bisection_order(points, np.arange(n_points))
    count = -(-n_points // max_size)
    shifted = np.roll(order, -(n_points // (2 * count)))
    near = [*np.array_split(order, count), *np.array_split(shifted, count)]
    return [np.sort(block) for block in [*near, *(order[i::count] for i in range(count))]]


def _bisection_order(points: NDArray[np.float64], chosen: NDArray[np.intp]) -> NDArray[np.intp]:
    """Order points by recursive bisection along their longest axis."""
    if len(chosen) <= 2:
        return chosen
    inside = points[chosen]
    axis = int(np.ptp(inside, axis=0).argmax())
    ranked = chosen[np.argsort(inside[:, axis], kind="stable")]
    half = len(ranked) // 2
    return np.concatenate(
        [_bisection_order(points, ranked[:half]), _bisection_order(points, ranked[half:])]
    )
