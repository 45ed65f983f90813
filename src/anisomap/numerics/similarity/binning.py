"""Maximum-entropy binning that respects ties."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.columns import columns, count_values

DEFAULT_BINS = 4
"""The paper's number of bins; it reports that 6 and 8 gave similar results."""

MAX_BINS = 1 << 16
"""As many as 16 bits tell apart."""


def maximum_entropy_bins(counts: ArrayLike, bins: int = DEFAULT_BINS) -> NDArray[np.intp]:
    """Share m distinct values out over bins so that the bins are as equally full as ties allow.

    Parameters
    ----------
    counts : array_like of int, shape (m,)
        How often each distinct value occurs, in the order of the values. All positive.
    bins : int
        The greatest number of bins, b >= 2.

    Returns
    -------
    ndarray of int, shape (m,)
        The bin of each value, from 0. Never more than b bins, none of them empty; m bins if
        m <= b.

    Raises
    ------
    InputError
        If `bins` is less than 2, or more than 65,536.

    Notes
    -----
    McGregor et al. (2011), section "Information Distance", bin by maximum entropy. Quantile edges
    fail on skins, where one value (rest) holds most of the mass: every edge falls onto it. So an
    atom, a value that holds more than its share 1/b, gets a bin of its own; what is left is shared
    out over the bins that are left, in which there may be atoms again. Among the rest, a value
    goes where the middle of its ranks lies. Consecutive middles are never further apart than a
    bin is wide, so no bin stays empty.
    """
    if bins < 2:
        raise InputError(f"{bins} bins tell nothing apart; use 2 or more")
    if bins > MAX_BINS:
        raise InputError(f"{bins} bins are more than the {MAX_BINS} that codes can tell apart")
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
    # Twice the middle rank, in integers: exact, so that equal data give equal bins everywhere.
    twice_middle = 2 * np.cumsum(shared) - shared
    result[~atoms] = twice_middle * free // (2 * max(1, int(shared.sum())))
    used = int(result[~atoms].max(initial=-1)) + 1
    result[atoms] = used + np.arange(int(atoms.sum()))
    return result


def maximum_entropy_codes(readings: ArrayLike, bins: int = DEFAULT_BINS) -> NDArray[np.uint16]:
    """Replace every reading by the number of its bin, sensor by sensor.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.
    bins : int
        The greatest number of bins a sensor, b >= 2.

    Returns
    -------
    ndarray of uint16, shape (T, N)
        Codes from 0 to b - 1. They depend only on the order of a sensor's readings and their
        ties, so no increasing transformation of a sensor changes them.

    Raises
    ------
    InputError
        If `bins` is less than 2, or more than 65,536.
    """
    values = np.asarray(readings)
    codes = np.empty(values.shape[::-1], dtype=np.uint16)
    for sensor, column in enumerate(columns(values)):
        distinct, counts = count_values(column)
        found = maximum_entropy_bins(counts, bins)
        # Where the bin changes, of which there are few: faster than a place for every reading.
        changes = np.flatnonzero(np.diff(found)) + 1
        runs = found[np.concatenate([[0], changes])]
        codes[sensor] = runs[np.searchsorted(distinct[changes], column, side="right")]
    return np.ascontiguousarray(codes.T)
