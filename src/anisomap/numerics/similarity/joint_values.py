"""How often pairs of values were read together: all that any similarity asks, in one pass.

Bins, rests and ranks follow from all frames, so whoever sees each frame only once cannot settle
them before. Where sensors read few values, as 0 and 1, the joint counts of values themselves are
kept instead, and put together as bins in the end: the same counts as of two passes.
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
"""Values that are kept of all sensors together: 256 MiB of joint counts."""

_FEWEST_VALUES = 4  # of one sensor, however many sensors there are


@dataclass(frozen=True, eq=False)
class JointValues:
    """How often each two values of N sensors were read together.

    Attributes
    ----------
    single : ValueCounts
        The values, V of all sensors together; rounded where a sensor has too many.
    counts : ndarray of uint32 or uint64, shape (V, V)
        Frames in which both were read.
    """

    single: ValueCounts
    counts: Counts

    @classmethod
    def of(cls, readings: ArrayLike) -> JointValues:
        """Count the pairs of values in an array of finite readings, shape (T, N), T >= 1."""
        array = np.asarray(readings)
        single = ValueCounts.of(array, max(_FEWEST_VALUES, MAX_SERIES // array.shape[1]))
        first = _first(single)
        sizes = np.diff(first)
        numbers = np.arange(sizes.max())
        position = np.where(numbers < sizes[:, None], first[:-1, None] + numbers, -1)
        every = Layout(np.full(array.shape[1], -1), position, first)
        recoding = Recoding.of(single.values, [np.arange(size) for size in sizes], np.uint16)
        return cls(single, CoOccurrences.of(recoding(array), every).counts)

    def merged(self, other: JointValues) -> JointValues:
        """Join the counts of two disjoint sets of frames of the same sensors.

        Parameters
        ----------
        other : JointValues
            Of the same N sensors.

        Returns
        -------
        JointValues
            Of all frames; the order of merging does not matter at all.
        """
        single = self.single.merged(other.single)
        size = int(_first(single)[-1])
        dtype = np.uint32 if single.n_frames <= np.iinfo(np.uint32).max else np.uint64
        counts = np.zeros((size, size), dtype=dtype)
        for part in (self, other):
            places = _places(part.single, single)
            kept, begins = np.unique(places, return_index=True)
            rows = np.add.reduceat(part.counts, begins, axis=0)
            counts[np.ix_(kept, kept)] += np.add.reduceat(rows, begins, axis=1).astype(dtype)
        return JointValues(single, counts)

    def varying(self) -> NDArray[np.bool_]:
        """Tell which sensors ever varied, shape (N,)."""
        return self.single.varying()

    def of_series(self, codes: list[NDArray[np.intp]], layout: Layout) -> CoOccurrences:
        """Put values together to series.

        Parameters
        ----------
        codes : list of ndarray of int
            For each sensor the code of each of its values.
        layout : Layout

        Returns
        -------
        CoOccurrences
            The same as of all frames, had their codes been known.
        """
        series = np.concatenate([layout.position[i][code] for i, code in enumerate(codes)])
        there = np.flatnonzero(series >= 0)
        shape = (layout.n_series, series.size)
        groups = csr_array((np.ones(there.size, np.int64), (series[there], there)), shape=shape)
        return CoOccurrences(
            self.single.n_frames, layout.first, self._combined(groups).astype(self.counts.dtype)
        )

    def comoments(self, worth: list[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Sum products of deviations from the mean, had each value been worth something else.

        Parameters
        ----------
        worth : list of ndarray
            For each sensor, what each of its values counts as.

        Returns
        -------
        ndarray of shape (N, N)
        """
        first = _first(self.single)
        means = [
            np.average(value, weights=counts)
            for value, counts in zip(worth, self.single.counts, strict=True)
        ]
        deviations = np.concatenate([v - mean for v, mean in zip(worth, means, strict=True)])
        weights = csr_array((deviations, np.arange(deviations.size), first))
        product = self._combined(weights)
        return np.asarray((product + product.T) / 2)

    def _combined(self, weights: csr_array) -> NDArray[np.float64]:
        return np.asarray(weights @ (weights @ self.counts).T)


def _first(single: ValueCounts) -> NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum([values.size for values in single.values])])


def _places(part: ValueCounts, whole: ValueCounts) -> NDArray[np.int64]:
    """Find where the values of some frames stand among those of all."""
    first = _first(whole)
    return np.concatenate(
        [
            first[i] + np.searchsorted(whole.values[i], values, side="right") - 1
            for i, values in enumerate(part.values)
        ]
    )
