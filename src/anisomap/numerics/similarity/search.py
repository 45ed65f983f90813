"""Which sensors may be most like which: by their sketches, all pairs, a block at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from threadpoolctl import threadpool_limits

from anisomap.numerics.compiled.parallel import load_loops, parallel_map

ROWS = 512
"""Rows of products at a time."""

COLUMNS = 4096
"""Columns at a time: a block stays in the cache while its greatest entries are looked for."""

NO_SENSOR = -1


def most_similar(
    rows: NDArray[np.float32],
    count: int,
    *,
    groups: ArrayLike | None = None,
    sensors: ArrayLike | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Find for each sensor the sensors whose rows have the greatest inner products with its own.

    Parameters
    ----------
    rows : ndarray of float32, shape (N, s)
        Sketches, or anything else whose inner products say how alike sensors are.
    count : int
        How many to find; fewer where there are fewer.
    groups : array_like of int, shape (N,), optional
        A sensor is never matched with one of its own group. All are groups of their own unless
        given.
    sensors : array_like of int, shape (n,), optional
        For which sensors, in increasing order; all unless given.

    Returns
    -------
    found : ndarray of int, shape (n, count)
        The most alike first; -1 where there are no more.
    products : ndarray of float32, shape (n, count)
        -inf where there are no more.
    """
    n_sensors = len(rows)
    whom = np.arange(n_sensors) if sensors is None else np.asarray(sensors, dtype=np.int64)
    kinds = np.arange(n_sensors) if groups is None else np.asarray(groups, dtype=np.int64)
    found = np.full((len(whom), count), NO_SENSOR, dtype=np.int64)
    products = np.full(found.shape, -np.inf, dtype=np.float32)

    def look(begin: int) -> None:
        part = slice(begin, begin + ROWS)
        mine = rows[whom[part]]
        for left in range(0, n_sensors, COLUMNS):
            block = mine @ rows[left : left + COLUMNS].T
            own = kinds[whom[part]]
            load_loops("search").keep_greatest(
                block, left, own, kinds, (found[part], products[part])
            )

    # Threads of ours, not of the library of products, so that sums do not depend on their number.
    with threadpool_limits(1), parallel_map(len(whom)) as spread_over:
        spread_over(look, range(0, len(whom), ROWS))
    return found, products
