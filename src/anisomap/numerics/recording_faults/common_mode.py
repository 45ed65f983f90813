"""Signals of the electronics that groups of sensors share: noise of a supply or board, and hum."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from anisomap.numerics.signals import (
    MAX_FRAMES,
    MAX_SENSORS,
    deviation_from_median,
    medians,
    middle_frames,
    some_sensors,
)

_MIN_GROUP = 3  # sensors of a board
_MIN_LINK = 0.3  # correlation of the fast noise of two sensors of a board; chosen by hand
_CLIP = 3.0  # median absolute deviations; larger changes are contacts
_MIN_WEIGHTED = 30  # sensors from which they are weighted: of few, one could decide; by hand
_LEAST_WIDTH = 1e-3  # of the median sensor's, so that no sensor decides alone
_LOW = 0.35  # quantile of readings that are at rest
_MAX_ROUNDS, _MAX_FRAMES = 12, 8192  # of the fit of gains
_SAME_GAIN = 1e-4  # relative change at which they have converged
_MIN_NOISE = 1e-3  # standard deviations of the readings; less changes no correlation
_MAX_GAIN_RATIO = 20.0  # of the sensors of a group; chosen by hand
_MIN_SHARE = 0.1  # share of the fast noise of the median sensor that is common; chosen by hand
_MAX_WHITE = -0.5  # autocorrelation of second differences at lag 1: -2/3 for white noise
_MAX_AUTOCORRELATION = 0.1  # of white noise: 4 standard errors in 1,600 frames
_MIN_SMOOTH = 0.2  # autocorrelation of the other part of the readings; chosen by hand
_MIN_COHERENCE = 0.95  # of the phases of a hum over sensors and over quarters; chosen by hand
_MIN_LINE = 20.0  # power of a line over the median power beside it; noise: p = 1e-6 for a frequency
_MIN_SENSORS = 0.8  # share of the sensors that hum; chosen by hand
_N_LISTENED = 64  # sensors in which a hum is searched
_N_PHASES = 8  # parts of a period, for quantiles
_LOW_AND_HIGH = (0.25, 0.75)
_MIN_EVEN = 0.6  # shift of low over that of high readings; pulses have 0.2 at most; by hand
_BESIDE = 50  # frequencies on each side for comparison


@dataclass(frozen=True, eq=False)
class CommonSignal:
    """A signal that sensors share.

    gains (n,): Of each of these sensors.
    course (T,): In units of the readings, if the gain is 1.
    share: Standard deviation of the signal over that of the readings; median of the sensors.
    period: In frames, for a hum; 0 for noise.
    separable: Whether the course holds nothing but the signal. If contacts cover most of the skin,
        they cannot be told from what sensors share.
    """

    sensors: NDArray[np.intp]
    gains: NDArray[np.float64]
    course: NDArray[np.float64]
    share: float
    period: float = 0.0
    separable: bool = True

    def removed_from(self, readings: NDArray[Any]) -> NDArray[Any]:
        """Subtract the signal from readings, shape (T, N)."""
        mended = np.array(readings)
        mended[:, self.sensors] -= np.outer(self.course, self.gains).astype(readings.dtype)
        return mended


def find_common_noise(readings: NDArray[Any], free: NDArray[np.intp]) -> tuple[CommonSignal, ...]:
    """Find white noise that groups of sensors share.

    readings (T, N).

    Contacts are slow compared to the frames; second differences therefore show noise. Sensors are
    grouped by the correlation of these, limited to 3 median absolute deviations. The noise of a
    group is the mean of its sensors over their gains, without those that are in contact. It is a
    finding if it is white, while the rest of the readings is not, and takes 10 % of the fast noise
    or more.
    """
    found = []
    if free.size < _MIN_GROUP or len(readings) < 100:
        return ()
    for group in _groups(readings, free):
        signal = _common_noise(readings, group)
        if signal is not None:
            found.append(signal)
    return tuple(found)


def find_hum(readings: NDArray[Any], free: NDArray[np.intp]) -> CommonSignal | None:
    """Find a sine of one period and phase with a gain of its own in each sensor.

    readings (T, N).

    The period is that of the strongest line in the median of the sensors' spectra. It is a finding
    if the power of the line is 20 times that beside it, and if its phase is the same in all sensors
    and in all quarters of the recording. A body that rolls or walks at an even pace has lines, too,
    but sensors on different places have different phases.
    """
    n_frames = len(readings)
    if free.size < max(_MIN_GROUP, _MIN_SENSORS * readings.shape[1]) or n_frames < 4 * _BESIDE:
        return None
    chosen = free[some_sensors(free.size, _N_LISTENED)]
    values = readings[:, chosen].astype(np.float64)
    values -= values.mean(axis=0)
    values /= values.std(axis=0)
    window = np.hanning(n_frames)[:, None]
    power = np.median(np.abs(np.fft.rfft(values * window, axis=0)) ** 2, axis=1)
    power[:5] = 0
    peak = int(power.argmax())
    beside = power[max(5, peak - _BESIDE) : peak + _BESIDE]
    if power[peak] < _MIN_LINE * np.median(beside):
        return None
    frequency = _sharpened(values, peak)
    waves = np.exp(-2j * np.pi * frequency * np.arange(n_frames))
    amplitude = 2 * (waves @ values) / n_frames
    coherence = np.abs(amplitude.sum()) / np.abs(amplitude).sum()
    quarters = np.array(
        [
            (w @ v).sum()
            for w, v in zip(np.array_split(waves, 4), np.array_split(values, 4), strict=True)
        ]
    )
    steadiness = np.abs(quarters.sum()) / np.abs(quarters).sum()
    if not min(coherence, steadiness) >= _MIN_COHERENCE:
        return None
    phase = np.angle(amplitude.sum())
    course = np.cos(2 * np.pi * frequency * np.arange(n_frames) + phase)
    if not _is_added(values, frequency, float(phase)):
        return None
    gains = _sine_gains(readings[:, free], course)
    shares = gains / np.sqrt(2) / np.maximum(readings[:, free].std(axis=0), 1e-300)
    return CommonSignal(free, gains, course, float(np.median(shares)), 1 / frequency)


def _groups(readings: NDArray[Any], free: NDArray[np.intp]) -> Iterator[NDArray[np.intp]]:
    """Yield groups of sensors with common fast noise."""
    frames = middle_frames(len(readings), 2048)
    fast = np.diff(readings[frames][:, free].astype(np.float64), 2, axis=0)
    scale = deviation_from_median(fast)
    noisy = scale > _MIN_NOISE * readings[frames][:, free].std(axis=0)
    fast, free = fast[:, noisy] / scale[noisy], free[noisy]
    if free.size < _MIN_GROUP:
        return
    np.clip(fast, -_CLIP, _CLIP, out=fast)
    fast -= fast.mean(axis=0)
    fast = (fast / fast.std(axis=0)).astype(np.float32)
    linked = fast.T @ fast / len(fast) > _MIN_LINK
    n_groups, group = connected_components(linked, directed=False)
    for number in range(n_groups):
        members = free[group == number]
        if members.size >= _MIN_GROUP:
            yield members


def _common_noise(readings: NDArray[Any], group: NDArray[np.intp]) -> CommonSignal | None:
    if len(readings) > 2 * MAX_FRAMES or group.size > 2 * MAX_SENSORS:
        some = group[some_sensors(group.size)]
        excerpt = readings[middle_frames(len(readings))][:, some]
        if _common_noise(excerpt, np.arange(some.size)) is None:
            return None
    values = readings[:, group].astype(np.float64)
    gains, course = _common_course(values, weighted=group.size >= _MIN_WEIGHTED)
    if (gains <= 0).any() or gains.max() > _MAX_GAIN_RATIO * gains.min():
        return None
    left = values - np.outer(course, gains)
    before, after = (deviation_from_median(np.diff(part, 2, axis=0)) for part in (values, left))
    share = 1 - np.median(after**2 / np.maximum(before**2, 1e-300))
    fast = np.diff(course, 2)
    white = np.sum(fast[1:] * fast[:-1]) / max(np.sum(fast**2), 1e-300)
    smooth = np.median(_autocorrelation(left))
    # By chance, the mean of n sensors takes 1 / n of the noise of each.
    if share < max(_MIN_SHARE, 3 / group.size) or white > _MAX_WHITE or smooth < _MIN_SMOOTH:
        return None
    size = gains * course.std() / np.maximum(values.std(axis=0), 1e-300)
    separable = abs(float(_autocorrelation(course[:, None])[0])) <= _MAX_AUTOCORRELATION
    return CommonSignal(group, gains, course, float(np.median(size)), separable=separable)


def _common_course(
    values: NDArray[np.float64], *, weighted: bool
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit one course with gains to sensors, without those in contact.

    A low quantile starts, which is at rest even if contacts cover half of the skin, and then the
    mean of the sensors within 3 deviations of it, optionally
    weighted by the reciprocals of their variances: sensors often in contact then count less.
    """
    low = _LOW if np.median(((values - values.mean(axis=0)) ** 3).sum(axis=0)) >= 0 else 1 - _LOW
    side = 1.0 if low < 0.5 else -1.0
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
        clipped = np.clip(fast - np.outer(slow, gains), *_limits(fast - np.outer(slow, gains)))
        gains = gains + (slow @ clipped) / max(float(np.sum(slow**2)), 1e-300)
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


def _limits(values: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    width = _CLIP * deviation_from_median(values)
    return -width, width


def _autocorrelation(values: NDArray[np.float64]) -> NDArray[np.float64]:
    centred = values - values.mean(axis=0)
    products = np.einsum("ti,ti->i", centred[1:], centred[:-1])
    return np.asarray(products / np.maximum(np.einsum("ti,ti->i", centred, centred), 1e-300))


def _is_added(values: NDArray[np.float64], frequency: float, phase: float) -> bool:
    """Return whether a line shifts low and high readings alike, as an added sine does.

    A stimulus that comes in time with the line shifts high readings more than low ones.
    """
    turns = (frequency * np.arange(len(values)) + phase / (2 * np.pi)) % 1
    bins = (turns * _N_PHASES).astype(np.intp)
    waves = np.cos(2 * np.pi * (np.arange(_N_PHASES) + 0.5) / _N_PHASES)
    levels = np.array(
        [np.quantile(values[bins == b], _LOW_AND_HIGH, axis=0) for b in range(_N_PHASES)]
    )
    shifts = np.median(np.tensordot(waves, levels, 1), axis=1)
    low, high = float(shifts[0]), float(shifts[1])
    return 0 < _MIN_EVEN * high <= low


def _sharpened(values: NDArray[np.float64], peak: int) -> float:
    """Refine the frequency of a line, in cycles per frame, by the power of all sensors."""
    n_frames = len(values)
    times = np.arange(n_frames)
    best, width = peak / n_frames, 1 / n_frames
    for _ in range(8):
        trials = best + width * np.linspace(-1, 1, 9)
        power = [
            float((np.abs(np.exp(-2j * np.pi * f * times) @ values) ** 2).sum()) for f in trials
        ]
        best, width = float(trials[int(np.argmax(power))]), width / 3
    return best


def _sine_gains(readings: NDArray[Any], course: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the amplitude of a sine in each sensor, with contacts limited."""
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
