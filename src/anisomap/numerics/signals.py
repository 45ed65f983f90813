"""Statistics of complete readings, computed once for several analyses; excerpts of readings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.columns import centred_rows, transposed
from anisomap.numerics.precision import Floats, Reals
from anisomap.numerics.similarity.rest import Rest, estimate_rest

MAX_FRAMES = 4096
"""Consecutive frames of an excerpt; chosen by hand: statistics of more frames hardly differ."""

MAX_SENSORS = 256
"""Sensors of an excerpt; chosen by hand: matrices of all pairs then take milliseconds."""

_N_DIFFERING, _SENSORS_AT_ONCE = 128, 64  # frames and sensors
MAX_PAIRED = 2048
"""Maximum number of sensors for which statistics of all pairs are stored."""

_FRAMES_AT_ONCE = 256  # whose intermediate arrays stay in the cache
_EXCEEDED = 0.01  # probability with which a normal maximum is exceeded
_HALF_IN_COMMON = 0.5**0.5  # r of sensors that have half of their variance in common
_MAX_PARTS, _N_LOOKED_AT = 17, 512  # parts of a recording, and frames of each, that are examined
_N_LISTENED = 64  # sensors whose spectra are computed


@dataclass(frozen=True, eq=False)
class Signals:
    """Levels, rest and contacts of N sensors, computed at first use.

    readings (T, N): Finite.
    """

    readings: NDArray[Any]

    @cached_property
    def rest(self) -> Rest:
        """Rest of each sensor."""
        return estimate_rest(self.readings)

    def differ_by_less(self, limits: Floats) -> NDArray[np.bool_]:
        """Return whether readings of each sensor differ, and by less than a limit, shape (N,)."""
        found = np.zeros(len(limits), dtype=bool)
        for some in (slice(_N_DIFFERING), slice(None)):  # few frames usually suffice
            for begin in range(0, len(left := np.flatnonzero(~found)), _SENSORS_AT_ONCE):
                part = left[begin : begin + _SENSORS_AT_ONCE]
                steps = np.diff(np.sort(transposed(self.readings[some, part]), axis=1), axis=1)
                found[part] = ((steps > 0) & (steps < limits[part, None])).any(axis=1)
        return found

    @property
    def never_at_rest(self) -> NDArray[np.intp]:
        """Sensors without a frequent value, such as sensors with a permanent signal."""
        return np.flatnonzero(~self.rest.frequent)

    @cached_property
    def at_extreme(self) -> NDArray[np.intp]:
        """Frames at the most extreme reading on the side of contact; 0 without contact."""
        rest, raises = self.rest, self.rest.side > 0
        extreme = np.where(raises, self.readings.max(axis=0), self.readings.min(axis=0))
        found = np.count_nonzero(self.readings == extreme, axis=0)
        return np.where(rest.depth(extreme) > 0, found, 0)

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

        A sensor without rest is always touched, or contains only noise. It counts as touched if it
        exceeds noise or, where most sensors have a rest, if it resembles other sensors.
        """
        rest = self.rest
        restless = np.flatnonzero(~rest.known)
        if not (restless.size or rest.threshold.any()):
            return self.active
        touched = replace(rest, noise=2 * rest.noise).active(self.readings)
        if 2 * restless.size > rest.known.size:
            restless = restless[~_exceed_noise(self.readings, restless)]
        elif restless.size:
            restless = restless[~_resemble_others(self.readings, restless)]
        touched[:, restless] = False
        return touched

    @cached_property
    def pearson(self) -> tuple[Reals, float]:
        """Pearson's r of every pair of sensors, (N, N), and its reliability."""
        # Imported here, since importing it takes time.
        from anisomap.numerics.similarity import correlation  # noqa: PLC0415

        found, reliability = correlation.correlation_and_reliability(self.readings)
        found.setflags(write=False)
        return found, reliability

    @cached_property
    def lag_correlation(self) -> Floats:
        """Autocorrelation of each sensor at a lag of one frame; NaN if it is constant."""
        squares, products = squares_and_lagged(self.readings, self.rest.value)
        found = np.full(len(squares), np.nan)
        return np.asarray(np.divide(products, squares, out=found, where=squares > 0))

    @cached_property
    def excerpt_rows(self) -> NDArray[np.float32]:
        """Readings of an excerpt, of mean 0 and norm 1, shape (N, t)."""
        return unit_rows(self.readings[excerpt_frames(self.readings)])

    @cached_property
    def contacts(self) -> NDArray[np.intp]:
        """Number of contacts of each sensor: runs of frames clearly beyond rest."""
        return count_contacts(self.touched)

    @cached_property
    def spectra(self) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
        """Some sensors, and the power of their readings at each frequency, (F, n), Hann window."""
        # Processes that read files compute no spectra, and start three times as fast without scipy.
        from scipy.fft import rfft  # noqa: PLC0415

        chosen = some_sensors(self.readings.shape[1], _N_LISTENED)
        rows = unit_rows(self.readings[:, chosen])
        rows *= np.hanning(rows.shape[1]).astype(np.float32)
        return chosen, np.abs(rfft(rows, axis=1).T) ** 2


def squares_and_lagged(
    readings: NDArray[Any], centre: NDArray[np.floating]
) -> tuple[Floats, Floats]:
    """Return sums of squared deviations from the means, and of products of successive ones, (N,).

    centre (N,): Values near the means, or readings: of others, sums might be below 0 by rounding.
    """
    n_frames, near = len(readings), centre.astype(np.float64)
    total, squares, products = np.zeros((3, len(near)))
    ends = readings[0] - near + (readings[-1] - near)
    for begin in range(0, n_frames, _FRAMES_AT_ONCE):
        part = readings[max(0, begin - 1) : begin + _FRAMES_AT_ONCE] - near
        later = part[begin > 0 :]
        total += later.sum(axis=0)
        squares += np.einsum("ti,ti->i", later, later)
        products += np.einsum("ti,ti->i", part[1:], part[:-1])
    mean = total / n_frames
    products -= mean * (2 * total - ends - (n_frames - 1) * mean)
    return squares - mean * total, products


def _exceed_noise(readings: NDArray[Any], sensors: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return whether sensors correlate with themselves a frame later, or with others, (n,).

    The probability for noise alone is 1 % per recording.
    """
    rows = unit_rows(readings[excerpt_frames(readings)][:, sensors])
    some = some_sensors(sensors.size)
    others = np.abs(rows @ rows[some].T)
    others[some, np.arange(some.size)] = 0
    itself = np.abs(np.einsum("nt,nt->n", rows[:, 1:], rows[:, :-1]))
    least = normal_maximum(2 * sensors.size * (some.size + 1)) / np.sqrt(rows.shape[1])
    return np.asarray((itself > least) | (others.max(axis=1, initial=0) > least))


def _resemble_others(readings: NDArray[Any], sensors: NDArray[np.intp]) -> NDArray[np.bool_]:
    """Return whether sensors share half of their variance with any of a sample of sensors, (n,)."""
    some = some_sensors(readings.shape[1])
    part = readings[excerpt_frames(readings)]
    r = np.abs(unit_rows(part[:, sensors]) @ unit_rows(part[:, some]).T)
    r[sensors[:, None] == some] = 0
    return np.asarray(r.max(axis=1) > _HALF_IN_COMMON)


def count_contacts(active: ArrayLike) -> NDArray[np.intp]:
    """Count separate contacts of each sensor: runs of frames in which it is active."""
    on = np.asarray(active, dtype=bool)
    return np.asarray(on[:1].sum(axis=0) + np.count_nonzero(on[1:] > on[:-1], axis=0))


def count_joint_contacts(active: ArrayLike, pairs: ArrayLike) -> NDArray[np.intp]:
    """Count separate contacts of pairs of sensors: runs of frames in which both are active."""
    on = np.ascontiguousarray(np.asarray(active, dtype=bool).T)
    both = [count_contacts(on[i] & on[j]) for i, j in np.asarray(pairs, dtype=np.intp)]
    return np.array(both, dtype=np.intp)


def normal_maximum(count: ArrayLike) -> Floats:
    """Return the value that the largest of `count` normal variables exceeds with probability 1 %.

    Bonferroni's bound, with the tail of the normal distribution approximated by exp(-z^2 / 2) / 2.
    """
    return np.asarray(np.sqrt(2 * np.log(np.maximum(1, count) / _EXCEEDED)))


def unit_rows(readings: NDArray[np.floating]) -> NDArray[np.float32]:
    """Scale every sensor to mean 0 and norm 1; 0 if constant. readings (T, N) -> (N, T)."""
    rows = centred_rows(readings)
    norms = np.sqrt(np.einsum("nt,nt->n", rows, rows))
    rows /= np.where(norms > 0, norms, 1)[:, None]
    return rows


def standardised(readings: NDArray[Any]) -> NDArray[np.float32]:
    """Scale each sensor to mean 0 and variance 1; constant sensors become 0."""
    values = unit_rows(readings)
    values *= np.sqrt(np.float32(values.shape[1]))
    return values.T


def excerpt_frames(readings: NDArray[Any], most: int = MAX_FRAMES) -> slice:
    """Return consecutive frames for an excerpt: the middle frames, unless the skin rests there.

    The skin rests in a part if fewer than half as many sensors change as in the busiest part of the
    same length. A sensor changes if its readings span half of its range over all parts. (T, N).
    """
    if len(readings) <= most:
        return slice(0, most)
    middle = (len(readings) - most) // 2
    starts = np.linspace(0, 2 * middle, min(_MAX_PARTS, 2 * (len(readings) // most) + 1))
    starts[len(starts) // 2] = middle
    parts = [readings[begin : begin + most] for begin in starts.astype(np.intp).tolist()]
    some = [part[:: max(1, len(part) // _N_LOOKED_AT)] for part in parts]
    spans = np.stack([np.ptp(part, axis=0) for part in some])
    changing = np.count_nonzero((2 * spans >= spans.max(axis=0)) & (spans > 0), axis=1)
    chosen = len(starts) // 2
    if 2 * changing[chosen] < changing.max():
        chosen = int(changing.argmax())
    begin = int(starts[chosen])
    return slice(begin, begin + most)


def some_sensors(n_sensors: int, most: int = MAX_SENSORS) -> NDArray[np.intp]:
    """Return evenly spaced indices of sensors."""
    return np.unique(np.linspace(0, n_sensors - 1, min(n_sensors, most)).astype(np.intp))


def deviation_from_median(values: Floats) -> Floats:
    """Return the median absolute deviation of each column, shape (N,)."""
    return medians(np.abs(values - medians(values)))


def medians(values: NDArray[Any]) -> NDArray[Any]:
    """Return the median of each column, shape (N,); many times faster than `numpy.median`."""
    # Sorting of contiguous rows is vectorised, unlike partitioning.
    ordered = np.sort(np.ascontiguousarray(values.T), axis=1)
    middle = len(values) // 2
    if len(values) % 2:
        return np.asarray(ordered[:, middle])
    return np.asarray((ordered[:, middle - 1] + ordered[:, middle]) / 2)
