"""Counts of the distinct values of each sensor, from which bins, rest and ranks are computed.

Counts of chunks of frames can be merged in any order. A sensor with continuous readings has as many
values as frames; above a limit, values are rounded by as many bits as needed. The result does not
depend on the chunks or their order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.columns import columns, count_values
from anisomap.numerics.similarity.binning import maximum_entropy_bins

MAX_VALUES = 1 << 24
"""Maximum number of values of all sensors together: 256 MiB of values and counts."""

_CHUNK_FRAMES = 256  # frames processed at a time; intermediate arrays stay in the cache
_MIN_VALUES = 256  # minimum of the limit per sensor, for any number of sensors
_MAGNITUDE = np.int64(np.iinfo(np.int64).max)  # mask of all bits but the sign


@dataclass(frozen=True, eq=False)
class ValueCounts:
    """Distinct values of each of N sensors, and their numbers of occurrences.

    n_frames: T.
    values: Distinct values of each sensor in increasing order; values rounded to the same number
        are represented by the smallest of them.
    counts: Number of occurrences of each value.
    n_rounded_bits: Number of bits rounded off the float64 values of each sensor; 0 if exact.
    max_values: Maximum number of values per sensor.
    """

    n_frames: int
    values: tuple[NDArray[np.float64], ...]
    counts: tuple[NDArray[np.int64], ...]
    n_rounded_bits: NDArray[np.int64]
    max_values: int

    @classmethod
    def of(cls, readings: ArrayLike, max_values: int | None = None) -> ValueCounts:
        """Count the values in an array. readings (T, N)."""
        array = np.asarray(readings)
        limit = max_values or max(_MIN_VALUES, MAX_VALUES // array.shape[1])
        found = [_round_to(*count_values(column), 0, limit) for column in columns(array)]
        values, counts, n_rounded_bits = zip(*found, strict=True)
        return cls(len(array), values, counts, np.array(n_rounded_bits), limit)

    def merged(self, other: ValueCounts) -> ValueCounts:
        """Merge with the counts of other frames of the same sensors, with the same limit.

        The order of merging does not affect the result.
        """
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
        """Return which sensors vary, shape (N,)."""
        return np.array([values.size > 1 for values in self.values])

    def bins(self, bins: int) -> Recoding:
        """Return the maximum-entropy bin of every value."""
        return self._recode(lambda _, counts: maximum_entropy_bins(counts, bins), np.uint16)

    def ranks(self) -> Recoding:
        """Return the mean rank of every value, from 1 to T."""
        return self._recode(lambda _, counts: np.cumsum(counts) - (counts - 1) / 2, np.float64)

    def _recode(
        self, outcome: Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]], dtype: type
    ) -> Recoding:
        pairs = zip(self.values, self.counts, strict=True)
        return Recoding.of(self.values, [outcome(*pair) for pair in pairs], dtype)


@dataclass(frozen=True, eq=False)
class Recoding:
    """Step function of the readings of each of N sensors.

    starts: Readings of each sensor at which the next outcome begins, in increasing order.
    outcomes: Outcomes of each sensor; one more than `starts`.
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
        """Assign outcomes to increasing values; readings between two values take the lower's."""
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
        """Recode one-byte readings by a table of all 256 values."""
        every = np.arange(256, dtype=np.uint8).view(array.dtype)
        table = np.concatenate([self._of_sensor(i, every) for i in range(array.shape[1])])
        offsets = 256 * np.arange(array.shape[1])
        for start in range(0, len(array), _CHUNK_FRAMES):
            frames = slice(start, start + _CHUNK_FRAMES)
            table.take(array[frames].view(np.uint8) + offsets, out=recoded[frames], mode="clip")

    def _of_sensor(self, sensor: int, column: NDArray[Any]) -> NDArray[Any]:
        where = np.searchsorted(self.starts[sensor], column.astype(np.float64), side="right")
        return np.asarray(self.outcomes[sensor][where])


def _is_byte(dtype: np.dtype[Any]) -> bool:
    return dtype.kind in "biu" and dtype.itemsize == 1


def _round_to(
    values: NDArray[Any], counts: NDArray[np.int64], n_bits: int, max_values: int
) -> tuple[NDArray[np.float64], NDArray[np.int64], int]:
    """Round values by `n_bits` or more bits, until at most `max_values` are distinct."""
    order = np.argsort(values, kind="stable")
    sorted_values, weights = values[order].astype(np.float64) + 0.0, counts[order]
    keys = _ordered_integers(sorted_values) >> n_bits
    begins = _run_starts(keys)
    while begins.size > max_values:
        n_bits += 1
        keys >>= 1
        begins = _run_starts(keys)
    return sorted_values[begins], np.add.reduceat(weights, begins), n_bits


def _run_starts(keys: NDArray[np.int64]) -> NDArray[np.intp]:
    return np.flatnonzero(np.concatenate([[True], keys[1:] != keys[:-1]]))


def _ordered_integers(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Reinterpret the bits of floats as integers in the same order."""
    bits = values.view(np.int64)
    return np.asarray(np.where(bits < 0, bits ^ _MAGNITUDE, bits))
