"""Maximum-entropy binning that respects ties."""

from __future__ import annotations

from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.columns import columns, count_values
from anisomap.numerics.compiled.parallel import load_loops
from anisomap.numerics.similarity.co_occurrence import MIN_COMPILED_SENSORS

DEFAULT_BINS = 4
"""Number of bins in the paper, which reports similar results for 6 and 8."""

MAX_BINS = 1024
"""Maximum number of bins; the joint counts of more need over a million frames."""

_SENSORS_AT_ONCE = 64  # written at a time
_MAX_COST = 2.0**61  # of the integer costs of a division; their sums must fit in int64


def maximum_entropy_bins(counts: ArrayLike, bins: int = DEFAULT_BINS) -> NDArray[np.intp]:
    """Divide m ordered distinct values into the bins of greatest entropy.

    McGregor et al. (2011), section "Information Distance", bin by maximum entropy. Quantile edges
    fail on tactile data: most readings are at rest, and every edge coincides with the rest value.
    Here the division is exactly optimal among all divisions into intervals: it has the least sum
    of ``n log n`` over the counts n of its bins (dynamic programming in O(b m log m)). Of equally
    good divisions, the one with the earliest last bin is taken.
    """
    return _divide(np.asarray(counts, dtype=np.int64), _checked(bins))


def _checked(bins: int) -> int:
    if bins < 2:
        raise InputError(f"bins must be at least 2, got {bins}")
    if bins > MAX_BINS:
        raise InputError(f"bins must be at most {MAX_BINS}, got {bins}")
    return bins


def _divide(
    mass: NDArray[np.int64], bins: int, costs: NDArray[np.int64] | None = None
) -> NDArray[np.intp]:
    """Divide values as `maximum_entropy_bins`."""
    if mass.size <= bins:
        return np.arange(mass.size)
    ends = np.concatenate([[0], np.cumsum(mass)])
    unit = _unit(int(ends[-1]))
    before = _possible_ends(ends, int(mass.max()), 1, bins)
    least, cuts = _cost(ends, unit), []
    for n_bins in range(2, int(bins) + 1):
        first, last = _possible_ends(ends, int(mass.max()), n_bins, bins)
        after = (max(first, before[0] + 1), last)
        if costs is None:
            least, cut = _with_another_bin(least, ends, before, after, unit)
        else:
            found = np.zeros_like(ends), np.zeros_like(ends)
            load_loops("binning").add_bin(costs, ends, least, before + after, found)
            least, cut = found
        cuts.append(cut)
        before = after
    result, end = np.zeros(mass.size, dtype=np.intp), mass.size
    for cut in reversed(cuts):
        end = int(cut[end])
        result[end:] += 1
    return result


def _possible_ends(ends: NDArray[np.int64], greatest: int, k: int, bins: int) -> tuple[int, int]:
    """Bound the number of values in the first k bins of the best division: first and last.

    Adjacent bins differ by at most the greatest count of a value, since moving the value between
    them would improve the division otherwise. All bins together have all counts.
    """
    slack = greatest * k * (bins - k)
    first = np.searchsorted(2 * bins * ends, 2 * k * ends[-1] - slack * bins, side="left")
    last = np.searchsorted(2 * bins * ends, 2 * k * ends[-1] + slack * bins, side="right") - 1
    n_values = len(ends) - 1
    return max(int(first), k), min(int(last), n_values - int(bins) + k)


def _with_another_bin(
    least: NDArray[np.int64],
    ends: NDArray[np.int64],
    before: tuple[int, int],
    after: tuple[int, int],
    unit: float,
) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Find the best division of beginnings of the values into one more bin.

    The cost is Monge, since n log n is convex, so that the best cut never decreases with j (Knuth
    1971, Acta Informatica 1: 14-25). Every second j is solved first, recursively; its neighbours
    bound the cuts of the others.
    """
    first, last = after
    cut = np.zeros(len(ends), dtype=np.intp)
    result = np.zeros(len(ends), dtype=np.int64)
    stride = 1 << ((last - first + 1).bit_length() - 1)
    while stride:
        row = np.arange(first + stride - 1, last + 1, 2 * stride)
        low = np.where(row - stride < first, before[0], cut[np.maximum(row - stride, first)])
        high = np.where(row + stride > last, before[1], cut[np.minimum(row + stride, last)])
        high = np.minimum(high, row - 1)
        lengths = high - low + 1
        starts = np.cumsum(lengths) - lengths
        tried = np.arange(int(lengths.sum())) + np.repeat(low - starts, lengths)
        cost = least[tried] + _cost(np.repeat(ends[row], lengths) - ends[tried], unit)
        result[row] = np.minimum.reduceat(cost, starts)
        best = np.flatnonzero(cost == np.repeat(result[row], lengths))
        cut[row] = tried[best[np.searchsorted(best, starts)]]
        stride //= 2
    return result, cut


def _unit(n_frames: int) -> float:
    """Return the unit of costs with which their sums fit in int64."""
    return float(_MAX_COST / (n_frames * np.log(n_frames)))


def _cost(counts: NDArray[np.int64], unit: float) -> NDArray[np.int64]:
    """Return n log n in units of 1 / `unit`: integers, so that equal divisions have equal costs."""
    return np.asarray(np.rint(unit * counts * np.log(np.maximum(counts, 1))), dtype=np.int64)


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
    n_bins, values = _checked(bins), np.asarray(readings)
    n_frames, n_sensors = values.shape
    is_compiled = n_sensors >= MIN_COMPILED_SENSORS and n_frames > 1
    costs = _cost(np.arange(n_frames + 1), _unit(n_frames)) if is_compiled else None
    codes = np.empty(values.shape, dtype=np.uint16)
    found = (_codes_of(column, n_bins, costs) for column in columns(values))
    # Writing single columns would load every row of the codes from memory for one number.
    for begin in range(0, n_sensors, _SENSORS_AT_ONCE):
        part = np.array(list(islice(found, _SENSORS_AT_ONCE)))
        codes[:, begin : begin + _SENSORS_AT_ONCE] = part.T
    return codes


def _codes_of(
    column: NDArray[Any], bins: int, costs: NDArray[np.int64] | None
) -> NDArray[np.uint16]:
    """Return the codes of one sensor, shape (T,)."""
    distinct, counts = count_values(column)
    found = _divide(counts, bins, costs).astype(np.uint16)
    # Searching the few values at which the bin changes is faster than searching all values.
    changes = np.flatnonzero(np.diff(found)) + 1
    runs = found[np.concatenate([[0], changes])]
    return np.asarray(runs[np.searchsorted(distinct[changes], column, side="right")])
