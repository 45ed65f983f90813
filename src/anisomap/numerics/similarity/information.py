"""Mutual information of every pair of sensors.

Joint counts of the values of every pair of sensors, in one pass over the frames.

Bins, rest and ranks depend on all frames, so a single pass cannot apply them. Instead, joint counts
of the distinct values are stored and converted to bins, activity or ranks at the end. The result
equals that of two passes if sensors have few distinct values, such as 0 and 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.special import xlogy

from anisomap.defaults import DEFAULT_BINS
from anisomap.numerics.precision import Reals, float_type, row_blocks
from anisomap.numerics.similarity.binning import Recoding, ValueCounts, maximum_entropy_codes
from anisomap.numerics.similarity.co_occurrence import (
    CHUNK_FRAMES,
    MIN_COMPILED_SENSORS,
    Counts,
    Layout,
    joint_logarithms,
)
from anisomap.numerics.similarity.correlation import CoOccurrences

_MAX_COMPILED_CODES = 64  # of a sensor; joint counts of more would take too much memory


def mutual_information(readings: ArrayLike, bins: int = DEFAULT_BINS) -> Reals:
    """Compute the mutual information of the binned readings of every pair of sensors.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.
    bins : int
        Maximum number of maximum-entropy bins per sensor, b >= 2.

    Returns
    -------
    ndarray of shape (N, N)
        I(A; B) in nats, between 0 and min(H(A), H(B)), exactly symmetric. The diagonal contains
        the entropies, I(A; A) = H(A).

    Raises
    ------
    InputError
        If `bins` is less than 2.

    Notes
    -----
    McGregor et al. (2011), section "Information Theory". This is the plug-in estimate, without
    correction for the number of frames.
    """
    return information_from_codes(maximum_entropy_codes(readings, bins))


def information_from_codes(codes: ArrayLike) -> Reals:
    """Compute the mutual information of every pair of discrete series.

    Returns (N, N).

    With counts n over T frames, ``T I(A; B) = sum n_ab log n_ab - sum n_a log n_a
    - sum n_b log n_b + T log T``. Counts are exact integers.
    """
    values = np.asarray(codes)
    n_frames, n_sensors = values.shape
    n_codes = int(values.max()) + 1
    if n_sensors >= MIN_COMPILED_SENSORS and n_codes <= _MAX_COMPILED_CODES:
        joint = joint_logarithms(values, n_codes)
    else:
        joint = _joint_logarithms_by_products(values, n_codes)
    return information_from_logarithms(joint, n_frames)


def information_from_logarithms(joint: NDArray[np.float64], n_frames: int) -> Reals:
    """Compute the mutual information from the sums of n log n over joint counts.

    joint (N, N) -> (N, N).
    """
    # On the diagonal both codes are equal, so its entries are the marginal sums of n_a log n_a.
    marginal = np.diag(joint)
    entropy = (np.log(n_frames) - marginal / n_frames).clip(0)
    information = np.empty(joint.shape, float_type(len(joint)))
    for rows in row_blocks(len(joint)):
        shared = joint[rows] - np.add.outer(marginal[rows], marginal)
        shared /= n_frames
        shared += np.log(n_frames)
        # Rounding can exceed the bounds 0 <= I <= min(H, H) by about 1e-16.
        information[rows] = np.clip(shared, 0, np.minimum.outer(entropy[rows], entropy))
    np.fill_diagonal(information, entropy)
    return information


def _joint_logarithms_by_products(codes: NDArray[np.generic], n_codes: int) -> NDArray[np.float64]:
    """Sum n log n over joint counts, by one matrix product per pair of codes.

    Memory does not grow with the number of codes.
    """
    joint = np.zeros((codes.shape[1],) * 2)
    for a in range(n_codes):
        counts = _count_pair(codes, a, a)
        joint += xlogy(counts, counts)
        for b in range(a + 1, n_codes):
            counts = _count_pair(codes, a, b)
            terms = xlogy(counts, counts)
            joint += terms + terms.T
    return joint


def _count_pair(codes: NDArray[np.generic], first: int, second: int) -> NDArray[np.float64]:
    """Count frames in which sensor i has the first code and sensor j the second, shape (N, N)."""
    n_sensors = codes.shape[1]
    counts = np.zeros((n_sensors, n_sensors))
    for start in range(0, len(codes), CHUNK_FRAMES):
        chunk = codes[start : start + CHUNK_FRAMES]
        # float32 products are fastest, and exact for counts of up to 2^24 frames.
        left = (chunk == first).astype(np.float32)
        right = left if first == second else (chunk == second).astype(np.float32)
        counts += left.T @ right
    return counts


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
