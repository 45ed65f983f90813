"""Joint counts of the values of every pair of sensors, in one pass over the frames.

Bins, rest and ranks depend on all frames, so a single pass cannot apply them. Instead, joint counts
of the distinct values are stored and converted to bins, activity or ranks at the end. The result
equals that of two passes if sensors have few distinct values, such as 0 and 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from anisomap.numerics.similarity.accumulators import CoOccurrences
from anisomap.numerics.similarity.co_occurrence import Counts, Layout
from anisomap.numerics.similarity.value_counts import Recoding, ValueCounts

MAX_SERIES = 8192
"""Maximum number of values of all sensors together: 256 MiB of joint counts."""

_MIN_VALUES = 4  # minimum of the limit per sensor, for any number of sensors


@dataclass(frozen=True, eq=False)
class JointValues:
    """Joint counts of the values of N sensors.

    single: The values of each sensor, V in total; rounded if a sensor has too many.
    counts: Number of frames with both values.
    """

    single: ValueCounts
    counts: Counts

    @classmethod
    def of(cls, readings: ArrayLike) -> JointValues:
        """Count in an array of finite readings, shape (T, N), T >= 1."""
        array = np.asarray(readings)
        single = ValueCounts.of(array, max(_MIN_VALUES, MAX_SERIES // array.shape[1]))
        first = _first_value(single)
        sizes = np.diff(first)
        numbers = np.arange(sizes.max())
        position = np.where(numbers < sizes[:, None], first[:-1, None] + numbers, -1)
        layout = Layout(np.full(array.shape[1], -1), position, first)
        recoding = Recoding.of(single.values, [np.arange(size) for size in sizes], np.uint16)
        return cls(single, CoOccurrences.of(recoding(array), layout).counts)

    def merged(self, other: JointValues) -> JointValues:
        """Merge with the counts of other frames of the same sensors, in any order."""
        single = self.single.merged(other.single)
        size = int(_first_value(single)[-1])
        dtype = np.uint32 if single.n_frames <= np.iinfo(np.uint32).max else np.uint64
        counts = np.zeros((size, size), dtype=dtype)
        for part in (self, other):
            places = _places(part.single, single)
            kept, begins = np.unique(places, return_index=True)
            rows = np.add.reduceat(part.counts, begins, axis=0)
            counts[np.ix_(kept, kept)] += np.add.reduceat(rows, begins, axis=1).astype(dtype)
        return JointValues(single, counts)

    def varying(self) -> NDArray[np.bool_]:
        """Return which sensors vary, shape (N,)."""
        return self.single.varying()

    def of_series(self, codes: list[NDArray[np.intp]], layout: Layout) -> CoOccurrences:
        """Convert counts of values to counts of series."""
        series = np.concatenate([layout.position[i][code] for i, code in enumerate(codes)])
        exists = np.flatnonzero(series >= 0)
        shape = (layout.n_series, series.size)
        groups = csr_array((np.ones(exists.size, np.int64), (series[exists], exists)), shape=shape)
        return CoOccurrences(
            self.single.n_frames, layout.first, self._combine(groups).astype(self.counts.dtype)
        )

    def comoments(self, scores: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Compute the co-moments of scores that are assigned to the values. Returns (N, N)."""
        means = [
            np.average(score, weights=counts)
            for score, counts in zip(scores, self.single.counts, strict=True)
        ]
        deviations = np.concatenate([v - mean for v, mean in zip(scores, means, strict=True)])
        weights = csr_array((deviations, np.arange(deviations.size), _first_value(self.single)))
        product = self._combine(weights)
        return np.asarray((product + product.T) / 2)

    def _combine(self, weights: csr_array) -> NDArray[np.float64]:
        return np.asarray(weights @ (weights @ self.counts).T)


def _first_value(single: ValueCounts) -> NDArray[np.int64]:
    """Return the index of the first value of each sensor, and the number of values, (N + 1,)."""
    return np.concatenate([[0], np.cumsum([values.size for values in single.values])])


def _places(part: ValueCounts, whole: ValueCounts) -> NDArray[np.int64]:
    """Return the indices of the values of a part among the values of all frames."""
    first = _first_value(whole)
    return np.concatenate(
        [
            first[i] + np.searchsorted(whole.values[i], values, side="right") - 1
            for i, values in enumerate(part.values)
        ]
    )
