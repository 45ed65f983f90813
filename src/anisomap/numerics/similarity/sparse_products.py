"""Products of readings that mostly rest: of what does not rest alone, exact and many times faster.

A skin is touched in few places at a time. Of a frame in which a of N sensors do not read what they
read at rest, only a^2 products are not 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.parallel import load_loops, parallel_map
from anisomap.numerics.precision import mirror

Floats = NDArray[np.float64]

DENSE_PRODUCTS = 60
"""Products of whole matrices that take as long as one of single readings."""

_SAMPLED = 63  # frames that tell what a sensor reads at rest
_ROWS = 96  # of the result, which stay in a core's own cache


def products_of_few(readings: NDArray[Any]) -> tuple[Floats, Floats] | None:
    """Sum the products of readings of every pair of sensors, if few of them are not at rest.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
        Finite readings.

    Returns
    -------
    mean : ndarray of shape (N,)
    comoment : ndarray of shape (N, N)
        Sums over frames of the products of deviations from the means, symmetric to the last bit;
        exact zeros for a sensor that never varied. None instead of both where matrix products
        would be faster.
    """
    n_frames, n_sensors = readings.shape
    sample = readings[np.linspace(0, n_frames - 1, min(n_frames, _SAMPLED)).astype(int)]
    rest = np.sort(sample, axis=0)[len(sample) // 2]
    touched = readings != rest
    together = np.count_nonzero(touched, axis=1).astype(np.float64)
    if DENSE_PRODUCTS * np.vdot(together, together) > float(n_sensors) ** 2 * n_frames:
        return None
    sensors = np.nonzero(touched)[1].astype(np.uint32)
    depths = readings[touched].astype(np.float64) - rest[sensors]
    begins = np.concatenate([[0], np.cumsum(together)]).astype(np.int64)
    sums = np.bincount(sensors, weights=depths, minlength=n_sensors)
    products = np.empty((n_sensors, n_sensors))

    def add(begin: int) -> None:
        rows = slice(begin, min(begin + _ROWS, n_sensors))
        panel = np.outer(sums[rows], sums / -n_frames)
        load_loops("products").add_products(panel, begin, sensors, depths, begins)
        products[rows] = panel

    with parallel_map(n_sensors) as spread_over:
        spread_over(add, range(0, n_sensors, _ROWS))
    mirror(products, upper=True)
    return rest + sums / n_frames, products
