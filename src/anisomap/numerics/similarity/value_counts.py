"""Which values every sensor read, and how often: what bins, rests and ranks are made from.

Counts of values add, so that they can be taken in chunks of frames, in any order. A sensor whose
readings are continuous has as many values as frames; beyond a bound its values are rounded, always
by as little as keeps the bound, so that chunks and their order do not matter even then.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.similarity.binning import maximum_entropy_bins

MAX_VALUES = 1 << 24
"""Values that are kept of all sensors together: 256 MiB."""

_CHUNK_FRAMES = 256  # what is worked out on the way stays in the processor's cache
_FEWEST_VALUES = 256  # of one sensor, however many sensors there are
_MAGNITUDE = np.int64(np.iinfo(np.int64).max)


@dataclass(frozen=True, eq=False)
class ValueCounts:
    """How often each of N sensors read each value.

    Attributes
    ----------
    n_frames : int
        How many frames they are of, T.
    values : tuple of ndarray
        For each sensor its distinct values in increasing order; if rounded, the least of those
        that are taken for one.
    counts : tuple of ndarray of int
        How often each occurred.
    grains : ndarray of int, shape (N,)
        How many bits of a sensor's values, as float64, were rounded off: 0 is exact.
    most : int
        How many values a sensor may have before they are rounded.
    """

    n_frames: int
    values: tuple[NDArray[np.float64], ...]
    counts: tuple[NDArray[np.int64], ...]
    grains: NDArray[np.int64]
    most: int

    @classmethod
    def of(cls, readings: ArrayLike, most: int | None = None) -> ValueCounts:
        """Count the values in an array.

        Parameters
        ----------
        readings : array_like of shape (T, N)
            Finite readings, T >= 1.
        most : int, optional
            How many values, at least 2, a sensor may have before they are rounded; `MAX_VALUES`
            shared out equally unless given.

        Returns
        -------
        ValueCounts
        """
        array = np.asarray(readings)
        bound = most or max(_FEWEST_VALUES, MAX_VALUES // array.shape[1])
        found = [_bounded(*distinct(column), 0, bound) for column in array.T]
        values, counts, grains = zip(*found, strict=True)
        return cls(len(array), values, counts, np.array(grains), bound)

    def merged(self, other: ValueCounts) -> ValueCounts:
        """Join the counts of two disjoint sets of frames of the same sensors.

        Parameters
        ----------
        other : ValueCounts
            Of the same N sensors, with the same bound.

        Returns
        -------
        ValueCounts
            Of all frames; the order of merging does not matter at all.
        """
        grains = np.maximum(self.grains, other.grains)
        found = [
            _bounded(np.concatenate([a, b]), np.concatenate([m, n]), int(grain), self.most)
            for a, b, m, n, grain in zip(
                self.values, other.values, self.counts, other.counts, grains, strict=True
            )
        ]
        values, counts, settled = zip(*found, strict=True)
        return ValueCounts(
            self.n_frames + other.n_frames, values, counts, np.array(settled), self.most
        )

    @property
    def n_sensors(self) -> int:
        """Number of sensors, N."""
        return len(self.values)

    @property
    def exact(self) -> bool:
        """Whether no value was rounded."""
        return not self.grains.any()

    def varying(self) -> NDArray[np.bool_]:
        """Tell which sensors ever varied, shape (N,)."""
        return np.array([values.size > 1 for values in self.values])

    def bins(self, bins: int) -> Recoding:
        """Give every value the number of its maximum-entropy bin."""
        return self._recoded(lambda _, counts: maximum_entropy_bins(counts, bins), np.uint16)

    def ranks(self) -> Recoding:
        """Give every value the mean of its ranks, from 1 to T."""
        return self._recoded(lambda _, counts: np.cumsum(counts) - (counts - 1) / 2, np.float64)

    def _recoded(
        self, outcome: Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]], dtype: type
    ) -> Recoding:
        pairs = zip(self.values, self.counts, strict=True)
        return Recoding.of(self.values, [outcome(*pair) for pair in pairs], dtype)


@dataclass(frozen=True, eq=False)
class Recoding:
    """What to replace the readings of N sensors by.

    Attributes
    ----------
    starts : tuple of ndarray
        For each sensor, in increasing order, the values from which on the next outcome holds;
        below all of them the first does.
    outcomes : tuple of ndarray
        One more for each sensor than `starts`.
    """

    starts: tuple[NDArray[np.float64], ...]
    outcomes: tuple[NDArray[Any], ...]

    @classmethod
    def of(
        cls,
        values: Iterable[NDArray[np.float64]],
        outcomes: Iterable[NDArray[Any]],
        dtype: type,
    ) -> Recoding:
        """Recode sorted values by an outcome each; what lies between two goes with the lower."""
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
        if _is_byte(array.dtype):
            self._look_up(array, recoded)
            return recoded
        for sensor, column in enumerate(array.T):
            recoded[:, sensor] = self._of_sensor(sensor, column)
        return recoded

    def _look_up(self, array: NDArray[Any], recoded: NDArray[Any]) -> None:
        """Recode readings of which there are no more than 256, by a table of all of them."""
        every = np.arange(256, dtype=np.uint8).view(array.dtype)
        table = np.concatenate([self._of_sensor(i, every) for i in range(array.shape[1])])
        own = 256 * np.arange(array.shape[1])
        for start in range(0, len(array), _CHUNK_FRAMES):
            frames = slice(start, start + _CHUNK_FRAMES)
            table.take(array[frames].view(np.uint8) + own, out=recoded[frames], mode="clip")

    def _of_sensor(self, sensor: int, column: NDArray[Any]) -> NDArray[Any]:
        where = np.searchsorted(self.starts[sensor], column.astype(np.float64), side="right")
        return np.asarray(self.outcomes[sensor][where])


def distinct(column: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Find the distinct values of one sensor.

    Parameters
    ----------
    column : ndarray of shape (T,)
        Finite readings.

    Returns
    -------
    values : ndarray of shape (m,)
        In increasing order.
    counts : ndarray of int, shape (m,)
        How often each occurs.
    """
    if _is_byte(column.dtype):
        lowest = int(column.min())
        counts = np.bincount(column.astype(np.intp) - lowest)
        there = np.flatnonzero(counts)
        return (there + lowest).astype(np.float64), counts[there].astype(np.int64)
    values, counts = np.unique(column, return_counts=True)
    return values.astype(np.float64), counts.astype(np.int64)


def _is_byte(dtype: np.dtype[Any]) -> bool:
    return dtype.kind in "biu" and dtype.itemsize == 1


def _bounded(
    values: NDArray[np.float64], counts: NDArray[np.int64], grain: int, most: int
) -> tuple[NDArray[np.float64], NDArray[np.int64], int]:
    """Round values, at least by `grain` bits, until there are no more than `most` of them."""
    order = np.argsort(values, kind="stable")
    sorted_values, weights = values[order] + 0.0, counts[order]
    keys = _ordered(sorted_values) >> grain
    begins = _begins(keys)
    while begins.size > most:
        grain += 1
        keys >>= 1
        begins = _begins(keys)
    return sorted_values[begins], np.add.reduceat(weights, begins), grain


def _begins(keys: NDArray[np.int64]) -> NDArray[np.intp]:
    return np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))


def _ordered(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Turn floats into whole numbers of the same order."""
    bits = values.view(np.int64)
    return np.asarray(np.where(bits < 0, bits ^ _MAGNITUDE, bits))
