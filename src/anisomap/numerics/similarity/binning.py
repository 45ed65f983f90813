"""Maximum-entropy binning that respects ties."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.columns import columns, count_values

DEFAULT_BINS = 4
"""Number of bins in the paper, which reports similar results for 6 and 8."""

MAX_BINS = 1 << 16
"""Maximum number of bins: codes are uint16."""


def maximum_entropy_bins(counts: ArrayLike, bins: int = DEFAULT_BINS) -> NDArray[np.intp]:
    """Assign m distinct values to bins with counts as equal as ties permit.

    Parameters
    ----------
    counts : array_like of int, shape (m,)
        Number of occurrences of each distinct value, in increasing order of the values; positive.
    bins : int
        Maximum number of bins, b >= 2.

    Returns
    -------
    ndarray of int, shape (m,)
        Bin of each value, from 0. At most b bins, none empty; m bins if m <= b.

    Raises
    ------
    InputError
        If `bins` is less than 2 or greater than 65,536.

    Notes
    -----
    McGregor et al. (2011), section "Information Distance", bin by maximum entropy. Quantile edges
    fail on tactile data: most readings are at rest, and every edge coincides with the rest value.
    Therefore an atom, a value with more than a share 1/b of the readings, is assigned a separate
    bin. The remaining readings are divided among the remaining bins, which may produce further
    atoms. Other values are assigned by the middle of their ranks. Consecutive middles are at most
    one bin width apart, so no bin is empty.
    """
    if bins < 2:
        raise InputError(f"bins must be at least 2, got {bins}")
    if bins > MAX_BINS:
        raise InputError(f"bins must be at most {MAX_BINS}, got {bins}")
    mass = np.asarray(counts, dtype=np.int64)
    atoms = np.zeros(mass.size, dtype=bool)
    free = bins
    while free > 0:
        rest = int(mass[~atoms].sum())
        found = ~atoms & (mass * free > rest)
        if not found.any():
            break
        atoms |= found
        free = bins - int(atoms.sum())
    shared = mass[~atoms]
    result = np.empty(mass.size, dtype=np.intp)
    # Twice the middle rank is an exact integer, so equal data give equal bins on every machine.
    twice_middle = 2 * np.cumsum(shared) - shared
    result[~atoms] = twice_middle * free // (2 * max(1, int(shared.sum())))
    used = int(result[~atoms].max(initial=-1)) + 1
    result[atoms] = used + np.arange(int(atoms.sum()))
    return result


def maximum_entropy_codes(readings: ArrayLike, bins: int = DEFAULT_BINS) -> NDArray[np.uint16]:
    """Replace every reading by the number of its bin; see `maximum_entropy_bins`.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.
    bins : int
        Maximum number of bins per sensor.

    Returns
    -------
    ndarray of uint16, shape (T, N)
        Codes from 0 to b - 1. Invariant under increasing transformations of a sensor.
    """
    values = np.asarray(readings)
    codes = np.empty(values.shape[::-1], dtype=np.uint16)
    for sensor, column in enumerate(columns(values)):
        distinct, counts = count_values(column)
        found = maximum_entropy_bins(counts, bins)
        # Searching the few values at which the bin changes is faster than searching all values.
        changes = np.flatnonzero(np.diff(found)) + 1
        runs = found[np.concatenate([[0], changes])]
        codes[sensor] = runs[np.searchsorted(distinct[changes], column, side="right")]
    return np.ascontiguousarray(codes.T)
