"""Sensors shared out into blocks that overlap, where all pairs at once would be too many."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def overlapping_blocks(places: ArrayLike, most: int) -> list[NDArray[np.intp]]:
    """Share sensors out into blocks, so that most near pairs and many far ones meet in one.

    Parameters
    ----------
    places : array_like of shape (N, k)
    most : int
        Sensors a block.

    Returns
    -------
    list of ndarray of int
        One block of all if they fit. Else blocks of neighbours, blocks of neighbours shifted by
        half a block, and blocks that take every n-th sensor of the whole skin.
    """
    points = np.asarray(places, dtype=np.float64)
    n_points = len(points)
    if n_points <= most:
        return [np.arange(n_points)]
    order = _along(points, np.arange(n_points))
    count = -(-n_points // most)
    shifted = np.roll(order, -(n_points // (2 * count)))
    near = [*np.array_split(order, count), *np.array_split(shifted, count)]
    return [np.sort(block) for block in [*near, *(order[i::count] for i in range(count))]]


def _along(points: NDArray[np.float64], chosen: NDArray[np.intp]) -> NDArray[np.intp]:
    """Put points into an order in which neighbours come one after the other mostly."""
    if len(chosen) <= 2:
        return chosen
    inside = points[chosen]
    axis = int(np.ptp(inside, axis=0).argmax())
    ranked = chosen[np.argsort(inside[:, axis], kind="stable")]
    half = len(ranked) // 2
    return np.concatenate([_along(points, ranked[:half]), _along(points, ranked[half:])])
