"""Rest value, direction of contact and noise threshold of each sensor."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.columns import ranked, transposed
from anisomap.numerics.precision import Floats, slices_of

_MIN_REST_SHARE = 0.1  # minimum share of frames at a rest value; chosen by hand
_NOISE_QUANTILE = 0.99  # of deviations opposite to contact, i.e. noise; 2.6 sigma if normal
_MIN_CONTACT_RATIO = 2.0  # of deviations on the side of contact to noise; chosen by hand
_MAX_EXACT_FRAMES = 2**23  # float32 represents half-integers up to it exactly
_CHUNK_FRAMES = 256  # frames processed at a time; intermediate arrays stay in the cache
_SENSORS_AT_ONCE = 32  # sensors sorted at a time
_RANKED_AT_ONCE = 1 << 15  # readings ranked at a time, which stay in the cache


@dataclass(frozen=True, eq=False)
class Rest:
    """Rest of each of N sensors, in units of the readings; arrays of shape (N,).

    value: Most frequent reading; the median of continuous readings.
    lean: 1 where the mean reading is above rest, -1 where it is below.
    noise: Largest deviation from rest to the side opposite to `lean`.
    known: Whether there is a rest: see `estimate_rest`.
    frequent: Whether one value occurs in `_MIN_REST_SHARE` of the frames, and in at least two.
    distinct: Number of distinct readings.
    """

    value: Floats
    lean: Floats
    noise: Floats
    known: NDArray[np.bool_]
    frequent: NDArray[np.bool_]
    distinct: NDArray[np.intp]

    @cached_property
    def side(self) -> Floats:
        """1 where contact raises the reading, -1 where it lowers it, shape (N,)."""
        return np.where(self.known, self.lean, 1.0)

    @cached_property
    def threshold(self) -> Floats:
        """Largest deviation from rest that is attributed to noise, shape (N,)."""
        return np.where(self.known, self.noise, 0.0)

    def select(self, sensors: NDArray[Any]) -> Rest:
        """Return the rest of some sensors, given as a mask or as indices."""
        return Rest(*(getattr(self, one.name)[sensors] for one in fields(self)))

    def depth(self, readings: ArrayLike) -> Floats:
        """Return the excess of readings over the threshold, shape (T, N); 0 at rest."""
        beyond = self.side * (np.asarray(readings, dtype=np.float64) - self.value) - self.threshold
        return np.asarray(np.maximum(beyond, 0))

    def active(self, readings: ArrayLike) -> NDArray[np.bool_]:
        """Return True for readings that exceed the threshold, shape (T, N)."""
        values = np.asarray(readings)
        active = np.empty(values.shape, dtype=bool)
        for start in range(0, len(values), _CHUNK_FRAMES):
            frames = slice(start, start + _CHUNK_FRAMES)
            beyond = self.side * np.subtract(values[frames], self.value, dtype=np.float64)
            active[frames] = beyond > self.threshold
        return active


def estimate_rest(readings: ArrayLike) -> Rest:
    """Estimate the rest of each sensor. readings (T, N).

    If the unit or the zero of a sensor's readings changes, `active` is invariant and `depth` is
    only scaled.

    Noise deviates to both sides of rest, contact only to one side. Contact is therefore on the side
    of the mean, and deviations to the opposite side measure noise. Continuous readings with about
    equal deviations to both sides, such as pixels of a camera, have no rest. Their readings above
    the median count as active.
    """
    values = np.asarray(readings)
    n_frames, n_sensors = values.shape
    found = [np.empty((6, 0))]  # of no sensors
    buffer = np.empty((min(n_sensors, _SENSORS_AT_ONCE), n_frames), values.dtype)
    for begin in range(0, n_sensors, _SENSORS_AT_ONCE):
        part = values[:, begin : begin + _SENSORS_AT_ONCE]
        rows = transposed(part, buffer)
        rows = rows.copy() if part.flags.f_contiguous else rows
        rows.sort(axis=1)
        found.append(_of_ordered(rows))
    value, lean, noise, known, frequent, distinct = np.concatenate(found, axis=1)
    return Rest(value, lean, noise, known > 0, frequent > 0, distinct.astype(np.intp))


def _of_ordered(ordered: NDArray[Any]) -> Floats:
    """Return the fields of `Rest`. ordered (n, T) -> (6, n)."""
    n_sensors, n_frames = ordered.shape
    least = math.ceil(_least_frequent(n_frames))
    frequent = (ordered[:, least - 1 :] == ordered[:, : max(0, n_frames - least + 1)]).any(axis=1)
    changes = ordered[:, 1:] != ordered[:, :-1]
    found = np.ones((6, n_sensors))
    found[4], found[5] = frequent, 1 + np.count_nonzero(changes, axis=1)
    at_lowest = ordered[:, n_frames // 2] == ordered[:, 0]
    found[0], found[2] = ordered[:, 0], 0
    for i in np.flatnonzero(frequent & ~at_lowest).tolist():
        ends = np.append(np.flatnonzero(changes[i]), n_frames - 1)
        values = ordered[i, ends].astype(np.float64)
        found[:, i] = _rest_of(values, np.diff(ends, prepend=-1))
    continuous = np.flatnonzero(~(frequent | at_lowest))
    if continuous.size:
        found[:4, continuous] = _of_continuous(ordered[continuous])
    return found


def _of_continuous(ordered: NDArray[Any]) -> Floats:
    """Return the rest of sensors without a frequent reading. ordered (n, T) -> (4, n)."""
    n_sensors, n_frames = ordered.shape
    if ordered.dtype.char not in "fd":
        ordered = ordered.astype(np.float64)
    frames = np.full(n_sensors, n_frames)
    value = _quantile(ordered, frames, 0.5, first=0, origin=np.zeros(n_sensors))
    n_below = np.count_nonzero(ordered <= value[:, None], axis=1)
    n_least = np.count_nonzero(ordered < value[:, None], axis=1)
    downwards = -_quantile(
        ordered, n_below, _NOISE_QUANTILE, first=n_below - 1, step=-1, origin=value
    )
    upwards = _quantile(ordered, frames - n_least, _NOISE_QUANTILE, first=n_least, origin=value)
    total = ordered.sum(axis=1, dtype=np.float64) - n_frames * value
    falls = total < 0
    noise, contact = np.where(falls, (upwards, downwards), (downwards, upwards))
    known = contact >= _MIN_CONTACT_RATIO * noise
    return np.stack([value, np.where(falls, -1.0, 1.0), noise, known])


def _quantile(
    ordered: NDArray[Any],
    counts: NDArray[np.intp],
    level: float,
    *,
    first: Any,
    step: int = 1,
    origin: Floats,
) -> Floats:
    """Return a quantile of `counts` readings of each sensor, from `first` on, minus an origin.

    ordered (n, T), counts, origin (n,) -> (n,).
    """
    place = level * (counts - 1)
    below = place.astype(np.intp)
    rows, next_one = np.arange(len(ordered)), np.minimum(below + 1, counts - 1)
    low, high = (ordered[rows, first + step * at] - origin for at in (below, next_one))
    return np.asarray(low + (place - below) * (high - low))


def _least_frequent(n_frames: int) -> float:
    """Return the minimum number of frames in which a frequent reading occurs."""
    return max(2.0, _MIN_REST_SHARE * n_frames)


def ranks_of_depths(
    readings: ArrayLike, rest: Rest | None = None, *, single: bool = False, alike: bool = True
) -> NDArray[Any]:
    """Rank the readings of each sensor by depth beyond rest; readings at rest share a rank.

    readings (T, N) -> (T, N), of float32 if `single` and the frames are few enough.

    If `alike`, rest is used for all sensors if most have a rest, and for none otherwise. Near the
    level of noise at which rest is no longer recognised, some sensors would otherwise have ranks of
    deep contacts only, and others also of noise; the map would show this difference. Ranks increase
    with readings, so that rank correlations have the sign of Pearson's r.
    """
    values = np.asarray(readings)
    rest = estimate_rest(values) if rest is None else rest
    dtype = np.float32 if single and len(values) <= _MAX_EXACT_FRAMES else np.float64
    if alike and 2 * np.count_nonzero(rest.known) < rest.known.size:
        return ranked(values).astype(dtype, copy=False)
    if alike:
        rest = replace(rest, known=np.ones_like(rest.known))
    ranks = np.empty(values.shape[::-1], dtype)
    by_sensor, at_once = transposed(values), max(1, _RANKED_AT_ONCE // max(1, len(values)))
    for some in slices_of(len(ranks), at_once):
        rows = by_sensor[some]
        value, side, limit = (x[some, None] for x in (rest.value, rest.side, rest.threshold))
        active = side * np.subtract(rows, value, dtype=np.float64) > limit
        n_active, raised = np.count_nonzero(active, axis=1), side[:, 0] > 0
        n_resting, before = len(values) - n_active, np.cumsum(n_active) - n_active
        ranks[some] = ((n_resting + 1) / 2 + np.where(raised, 0, n_active))[:, None]
        # Sort by readings first, then by sensors, of which there are few.
        place = np.flatnonzero(active)
        reached = rows.ravel()[place]
        sensor = np.repeat(np.arange(len(rows), dtype=np.int16), n_active)
        order = reached.argsort()
        if len(rows) > 1:
            order = order[sensor[order].argsort(kind="stable")]
        ordered = reached[order]
        differs = np.append(True, ordered[1:] != ordered[:-1])[: order.size]
        differs[before[n_active > 0]] = True
        first = np.flatnonzero(differs)
        counts = np.diff(first, append=order.size)
        # Where contact lowers the readings of a sensor, those at rest have the highest ranks.
        below = np.where(raised, n_resting, 0) - before
        mean = first + (counts + 1) / 2 + below[sensor[first]]
        ranks[some].ravel()[place[order]] = np.repeat(mean, counts)
    return ranks.T


def rest_from_counts(
    values_and_counts: Iterable[tuple[NDArray[Any], NDArray[np.integer[Any]]]],
) -> Rest:
    """Estimate the rest of each sensor from the counts of its values."""
    found = [_rest_of(values.astype(np.float64), counts) for values, counts in values_and_counts]
    value, lean, noise, known, frequent, distinct = np.array(found).T
    return Rest(value, lean, noise, known > 0, frequent > 0, distinct.astype(np.intp))


def quantile_from_counts(values: Floats, counts: NDArray[np.integer[Any]], level: float) -> float:
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


def _rest_of(values: Floats, counts: NDArray[np.integer[Any]]) -> tuple[float, ...]:
    """Return the fields of `Rest` of a sensor, from its distinct values in increasing order."""
    n_frames = int(counts.sum())
    rests = counts.max() >= _least_frequent(n_frames)
    value = values[counts.argmax()] if rests else quantile_from_counts(values, counts, 0.5)
    side = -1.0 if (counts * (values - value)).sum() < 0 else 1.0
    beyond = side * (values - value)
    quiet, touched = beyond <= 0, beyond >= 0
    noise = quantile_from_counts(-beyond[quiet], counts[quiet], _NOISE_QUANTILE)
    contact = quantile_from_counts(beyond[touched], counts[touched], _NOISE_QUANTILE)
    known = rests or contact >= _MIN_CONTACT_RATIO * noise
    return float(value), side, noise, known, rests, values.size
