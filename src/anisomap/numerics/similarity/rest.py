"""Rest value, direction of contact and noise threshold of each sensor."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.columns import columns, mean_ranks
from anisomap.numerics.compiled.parallel import MIN_COMPILED_ROWS, load_loops

MIN_REST_SHARE = 0.1
"""Minimum share of the frames at one value for this value to be the rest; chosen by hand."""

NOISE_QUANTILE = 0.99
"""Quantile of the deviations opposite to contact that counts as noise; 2.6 sigma if normal."""

MIN_CONTACT_RATIO = 2.0
"""Minimum ratio of the deviations on the side of contact to noise; chosen by hand."""

_MAX_EXACT_FRAMES = 2**23  # halves up to it are exact in float32
_CHUNK_FRAMES = 256  # frames processed at a time; intermediate arrays stay in the cache


@dataclass(frozen=True, eq=False)
class Rest:
    """Rest of each of N sensors, in units of the readings.

    value (N,): Most frequent reading; the median of continuous readings.
    side (N,): 1 where contact raises the reading, -1 where it lowers it, as in raw capacitive
        skins.
    threshold (N,): Largest deviation from rest that is attributed to noise. 0 without readings on
        the side of rest opposite to contact, and for sensors without a rest value.
    known: False for sensors without a rest value: see `estimate_rest`.
    """

    value: NDArray[np.float64]
    side: NDArray[np.float64]
    threshold: NDArray[np.float64]
    known: NDArray[np.bool_]

    def select(self, sensors: NDArray[Any]) -> Rest:
        """Return the rest of some sensors, given as a mask or as indices."""
        chosen = (self.value, self.side, self.threshold, self.known)
        return Rest(*(one[sensors] for one in chosen))

    def depth(self, readings: ArrayLike) -> NDArray[np.float64]:
        """Return the excess of readings over the threshold, shape (T, N); 0 at rest."""
        beyond = self.side * (np.asarray(readings, dtype=np.float64) - self.value) - self.threshold
        return np.asarray(np.maximum(beyond, 0))

    def active(self, readings: ArrayLike) -> NDArray[np.bool_]:
        """Return True for readings that exceed the threshold, shape (T, N)."""
        values = np.asarray(readings)
        active = np.empty(values.shape, dtype=bool)
        if _is_compiled(values):
            own = self.value, self.side, self.threshold
            load_loops("similarity").find_active(values, own, active)
            return active
        for start in range(0, len(values), _CHUNK_FRAMES):
            frames = slice(start, start + _CHUNK_FRAMES)
            active[frames] = self.depth(values[frames]) > 0
        return active


def estimate_rest(readings: ArrayLike) -> Rest:
    """Estimate the rest of each sensor.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.

    Returns
    -------
    Rest
        Under a change of the unit or the zero of a sensor's readings, `active` is invariant and
        `depth` only scales.

    Notes
    -----
    Noise deviates to both sides of rest, contact only to one. Contact is therefore on the side of
    the mean, and deviations to the other side measure noise. Continuous readings with about equal
    deviations to both sides, such as pixels of a camera, have no rest: readings above the median
    count as active.
    """
    values = np.asarray(readings)
    lowest = values.min(axis=0)
    counts = np.count_nonzero(values == lowest, axis=0)
    n_sensors = len(lowest)
    rest = Rest(
        value=lowest.astype(np.float64),
        side=np.ones(n_sensors),
        threshold=np.zeros(n_sensors),
        known=np.ones(n_sensors, dtype=bool),
    )
    # At the lowest reading in most frames: contact raises, and no reading is on the other side.
    other = np.flatnonzero(2 * counts <= len(values))
    if len(other):
        several = values[:, other]
        found = rest_from_counts(np.unique(one, return_counts=True) for one in columns(several))
        rest.value[other], rest.side[other] = found.value, found.side
        rest.threshold[other], rest.known[other] = found.threshold, found.known
    return rest


def _is_compiled(readings: NDArray[Any]) -> bool:
    """Return whether compiled loops are used: for many sensors, and types that they support.

    They go from frame to frame, which is slow in arrays that are contiguous by column.
    """
    number = readings.dtype.isnative and readings.dtype.char in "bBhHiIlLqQfd"
    return number and readings.shape[1] >= MIN_COMPILED_ROWS and not readings.flags.f_contiguous


def ranks_of_depths(
    readings: ArrayLike, rest: Rest | None = None, *, single: bool = False
) -> NDArray[Any]:
    """Rank the readings of each sensor by their depth beyond rest; all at rest share a rank.

    readings (T, N) -> (T, N), of float32 if `single` and the frames are few enough.
    """
    values = np.asarray(readings)
    rest = estimate_rest(values) if rest is None else rest
    dtype = np.float32 if single and len(values) <= _MAX_EXACT_FRAMES else np.float64
    ranks = np.empty(values.shape[::-1], dtype)
    own = zip(ranks, columns(values), rest.value, rest.side, rest.threshold, strict=True)
    for row, column, value, side, threshold in own:
        depth = side * (column.astype(np.float64) - value) - threshold
        active = np.flatnonzero(depth > 0)
        n_resting = len(depth) - len(active)
        row.fill((n_resting + 1) / 2)
        row[active] = n_resting + mean_ranks(depth[active])
    return ranks.T


def rest_from_counts(
    values_and_counts: Iterable[tuple[NDArray[Any], NDArray[np.integer[Any]]]],
) -> Rest:
    """Estimate the rest of each sensor from the counts of its values."""
    found = [_rest_of(values.astype(np.float64), counts) for values, counts in values_and_counts]
    value, side, threshold, known = np.array(found).T
    return Rest(value=value, side=side, threshold=threshold, known=known > 0)


def quantile_from_counts(
    values: NDArray[np.float64], counts: NDArray[np.integer[Any]], level: float
) -> float:
    """Return a quantile of repeated values, interpolated linearly as by `numpy.quantile`.

    The values are distinct, in increasing or decreasing order.
    """
    if values[0] > values[-1]:
        values, counts = values[::-1], counts[::-1]
    ends = counts.cumsum()
    place = level * (int(ends[-1]) - 1)
    below = int(place)
    at = ends.searchsorted([below, min(below + 1, int(ends[-1]) - 1)], side="right")
    low, high = values[at]
    return float(low + (place - below) * (high - low))


def _rest_of(
    values: NDArray[np.float64], counts: NDArray[np.integer[Any]]
) -> tuple[float, float, float, bool]:
    """Return the rest value, the side of contact, the threshold, and whether there is a rest."""
    n_frames = int(counts.sum())
    rests = counts.max() >= max(2, MIN_REST_SHARE * n_frames)
    value = values[counts.argmax()] if rests else quantile_from_counts(values, counts, 0.5)
    side = -1.0 if (counts * (values - value)).sum() < 0 else 1.0
    beyond = side * (values - value)
    quiet, touched = beyond <= 0, beyond >= 0
    noise = quantile_from_counts(-beyond[quiet], counts[quiet], NOISE_QUANTILE)
    contact = quantile_from_counts(beyond[touched], counts[touched], NOISE_QUANTILE)
    if not rests and contact < MIN_CONTACT_RATIO * noise:
        return float(value), 1.0, 0.0, False
    return float(value), side, noise, True
