"""Levels at rest that differ between recordings of one skin, or step within a recording.

Each session has its own zero. If sessions are pooled unchanged, sensors whose zeros differ appear
to be related. Levels are compared with the noise at rest, and corrected if most sensors differ.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.precision import Floats
from anisomap.numerics.similarity.rest import Rest, estimate_rest

MIN_FRAMES = 50
"""Minimum number of frames for a level at rest: in fewer, sensors may be touched most of the time.
"""
# Chosen by hand: a contact changes fewer sensors, and all of them to one side of rest.
_MOST, _EACH_SIDE = 0.5, 0.1  # of the sensors
_N_COMPARED = 200  # frames at each end, compared to detect a step
_WINDOW = 25  # frames
_SIDE = 10  # frames before and behind a step
_CERTAIN = 4.0  # standard deviations of a difference
_NEARLY_ALL = 0.8  # of the sensors
_NOISE = 6.0  # minimum difference of levels, in standard deviations
_AT_REST = 0.5  # of the frames between steps
# Shares of frames that may be at the level beyond a step, by chance and by contacts.
_BEYOND, _TOUCHED = 0.02, 0.3


def offsets(
    parts: Sequence[NDArray[np.floating]], sensors: Sequence[NDArray[np.intp]]
) -> list[Floats | None]:
    """Return the rest of each part minus the rest of the first part with the same sensor.

    parts: Readings, (T, n), of the sensors with the given numbers. The offset is None for a part
    that is too short, or in which less than half of the sensors differ by more than noise.
    """
    n_all = 1 + max(int(own.max(initial=-1)) for own in sensors)
    level, noise = np.full((2, n_all), np.nan)
    found: list[Floats | None] = []
    for readings, own in zip(parts, sensors, strict=True):
        found.append(None)
        if len(readings) < MIN_FRAMES:
            continue
        rest = _rest(readings)
        shared = np.isfinite(level[own])
        apart = np.abs(rest.value - level[own]) > rest.threshold + noise[own]
        if shared.any() and (apart & rest.known)[shared].mean() > _MOST:
            shift = np.where(shared, rest.value - level[own], 0)
            found[-1] = shift
        new = own[~shared]
        level[new], noise[new] = rest.value[~shared], rest.threshold[~shared]
    return found


def _rest(readings: NDArray[np.floating]) -> Rest:
    known = np.isfinite(readings)
    if not known.all():
        empty = ~known.any(axis=0)
        usual = np.nanmedian(np.where(known, readings, np.nan)[:, ~empty], axis=0)
        fill = np.zeros(readings.shape[1])
        fill[~empty] = usual
        readings = np.where(known, readings, fill).astype(readings.dtype)
    return estimate_rest(readings)


def steps_of_rest(readings: NDArray[np.floating]) -> list[int]:
    """Return the frames at which the rest level of most sensors changes; usually there are none.

    At a step, some sensors rise and others fall. Between steps, readings leave the level only
    during contacts. After a long contact, by contrast, readings return to an earlier level.
    """
    n_frames = len(readings)
    if n_frames < 2 * MIN_FRAMES or readings.shape[1] < 1 / _EACH_SIDE:
        return []
    n = min(_N_COMPARED, n_frames // 2)
    with np.errstate(over="ignore", invalid="ignore"):
        ends = (_level(readings[:n]), _level(readings[-n:]))
        if not _apart(*ends):
            return []
        n_windows = n_frames // _WINDOW
        windows = readings[: n_windows * _WINDOW].reshape(n_windows, _WINDOW, -1)
        medians = np.median(windows, axis=1).astype(np.float64)
        moved = np.abs(np.diff(medians, axis=0)) > _NOISE * np.maximum(ends[0][1], ends[1][1])
        candidates = 1 + np.flatnonzero(moved.mean(axis=1) > _MOST / 2)
        return _confirmed(readings, candidates)


def _confirmed(readings: NDArray[np.floating], candidates: NDArray[np.intp]) -> list[int]:
    found, start = list[int](), 0
    for window in candidates.tolist():
        around = slice(max(start, (window - 4) * _WINDOW), (window + 4) * _WINDOW)
        frame = around.start + _largest_step(readings[around])
        if frame - start < MIN_FRAMES or len(readings) - frame < MIN_FRAMES:
            continue
        if _at_once(readings, frame) and _is_step(readings[start:frame], readings[frame:]):
            found.append(frame)
            start = frame
    return found


def _largest_step(readings: NDArray[np.floating]) -> int:
    """Return the frame that separates frames at the first level from frames at the last level."""
    values = readings.astype(np.float64)
    low, high = (
        np.median(part, axis=0) for part in (values[: 2 * _WINDOW], values[-2 * _WINDOW :])
    )
    moved = low != high
    values, low, high = values[:, moved], low[moved], high[moved]
    nearer = (np.abs(values - low) - np.abs(values - high)) / np.abs(high - low)
    return int(np.argmin(np.cumsum(nearer.sum(axis=1)))) + 1


def _at_once(readings: NDArray[np.floating], frame: int) -> bool:
    """Return whether nearly all sensors change between the preceding frame and a frame.

    Contacts that begin and end together change fewer sensors, or take several frames.
    """
    near = readings[frame - _SIDE : frame + _SIDE].astype(np.float64)
    before, after = np.split(near, 2)
    change = np.median(after, axis=0) - np.median(before, axis=0)
    noise = _level(readings[frame - MIN_FRAMES : frame + MIN_FRAMES])[1]
    moved = np.abs(change) > noise * _CERTAIN * 1.25 * (2 / _SIDE) ** 0.5  # of two medians
    at_once = np.sign(change) * (after[0] - before[-1]) > np.abs(change) / 2
    return bool(moved.mean() > _NEARLY_ALL and at_once[moved].mean() > _MOST)


def _level(readings: NDArray[np.floating]) -> tuple[Floats, Floats]:
    """Return the median of each sensor, and the standard deviation of its noise."""
    steps = np.abs(np.diff(readings.astype(np.float64), axis=0))
    return np.median(readings, axis=0).astype(np.float64), np.median(steps, axis=0) / 0.954


def _apart(before: tuple[Floats, Floats], after: tuple[Floats, Floats]) -> bool:
    """Return whether most sensors differ by more than noise, and some differ to each side."""
    step, noise = after[0] - before[0], np.maximum(before[1], after[1])
    up, down = (float(np.mean(sign * step > _NOISE * noise)) for sign in (1, -1))
    return up + down > _MOST and min(up, down) > _EACH_SIDE


def _is_step(before: NDArray[np.floating], after: NDArray[np.floating]) -> bool:
    """Return whether two parts rest at different levels."""
    after = after[: 4 * MIN_FRAMES]  # a later step may follow
    levels = _level(before), _level(after)
    if not _apart(*levels):
        return False
    (low, noise), (high, _) = levels
    step, noise = high - low, np.maximum(noise, levels[1][1])
    moved = np.abs(step) > _NOISE * noise
    middle, sign = (low + high) / 2, np.sign(step)
    # A contact moves readings to one side; readings do not reach the level on the other side.
    visits = (
        (sign * (before - middle) > 0).mean(axis=0),
        (sign * (after - middle) < 0).mean(axis=0),
    )
    free = (np.minimum(*visits) <= _BEYOND) & (np.maximum(*visits) <= _TOUCHED)
    rests = [
        (np.abs(part - level[0]) <= _NOISE * np.maximum(noise, np.abs(step) / 20)).mean(axis=0)
        for part, level in zip((before, after), levels, strict=True)
    ]
    resting = np.minimum(*rests) >= _AT_REST
    return bool((free & resting)[moved].mean() > _NEARLY_ALL)
