"""Statistics of complete readings that several analyses use, each computed once; excerpts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.columns import columns, count_values
from anisomap.numerics.similarity.rest import MIN_REST_SHARE, Rest, rest_from_counts

MAX_FRAMES = 4096
"""Consecutive frames of an excerpt; chosen by hand: statistics change little beyond."""

MAX_SENSORS = 256
"""Sensors of an excerpt; chosen by hand: matrices of all pairs then take milliseconds."""


class Signals:
    """Levels, rest and contacts of N sensors, computed when they are first asked for.

    readings (T, N): Finite.
    """

    def __init__(self, readings: NDArray[Any]) -> None:
        self.readings = readings

    @cached_property
    def _counted(self) -> tuple[Rest, NDArray[np.intp], NDArray[np.intp]]:
        """Rest, numbers of distinct readings, and frames at the extreme beyond rest."""
        ends: list[tuple[Any, ...]] = []

        def levels() -> Iterator[tuple[NDArray[np.float64], NDArray[np.int64]]]:
            for column in columns(self.readings):
                values, counts = count_values(column)
                ends.append((values.size, values[0], counts[0], values[-1], counts[-1]))
                yield values.astype(np.float64), counts

        rest = rest_from_counts(levels())
        distinct, lowest, at_lowest, highest, at_highest = np.array(ends, dtype=np.float64).T
        raises = rest.side > 0
        extreme = np.where(raises, highest, lowest)
        beyond = rest.side * (extreme - rest.value) > rest.threshold
        at_extreme = np.where(beyond, np.where(raises, at_highest, at_lowest), 0)
        return rest, distinct.astype(np.intp), at_extreme.astype(np.intp)

    @property
    def rest(self) -> Rest:
        """Rest of each sensor."""
        return self._counted[0]

    @property
    def distinct(self) -> NDArray[np.intp]:
        """Number of distinct readings of each sensor."""
        return self._counted[1]

    @property
    def at_extreme(self) -> NDArray[np.intp]:
        """Frames at the most extreme reading on the side of contact; 0 without contact."""
        return self._counted[2]

    @cached_property
    def active(self) -> NDArray[np.bool_]:
        """Whether readings are beyond rest, shape (T, N)."""
        return self.rest.active(self.readings)

    @cached_property
    def n_active(self) -> NDArray[np.intp]:
        """Frames beyond rest of each sensor."""
        return np.asarray(np.count_nonzero(self.active, axis=0))

    @cached_property
    def touched(self) -> NDArray[np.bool_]:
        """Whether readings are clearly beyond rest, at twice the threshold, shape (T, N).

        Normal noise exceeds it once in 8 million frames. Sensors without a rest among others that
        have one show noise alone.
        """
        rest = self.rest
        noisy = (rest.threshold > 0) | ~rest.known
        if not noisy.any() or 2 * np.count_nonzero(rest.known) < rest.known.size:
            return self.active
        return replace(rest, threshold=2 * rest.threshold).active(self.readings) & rest.known

    @cached_property
    def contacts(self) -> NDArray[np.intp]:
        """Separate contacts of each sensor: runs of frames clearly beyond rest."""
        return count_contacts(self.touched)

    @cached_property
    def never_at_rest(self) -> NDArray[np.intp]:
        """Sensors that no value occurs often in: a signal that is always there leaves none."""
        part = self.readings[middle_frames(len(self.readings))]
        limit = max(2, MIN_REST_SHARE * len(part))
        found = [
            i
            for i, column in enumerate(columns(part))
            # Most sensors rest at their lowest value.
            if np.count_nonzero(column == column.min()) < limit
            and count_values(column)[1].max() < limit
        ]
        return np.array(found, dtype=np.intp)

    def autocorrelation(self, *lags: int) -> NDArray[np.float64]:
        """Return the autocorrelation of each sensor at lags of at least 1, shape (lags, N)."""
        rows = map(unit_row, columns(self.readings))
        return np.array([[float(row[lag:] @ row[:-lag]) for lag in lags] for row in rows]).T


def count_contacts(active: ArrayLike) -> NDArray[np.intp]:
    """Count separate contacts of each sensor: runs of frames in which it is active."""
    on = np.asarray(active, dtype=bool)
    return np.asarray(on[:1].sum(axis=0) + np.count_nonzero(on[1:] > on[:-1], axis=0))


def count_joint_contacts(active: ArrayLike, pairs: ArrayLike) -> NDArray[np.intp]:
    """Count separate contacts of pairs of sensors: runs of frames in which both are active."""
    on = np.ascontiguousarray(np.asarray(active, dtype=bool).T)
    both = [count_contacts(on[i] & on[j]) for i, j in np.asarray(pairs, dtype=np.intp)]
    return np.array(both, dtype=np.intp)


def unit_row(column: NDArray[np.floating]) -> NDArray[np.float32]:
    """Scale the readings of one sensor, shape (T,), to mean 0 and norm 1; 0 if constant."""
    # Differences of float32 numbers are rounded relative to themselves.
    centred = column - column.mean(dtype=np.float64).astype(column.dtype)
    centred /= max(centred.max(), -centred.min()) or 1
    return np.asarray(centred / (np.sqrt(centred @ centred) or 1), dtype=np.float32)


def unit_rows(readings: NDArray[np.floating]) -> NDArray[np.float32]:
    """Scale every sensor to mean 0 and norm 1. readings (T, N) -> (N, T)."""
    rows = np.empty(readings.shape[::-1], dtype=np.float32)
    for column, row in zip(columns(readings), rows, strict=True):
        row[:] = unit_row(column)
    return rows


def standardised(readings: NDArray[Any]) -> NDArray[np.float32]:
    """Scale each sensor to mean 0 and variance 1; constant sensors become 0."""
    values = readings.astype(np.float32)
    values -= values.mean(axis=0)
    deviation = values.std(axis=0)
    values /= np.where(deviation > 0, deviation, 1)
    return values


def middle_frames(n_frames: int, most: int = MAX_FRAMES) -> slice:
    """Return consecutive frames from the middle of a recording."""
    start = max(0, (n_frames - most) // 2)
    return slice(start, start + most)


def some_sensors(n_sensors: int, most: int = MAX_SENSORS) -> NDArray[np.intp]:
    """Return evenly spaced indices of sensors."""
    return np.unique(np.linspace(0, n_sensors - 1, min(n_sensors, most)).astype(np.intp))


def deviation_from_median(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median absolute deviation of each column, shape (N,)."""
    return medians(np.abs(values - medians(values)))


def medians(values: NDArray[Any]) -> NDArray[Any]:
    """Return the median of each column, shape (N,); many times faster than `numpy.median`."""
    # Sorting contiguous rows is vectorised, partitioning is not.
    ordered = np.sort(np.ascontiguousarray(values.T), axis=1)
    middle = len(values) // 2
    if len(values) % 2:
        return np.asarray(ordered[:, middle])
    return np.asarray((ordered[:, middle - 1] + ordered[:, middle]) / 2)
