"""Common signals of the electronics in several sensors: hum, and noise of a supply or board."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from anisomap.health.recording_faults import (
    Found,
    agree_more,
    halves_of,
    has_contacts,
    linked_groups,
    turns_like_noise,
    with_readings,
)
from anisomap.numerics.signals import (
    deviation_from_median,
    excerpt_frames,
    medians,
    some_sensors,
    squares_and_lagged,
    unit_rows,
)
from anisomap.recording import Recording

_MIN_LINE = 20.0  # power of a line over the median power on either side; noise: p = 1e-6 for each
_GAP, _BESIDE = 2, 8  # frequencies on each side that belong to a line, and that are compared
_MIN_COHERENCE = 0.95  # of the phases of a hum over sensors; chosen by hand
_MIN_SENSORS = 0.8  # share of the sensors that hum; chosen by hand
_SAME_FREQUENCY = 1e-4  # of a step between frequencies
_N_PHASES = 8  # parts of a period, for quantiles
_MIN_EVEN = 0.6  # shift of low readings relative to high ones; at most 0.2 for pulses; by hand
_MIN_GROUP = 3  # sensors of a board
# In fewer frames, one or two strokes over the sensors resemble a common signal: 5 % of such
# recordings of 100 and 200 frames were flagged (measured).
_MIN_FRAMES = 256
_MIN_LINK = 0.3  # correlation of the fast noise of two sensors of a board; chosen by hand
# Ratio of the variances of the second and the first component of the fast noise. On simulated
# skins, it is at most .04 for common noise, and at least .4 for sources that reach a part each.
_MAX_SECOND = 0.2
_CLIP = 3.0  # median absolute deviations; larger changes are contacts
_MIN_WEIGHTED = 30  # sensors; fewer are not weighted, since one could dominate; by hand
_LEAST_WIDTH = 1e-3  # relative to the median sensor, so that no sensor dominates
_LOW = 0.35  # quantile over sensors that is at rest
_MAX_ROUNDS, _MAX_FRAMES = 12, 8192  # of the fit of gains
_SCREENED = 1024, 32  # frames and sensors in which the noise of a group is fitted first
_SAME_GAIN = 1e-4  # relative change of gains at convergence
_MIN_NOISE = 1e-3  # standard deviations of the readings; less does not change correlations
_MAX_GAIN_RATIO = 20.0  # of the sensors of a group; chosen by hand
# Minimum share of common noise in the fast noise of the median sensor, and of hum in the standard
# deviation of the median sensor; less changes r by 1 % at most.
_MIN_SHARE = 0.1
_MAX_WHITE = -0.5  # autocorrelation of second differences at lag 1: -2/3 for white noise
_MAX_APART = 0.1  # relative difference of the gains of a hum in both halves; chosen by hand
_MIN_SMOOTH = 0.2  # autocorrelation of the readings without the noise; chosen by hand
_ALL = 0.9  # share of the sensors above which noise concerns the whole skin


def find_hum(recording: Recording) -> Iterator[Found]:
    """Find a sine common to sensors: one period and phase, and a gain for each sensor.

    The period is that of the clearest line in the median of the sensors' spectra. A hum is found if
    the power of the line is 20 times the power on either side, and if all sensors have the same
    phase. Rolling or walking at a constant pace also causes lines, but phases then differ between
    places.
    """
    readings, free = recording.readings, recording.signals.never_at_rest
    n_frames, n_sensors = readings.shape
    if free.size < max(_MIN_GROUP, _MIN_SENSORS * n_sensors) or n_frames < 8 * _BESIDE:
        return
    sensors, spectra = recording.signals.spectra
    power = medians(spectra[:, np.isin(sensors, free)].T)
    # Without a line, the steep power of slow changes also exceeds the power on one side.
    beside = medians(np.lib.stride_tricks.sliding_window_view(power, _BESIDE).T)
    apart = _BESIDE + 2 * _GAP - 1
    clear = power[_BESIDE + _GAP - 1 :][: beside.size - apart]
    clear = clear / np.maximum(np.maximum(beside[:-apart], beside[apart:]), 1e-300)
    if clear.max() < _MIN_LINE:
        return
    rows = unit_rows(readings[:, sensors[np.isin(sensors, free)]])
    total, times = rows.sum(axis=0, dtype=np.float64), np.arange(n_frames)
    frequency, width = (int(clear.argmax()) + _BESIDE + _GAP - 1) / n_frames, 1 / n_frames
    if _coherence(rows, frequency)[0] < _MIN_COHERENCE / 2:  # hardly less at half a step
        return
    frequency = minimize_scalar(
        lambda trial: -abs(total @ np.exp(-2j * np.pi * trial * times)),
        bounds=(frequency - width, frequency + width),
        method="bounded",
        options={"xatol": _SAME_FREQUENCY * width},
    ).x
    coherence, phase = _coherence(rows, frequency)
    if not coherence >= _MIN_COHERENCE or not _is_added(rows, frequency, phase):
        return
    course = np.cos(2 * np.pi * frequency * times + phase)
    gains = _sine_gains(readings[:, free], course)
    share = _median_share(gains / np.sqrt(2), readings[:, free])
    if share < _MIN_SHARE:
        return
    halves = [_sine_gains(readings[half][:, free], course[half]) for half in halves_of(n_frames)]
    again = np.median(np.abs(halves[0] - halves[1])) <= _MAX_APART * np.median(gains)
    values = {"period": 1 / frequency, "rate_hz": recording.rate_hz}
    yield Found(free, share, values, _without(free, course, gains) if again else None)


def _coherence(rows: NDArray[np.float32], frequency: float) -> tuple[float, float]:
    """Return the coherence of a sine over sensors, and its phase. rows (n, T)."""
    wave = np.exp(-2j * np.pi * frequency * np.arange(rows.shape[1])).astype(np.complex64)
    of_sensors = rows @ wave.real + 1j * (rows @ wave.imag)
    total = of_sensors.sum()
    return float(abs(total) / np.abs(of_sensors).sum()), float(np.angle(total))


def find_common_noise(recording: Recording) -> Iterator[Found]:
    """Find white noise that groups of sensors share.

    Contacts are slow compared to the frame rate, so second differences show noise. Sensors are
    grouped by the correlation of their second differences, limited to 3 median absolute deviations.
    One component must dominate a group; sources at several places, as in EEG, cause several. The
    noise of a group is the mean of its readings over sensors not in contact, each divided by the
    gain of the sensor. Noise is found if it is white, the remaining readings are not, and it is at
    least 10 % of the fast noise. A group smaller than the skin must also have contacts of several
    kinds; otherwise, its common signal may be a single contact. Noise of a group is mended only if
    the agreement with other sensors then increases: see `agree_more`.
    """
    readings, free = recording.readings, recording.signals.never_at_rest
    n_frames, n_sensors = _SCREENED
    if free.size < _MIN_GROUP or len(readings) < _MIN_FRAMES:
        return
    excerpt = readings[excerpt_frames(readings, n_frames)]
    for group in _groups(readings, free):
        if _noise_of(excerpt[:, group[some_sensors(group.size, n_sensors)]]) is None:
            continue
        noise = _noise_of(readings[:, group])
        if noise is None:
            continue
        course, gains = noise
        share = _median_share(gains * course.std(), readings[:, group])
        everywhere = group.size >= _ALL * recording.n_sensors
        mend = _without(group, course, gains)
        if everywhere:
            yield Found(group, share)
        elif has_contacts(mend(recording), group):
            left = _held_out(readings, group)
            known = left is not None and agree_more(readings, left, group)
            yield Found(group, share, mend=mend if known else None, kind="board-noise")


def _held_out(readings: NDArray[Any], group: NDArray[np.intp]) -> NDArray[Any] | None:
    """Subtract the noise of a group from each half of a recording by gains of the other half."""
    halves = halves_of(len(readings))
    found = [_noise_of(readings[half][:, group]) for half in halves]
    one, other = found
    if one is None or other is None:
        return None
    left = np.array(readings)
    for half, (course, _), (_, gains) in zip(halves, (one, other), (other, one), strict=True):
        left[half, group] -= np.outer(course, gains)
    return left


def _without(
    sensors: NDArray[np.intp], course: NDArray[np.float64], gains: NDArray[np.float64]
) -> Any:
    """Return a repair that subtracts a signal, shape (T,), times the gain of each sensor."""

    def change(readings: NDArray[Any]) -> NDArray[Any]:
        mended = np.array(readings)
        mended[:, sensors] -= np.outer(course, gains).astype(readings.dtype)
        return mended

    return with_readings(change)


def _median_share(sizes: NDArray[np.float64], readings: NDArray[Any]) -> float:
    deviation = readings.std(axis=0, dtype=np.float64)
    return float(np.median(sizes / np.maximum(deviation, 1e-300)))


def _is_added(rows: NDArray[np.float32], frequency: float, phase: float) -> bool:
    """Return whether a line shifts low and high readings, rows (n, T), equally, as an added sine.

    A periodic stimulus shifts high readings more than low ones.
    """
    turns = (frequency * np.arange(rows.shape[1]) + phase / (2 * np.pi)) % 1
    bins = (turns * _N_PHASES).astype(np.intp)
    present = np.unique(bins)
    waves = np.cos(2 * np.pi * (present + 0.5) / _N_PHASES)
    ordered = (np.sort(rows[:, bins == b], axis=1).T for b in present)
    levels = [one[[len(one) // 4, -1 - len(one) // 4]] for one in ordered]  # quartiles
    low, high = np.median(np.tensordot(waves, levels, 1), axis=1)
    return bool(0 < _MIN_EVEN * high <= low)


def _sine_gains(readings: NDArray[Any], course: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the amplitude of a sine in each sensor; contacts are clipped."""
    if len(readings) > _MAX_FRAMES:
        # Frames at equal steps could all have the same phase.
        frames = np.random.default_rng(0).choice(len(readings), _MAX_FRAMES, replace=False)
        readings, course = readings[np.sort(frames)], course[np.sort(frames)]
    values = readings.astype(np.float64)
    values -= medians(values)
    gains = 2 * (course @ values) / len(course)
    for _ in range(_MAX_ROUNDS):
        left = values - np.outer(course, gains)
        left -= medians(left)
        width = np.maximum(_CLIP * deviation_from_median(left), 1e-9 * np.abs(values).max())
        inside = np.abs(left) <= width
        step = np.where(inside, left, 0).T @ course / np.maximum(inside.T @ course**2, 1e-300)
        gains = gains + step
        if (np.abs(step) <= _SAME_GAIN * np.abs(gains)).all():
            break
    return gains


def _groups(readings: NDArray[Any], free: NDArray[np.intp]) -> Iterator[NDArray[np.intp]]:
    """Yield groups of linked sensors whose fast noise has one dominant component."""
    values = readings[excerpt_frames(readings, _SCREENED[0])][:, free]
    fast = np.diff(values, 2, axis=0)
    scale = deviation_from_median(fast)
    noisy = scale > _MIN_NOISE * values.std(axis=0)
    free = free[noisy]
    if free.size < _MIN_GROUP:
        return
    rows = unit_rows(np.clip(fast[:, noisy] / scale[noisy], -_CLIP, _CLIP))
    for group in linked_groups(rows, _MIN_LINK, _MIN_GROUP):
        members = rows[group][some_sensors(int(group.sum()), _SCREENED[1])]
        second, first = np.linalg.eigvalsh(members @ members.T)[-2:]
        if second <= _MAX_SECOND * first:
            yield free[group]


def _noise_of(readings: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return the common noise of a group, (T,), and its gains, (n,); None without noise."""
    values = readings.astype(np.float64)
    gains, course = _common_course(values)
    if (gains <= 0).any() or gains.max() > _MAX_GAIN_RATIO * gains.min():
        return None
    if not turns_like_noise(course):
        return None
    left = values - np.outer(course, gains)
    before, after = (deviation_from_median(np.diff(part, 2, axis=0)) for part in (values, left))
    share = 1 - np.median(after**2 / np.maximum(before**2, 1e-300))
    fast = np.diff(course, 2)
    white = np.sum(fast[1:] * fast[:-1]) / max(np.sum(fast**2), 1e-300)
    squares, lagged = squares_and_lagged(left, left.mean(axis=0))
    smooth = np.median(lagged / np.maximum(squares, 1e-300))
    # By chance, the mean of n sensors contains 1 / n of the noise of each.
    if share < max(_MIN_SHARE, 3 / gains.size) or white > _MAX_WHITE or smooth < _MIN_SMOOTH:
        return None
    return course, gains


def _common_course(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a common signal with gains to the sensors that are not in contact.

    The signal is initially a low quantile over sensors, which is at rest even if contacts cover
    half of the skin. In each round, it is the mean of the sensors within 3 deviations of it. Of 30
    sensors or more, each is weighted by the reciprocal variance, so that sensors that are often in
    contact have less weight.
    """
    low = _LOW if np.median(((values - values.mean(axis=0)) ** 3).sum(axis=0)) >= 0 else 1 - _LOW
    side = 1.0 if low < 0.5 else -1.0
    weighted = values.shape[1] >= _MIN_WEIGHTED
    rest = np.quantile(values, low, axis=0)
    fast = np.diff(values, 2, axis=0)
    gains = deviation_from_median(fast)
    gains /= np.median(gains)
    course = np.quantile((values - rest) / gains, low, axis=1)
    for _ in range(_MAX_ROUNDS):
        scaled = (values - rest) / gains
        left = scaled - course[:, None]
        width = _one_sided_width(side * left)
        width = np.maximum(width, _LEAST_WIDTH * max(float(np.median(width)), 1e-9))
        weight = (np.abs(left) <= _CLIP * width) / (width**2 if weighted else 1.0)
        total = weight.sum(axis=1)
        mean = (weight * scaled).sum(axis=1) / np.where(total > 0, total, 1)
        course = np.where(total > 0, mean, course)
        slow = np.diff(course, 2)
        apart = fast - np.outer(slow, gains)
        limit = _CLIP * deviation_from_median(apart)
        step = slow @ np.clip(apart, -limit, limit) / max(float(np.sum(slow**2)), 1e-300)
        gains = gains + step
        if (gains <= 0).any():
            break
        rest = np.quantile(values - np.outer(course, gains), low, axis=0)
        course = course - np.median(course)
    return gains, course


def _one_sided_width(left: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the median deviation of each column to the side that contacts do not reach."""
    below = np.sort(np.minimum(left, 0), axis=0)
    counts = np.count_nonzero(left <= 0, axis=0)
    return np.asarray(-below[counts // 2, np.arange(left.shape[1])])
