"""Maximum-entropy binning that respects ties.

Bins, rest and ranks are computed from counts of the distinct values of each sensor.

Counts of chunks of frames can be merged in any order. A sensor with continuous readings has as many
values as frames; above a limit, values are rounded by the least sufficient number of bits. The
result does not depend on the chunks or their order.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.columns import columns
from anisomap.numerics.precision import Floats
from anisomap.numerics.ranges import Range

DEFAULT_BINS = 4
"""Number of bins in the paper, which reports similar results for 6 and 8."""

# Joint counts of more bins require over a million frames.
_BINS = Range("an integer from 2 to 1024", lambda value: 2 <= value <= 1024, whole=True)
_MAX_COST = 2.0**61  # of the integer costs of a division; their sums must fit in int64


def maximum_entropy_bins(counts: ArrayLike, bins: int = DEFAULT_BINS) -> NDArray[np.intp]:
    """Divide m ordered distinct values into bins of maximum entropy.

    McGregor et al. (2011), section "Information Distance". The division is optimal among all
    divisions into intervals: it has the least sum of ``n log n`` over the counts n of its bins
    (dynamic programming in O(b m log m)). Among equally good divisions, the one with the
    earliest last bin is taken.
    """
    _BINS.check("bins", bins)
    return _divide(np.asarray(counts, dtype=np.int64), bins)


def _divide(mass: NDArray[np.int64], bins: int) -> NDArray[np.intp]:
    """Divide values; see `maximum_entropy_bins`."""
    if mass.size <= bins:
        return np.arange(mass.size)
    ends = np.concatenate([[0], np.cumsum(mass)])
    unit = _unit(int(ends[-1]))
    before = _possible_ends(ends, int(mass.max()), 1, bins)
    least, cuts = _cost(ends, unit), []
    for n_bins in range(2, int(bins) + 1):
        first, last = _possible_ends(ends, int(mass.max()), n_bins, bins)
        after = (max(first, before[0] + 1), last)
        least, cut = _with_another_bin(least, ends, before, after, unit)
        cuts.append(cut)
        before = after
    result, end = np.zeros(mass.size, dtype=np.intp), mass.size
    for cut in reversed(cuts):
        end = int(cut[end])
        result[end:] += 1
    return result


def _possible_ends(ends: NDArray[np.int64], greatest: int, k: int, bins: int) -> tuple[int, int]:
    """Return bounds of the number of values in the first k bins of the best division.

    Adjacent bins differ by at most the greatest count of a value; otherwise, moving it is better.
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
    """Find the best divisions of the first j values, for each j, into one more bin.

    The cost is Monge, since n log n is convex, so the best cut never decreases with j (Knuth 1971,
    Acta Informatica 1: 14-25). Every second j is solved first, recursively; its solutions bound the
    cuts of all other j.
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
    """Return a unit of costs for which sums of costs fit in int64."""
    return float(_MAX_COST / (n_frames * np.log(n_frames)))


def _cost(counts: NDArray[np.int64], unit: float) -> NDArray[np.int64]:
    """Return n log n in units of 1 / `unit`, as integers: equal divisions have equal costs."""
    return np.asarray(np.rint(unit * counts * np.log(np.maximum(counts, 1))), dtype=np.int64)


def maximum_entropy_codes(readings: ArrayLike, bins: int = DEFAULT_BINS) -> NDArray[np.uint16]:
    """Replace every reading by the number of its bin, from 0: see `maximum_entropy_bins`.

    readings (T, N) -> (T, N), invariant under increasing transformations of a sensor.
    """
    _BINS.check("bins", bins)
    return np.array([_codes_of(column, bins) for column in columns(np.asarray(readings))]).T


def _codes_of(column: NDArray[Any], bins: int) -> NDArray[np.uint16]:
    """Return the codes of one sensor, shape (T,)."""
    distinct, counts = np.unique(column, return_counts=True)
    found = _divide(counts, bins).astype(np.uint16)
    # Searching only the values at which the bin changes is faster than searching all values.
    changes = np.flatnonzero(np.diff(found)) + 1
    runs = found[np.concatenate([[0], changes])]
    return np.asarray(runs[np.searchsorted(distinct[changes], column, side="right")])


MAX_VALUES = 1 << 24
"""Maximum number of values of all sensors together: 256 MiB of values and counts."""

_MIN_VALUES = 256  # least limit per sensor, for any number of sensors
_MAGNITUDE = np.int64(np.iinfo(np.int64).max)  # mask of all bits but the sign


@dataclass(frozen=True, eq=False)
class ValueCounts:
    """Distinct values of each of N sensors, and their numbers of occurrences, over T frames.

    values: In increasing order; values rounded to the same number are represented by the smallest.
    n_rounded_bits: Bits rounded off the float64 values of each sensor; 0 if exact.
    max_values: Maximum number of values per sensor.
    """

    n_frames: int
    values: tuple[Floats, ...]
    counts: tuple[NDArray[np.int64], ...]
    n_rounded_bits: NDArray[np.int64]
    max_values: int

    @classmethod
    def of(cls, readings: ArrayLike, max_values: int | None = None) -> ValueCounts:
        """Count the values in an array. readings (T, N)."""
        array = np.asarray(readings)
        limit = max_values or max(_MIN_VALUES, MAX_VALUES // array.shape[1])
        found = [
            _round_to(*np.unique(column, return_counts=True), 0, limit) for column in columns(array)
        ]
        values, counts, n_rounded_bits = zip(*found, strict=True)
        return cls(len(array), values, counts, np.array(n_rounded_bits), limit)

    def merged(self, other: ValueCounts) -> ValueCounts:
        """Merge with the counts of other frames of the same sensors and limit, in any order."""
        n_rounded_bits = np.maximum(self.n_rounded_bits, other.n_rounded_bits)
        found = [
            _round_to(np.concatenate([a, b]), np.concatenate([m, n]), int(n_bits), self.max_values)
            for a, b, m, n, n_bits in zip(
                self.values, other.values, self.counts, other.counts, n_rounded_bits, strict=True
            )
        ]
        values, counts, rounded = zip(*found, strict=True)
        return ValueCounts(
            self.n_frames + other.n_frames, values, counts, np.array(rounded), self.max_values
        )

    @property
    def n_sensors(self) -> int:
        """Number of sensors, N."""
        return len(self.values)

    @property
    def exact(self) -> bool:
        """Whether no value was rounded."""
        return not self.n_rounded_bits.any()

    def varying(self) -> NDArray[np.bool_]:
        """Return whether each sensor varies, shape (N,)."""
        return np.array([values.size > 1 for values in self.values])


@dataclass(frozen=True, eq=False)
class Recoding:
    """Step function of the readings of each sensor: outcomes, and readings where each begins."""

    starts: tuple[Floats, ...]
    outcomes: tuple[NDArray[Any], ...]

    @classmethod
    def of(
        cls, values: Iterable[Floats], outcomes: Iterable[NDArray[Any]], dtype: type
    ) -> Recoding:
        """Assign outcomes to increasing values; between two values, the lower's outcome holds."""
        starts, kept = [], []
        for levels, results in zip(values, outcomes, strict=True):
            changes = np.flatnonzero(np.diff(results)) + 1
            starts.append(levels[changes])
            kept.append(results[np.concatenate([[0], changes])].astype(dtype))
        return cls(tuple(starts), tuple(kept))

    def __call__(self, readings: ArrayLike) -> NDArray[Any]:
        """Recode readings of shape (T, N)."""
        array = np.asarray(readings)
        recoded = np.empty(array.shape, dtype=self.outcomes[0].dtype)
        for i, column in enumerate(columns(array)):
            where = np.searchsorted(self.starts[i], column.astype(np.float64), side="right")
            recoded[:, i] = self.outcomes[i][where]
        return recoded


def _round_to(
    values: NDArray[Any], counts: NDArray[np.int64], n_bits: int, max_values: int
) -> tuple[Floats, NDArray[np.int64], int]:
    """Round values by `n_bits` or more bits, until at most `max_values` are distinct."""
    order = np.argsort(values, kind="stable")
    sorted_values, weights = values[order].astype(np.float64) + 0.0, counts[order]
    bits = sorted_values.view(np.int64)
    keys = np.where(bits < 0, bits ^ _MAGNITUDE, bits) >> n_bits  # in the order of the values
    begins = _run_starts(keys)
    while begins.size > max_values:
        n_bits += 1
        keys >>= 1
        begins = _run_starts(keys)
    return sorted_values[begins], np.add.reduceat(weights, begins), n_bits


def _run_starts(keys: NDArray[np.int64]) -> NDArray[np.intp]:
    return np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))
