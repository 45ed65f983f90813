"""Rest value, direction of contact and noise threshold of each sensor."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.columns import columns, mean_ranks, transposed
from anisomap.numerics.precision import Floats

_MIN_REST_SHARE = 0.1  # of the frames at one value for this value to be the rest; chosen by hand
_NOISE_QUANTILE = 0.99  # of deviations opposite to contact that count as noise; 2.6 sigma if normal
_MIN_CONTACT_RATIO = 2.0  # of deviations on the side of contact to noise; chosen by hand
_MAX_EXACT_FRAMES = 2**23  # halves up to it are exact in float32
_CHUNK_FRAMES = 256  # frames processed at a time; intermediate arrays stay in the cache
_SENSORS_AT_ONCE = 32  # whose readings are sorted
_MAX_SORTED = 8192  # frames; of more, a sample tells which are near a quantile
_SAMPLED = 4096  # random frames of the sample
_WIDTHS = 3.0  # standard deviations by which ranks in the sample may be off; else all are sorted


@dataclass(frozen=True, eq=False)
class Rest:
    """Rest of each of N sensors, in units of the readings; arrays of shape (N,).

    value: Most frequent reading; the median of continuous readings.
    lean: 1 where the mean reading is above rest, -1 where it is below.
    noise: Largest deviation from rest to the other side.
    known: Whether there is a rest: see `estimate_rest`.
    frequent: Whether one value holds `_MIN_REST_SHARE` of the frames, and at least two frames.
    distinct: Number of distinct readings, of a sample of very many.
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
        if values.dtype.char in "fd":
            bounds, lowered = self.bounds(values.dtype), np.flatnonzero(self.side < 0)
            active = values >= bounds
            if lowered.size:
                active[:, lowered] = values[:, lowered] <= bounds[lowered]
            return np.asarray(active)
        active = np.empty(values.shape, dtype=bool)
        for start in range(0, len(values), _CHUNK_FRAMES):
            frames = slice(start, start + _CHUNK_FRAMES)
            active[frames] = self.depth(values[frames]) > 0
        return active

    def bounds(self, dtype: np.dtype[Any]) -> NDArray[Any]:
        """Return the number of a type nearest to rest that has a depth above 0, shape (N,)."""
        # Subtractions of all readings, in float64, would take ten times as long as comparisons.
        rest = self.side * self.value
        reach = rest + self.threshold

        def deep(numbers: NDArray[Any], some: Any = slice(None)) -> NDArray[np.bool_]:
            return np.asarray(numbers.astype(np.float64) - rest[some] > self.threshold[some])

        def beside(numbers: Floats, step: float) -> NDArray[Any]:
            return np.asarray(np.nextafter(numbers.astype(dtype), dtype.type(step)))

        with np.errstate(over="ignore"):
            near, high = reach.astype(dtype), beside(reach, np.inf)
            bounds = np.where(deep(near), near, high)
            # Near 0, numbers are far finer than differences from rest: bisect for the bound.
            off = np.flatnonzero(deep(beside(reach, -np.inf)) | ~deep(high))
            slack = 4 * np.spacing(np.abs(rest) + self.threshold)[off]
            low, high = beside(reach[off] - slack, -np.inf), beside(reach[off] + slack, np.inf)
            while (apart := (low < (middle := low + (high - low) / 2)) & (middle < high)).any():
                beyond = deep(middle, off)
                low, high = (
                    np.where(apart & ~beyond, middle, low),
                    np.where(apart & beyond, middle, high),
                )
            bounds[off] = high
        return np.asarray(self.side.astype(dtype) * bounds)


def estimate_rest(readings: ArrayLike) -> Rest:
    """Estimate the rest of each sensor. readings (T, N).

    Under a change of the unit or the zero of a sensor's readings, `active` is invariant and `depth`
    only scales.

    Noise deviates to both sides of rest, contact only to one. Contact is therefore on the side of
    the mean, and deviations to the other side measure noise. Continuous readings with about equal
    deviations to both sides, such as pixels of a camera, have no rest: readings above the median
    count as active.
    """
    values = np.asarray(readings)
    n_frames, n_sensors = values.shape
    found = [np.empty((6, 0))]  # of no sensors
    frames = None
    if n_frames > _MAX_SORTED:
        # At random, not at equal steps: these could all have the same phase.
        chosen = np.random.default_rng(0).choice(n_frames, _SAMPLED, replace=False)
        frames = np.sort(chosen)
    buffer = np.empty((min(n_sensors, _SENSORS_AT_ONCE), n_frames), values.dtype)
    for begin in range(0, n_sensors, _SENSORS_AT_ONCE):
        part = values[:, begin : begin + _SENSORS_AT_ONCE]
        rows = transposed(part, buffer)
        if frames is None:
            rows = rows.copy() if part.flags.f_contiguous else rows
            rows.sort(axis=1)
            found.append(_of_ordered(rows))
        else:
            found.append(_of_many(rows, np.sort(rows[:, frames], axis=1)))
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
    # Comparisons in the type of the readings are several times as fast as those in float64.
    near, infinity = value.astype(ordered.dtype), ordered.dtype.type(np.inf)
    lower = np.where(near > value, np.nextafter(near, -infinity), near)
    upper = np.where(near < value, np.nextafter(near, infinity), near)
    n_below = np.count_nonzero(ordered <= lower[:, None], axis=1)
    n_least = np.count_nonzero(ordered < upper[:, None], axis=1)
    downwards = -_quantile(
        ordered, n_below, _NOISE_QUANTILE, first=n_below - 1, step=-1, origin=value
    )
    upwards = _quantile(ordered, frames - n_least, _NOISE_QUANTILE, first=n_least, origin=value)
    total = ordered.sum(axis=1, dtype=np.float64) - n_frames * value
    return _of_deviations(value, total, downwards, upwards)


def _quantile(
    ordered: NDArray[Any],
    counts: NDArray[np.intp],
    level: float,
    *,
    first: Any,
    step: int = 1,
    origin: Floats,
) -> Floats:
    """Return a quantile of `counts` readings of each sensor, from `first` on, less an origin.

    ordered (n, T), counts, origin (n,) -> (n,).
    """
    place = level * (counts - 1)
    below = place.astype(np.intp)
    rows, next_one = np.arange(len(ordered)), np.minimum(below + 1, counts - 1)
    low, high = (ordered[rows, first + step * at] - origin for at in (below, next_one))
    return np.asarray(low + (place - below) * (high - low))


def _of_deviations(value: Floats, total: Floats, downwards: Floats, upwards: Floats) -> Floats:
    """Return the rest of sensors from their medians, and from deviations from these, (4, n).

    total: Sums of all deviations. downwards, upwards: Quantiles of those to either side.
    """
    falls = total < 0
    noise, contact = np.where(falls, (upwards, downwards), (downwards, upwards))
    known = contact >= _MIN_CONTACT_RATIO * noise
    return np.stack([value, np.where(falls, -1.0, 1.0), noise, known])


def _of_many(rows: NDArray[Any], ordered: NDArray[Any]) -> Floats:
    """Return the fields of `Rest` of sensors with many frames, (n, T) -> (6, n).

    ordered (n, t): Readings in random frames, ordered.
    """
    found = np.zeros((6, len(rows)))
    some = math.ceil(_MIN_REST_SHARE / 2 * ordered.shape[1])
    perhaps_frequent = (ordered[:, some:] == ordered[:, :-some]).any(axis=1)
    selected: dict[int, tuple[float, ...]] = {}
    for i, row in enumerate(rows):
        quantiles = None if perhaps_frequent[i] else _selected(row, ordered[i])
        if quantiles is not None:
            selected[i] = quantiles
            continue
        values, counts = np.unique(row, return_counts=True)
        found[:, i] = _rest_of(values.astype(np.float64), counts)
    if selected:
        chosen = list(selected)
        found[:4, chosen] = _of_deviations(*np.array(list(selected.values())).T)
        found[5, chosen] = 1 + np.count_nonzero(ordered[chosen, 1:] != ordered[chosen, :-1], axis=1)
    return found


def _selected(row: NDArray[Any], ordered: NDArray[Any]) -> tuple[float, ...] | None:
    """Return the arguments of `_of_deviations` for a sensor; None if the sample misleads.

    row (T,). ordered (t,): A sample, whose quantiles should enclose those of all readings.
    """
    n_frames, size = row.size, ordered.size

    def enclosed(share: float) -> int:
        return math.ceil(size * share + _WIDTHS * math.sqrt(size * share))

    width, tail = enclosed(0.25) - size // 4, enclosed((1 - _NOISE_QUANTILE) / 2)
    low, high = ordered[size // 2 - width], ordered[size // 2 + width]
    n_lower = np.count_nonzero(row < low)
    middle = np.sort(row[(row >= low) & (row <= high)]).astype(np.float64)
    place = (n_frames - 1) / 2
    at = int(place) - n_lower
    if not 0 <= at < middle.size - 1:
        return None
    value = middle[at] + (place - int(place)) * (middle[at + 1] - middle[at])
    n_below, n_least = (n_lower + middle.searchsorted(value, side) for side in ("right", "left"))
    lowest, highest = row[row <= ordered[tail]], row[row >= ordered[-1 - tail]]
    ends = lowest, -highest.astype(np.float64)  # unsigned integers have no negative
    outer = []
    for end, centre, count in zip(
        ends, (value, -value), (n_below, n_frames - n_least), strict=True
    ):
        place = _NOISE_QUANTILE * (count - 1)
        at = count - 1 - int(place)
        if at >= end.size:
            return None
        near, far = centre - np.sort(end)[[at, max(at - 1, 0)]].astype(np.float64)
        outer.append(near + (place - int(place)) * (far - near))
    total = np.subtract(row, value, dtype=np.float64).sum()
    return value, total, *outer


def _least_frequent(n_frames: int) -> float:
    """Return the minimum number of frames in which a frequent reading occurs."""
    return max(2.0, _MIN_REST_SHARE * n_frames)


def ranks_of_depths(
    readings: ArrayLike, rest: Rest | None = None, *, single: bool = False, alike: bool = True
) -> NDArray[Any]:
    """Rank the readings of each sensor by their depth beyond rest; all at rest share a rank.

    readings (T, N) -> (T, N), of float32 if `single` and the frames are few enough.

    If `alike`, a rest counts for all sensors if most have one, and for none otherwise: near the
    noise at which rest is no longer recognised, ranks of some sensors would be of deep contacts
    alone, and those of others of noise, too, and the map would show that difference. The ranks
    increase with the reading, so that they have the sign of Pearson's r.
    """
    values = np.asarray(readings)
    rest = estimate_rest(values) if rest is None else rest
    dtype = np.float32 if single and len(values) <= _MAX_EXACT_FRAMES else np.float64
    ranks = np.empty(values.shape[::-1], dtype)
    if values.dtype.char not in "fd":
        values = values.astype(np.float64)
    if alike and 2 * np.count_nonzero(rest.known) < rest.known.size:
        for row, column in zip(ranks, columns(values), strict=True):
            row[:] = mean_ranks(column)
        return ranks.T
    if alike:
        rest = replace(rest, known=np.ones_like(rest.known))
    own = zip(ranks, columns(values), rest.bounds(values.dtype), rest.side > 0, strict=True)
    for row, column, bound, raises in own:
        active = np.flatnonzero(column >= bound if raises else column <= bound)
        n_resting = column.size - active.size
        row.fill((n_resting + 1) / 2 + (0 if raises else active.size))
        row[active] = (n_resting if raises else 0) + mean_ranks(column[active])
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
