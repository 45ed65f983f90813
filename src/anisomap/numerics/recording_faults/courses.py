"""Recordings that cannot show where sensors are: one period, separate regions, clipped readings."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.columns import columns, count_values
from anisomap.numerics.signals import some_sensors

_MIN_LINE_SHARE = 0.7  # share of the variance in one line; a contact once a turn has less; by hand
_MIN_CYCLES = 3
_MIN_SENSORS = 0.8  # share of the sensors with the same period
_MIN_CLIPPED = 10  # frames at the limit
_MIN_LEVELS = 16  # distinct values of a sensor that can be clipped; fewer are quantised
_LEVELS = 3  # beside the limit, of which none may be half as frequent
_TOP = 0.05  # share of the range below the limit, for comparison
_MAX_BRIDGES = 3  # sensors touched with both regions: fewer cannot fix their relative place
_MIN_REGION = 0.1  # share of the sensors in the smaller region
_SENSORS_AT_ONCE = 8  # whose lines are computed, until too few sensors can have one
_N_SPLITS = 39  # moments at which a recording may be divided
_STRAY = 0.02  # share of a sensor's active frames with the other region


def find_one_period(readings: NDArray[Any]) -> tuple[float, float] | None:
    """Find that almost all of the readings is one sine. readings (T, N)."""
    n_frames = len(readings)
    if n_frames < 8 * _MIN_CYCLES or readings.shape[1] < 3:
        return None
    values = readings[: 1 << 15, some_sensors(readings.shape[1], 64)].astype(np.float64)
    n_frames = len(values)
    values -= values.mean(axis=0)
    total = (values**2).sum(axis=0)
    values, total = values[:, total > 0], total[total > 0]
    n_sensors = total.size
    if n_sensors < 3:
        return None
    peaks, lines = [], []
    for begin in range(0, n_sensors, _SENSORS_AT_ONCE):
        part = slice(begin, begin + _SENSORS_AT_ONCE)
        peak, line = _strongest_lines(values[:, part], total[part])
        peaks.append(peak)
        lines.append(line)
        if (
            np.count_nonzero(np.concatenate(lines) >= _MIN_LINE_SHARE)
            + n_sensors
            - (begin + peak.size)
            < _MIN_SENSORS * n_sensors
        ):
            return None
    peak, line = np.concatenate(peaks), np.concatenate(lines)
    usual = int(np.median(peak))
    same = np.mean((np.abs(peak - usual) <= 1) & (line >= _MIN_LINE_SHARE))
    return (n_frames / usual, float(np.median(line))) if same >= _MIN_SENSORS else None


def _strongest_lines(
    values: NDArray[np.float64], total: NDArray[np.float64]
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the frequency of the strongest line of each sensor, and its share of the variance."""
    power = 2 * np.abs(np.fft.rfft(values, axis=0)) ** 2 / len(values) / total
    power[:_MIN_CYCLES] = 0
    peak = power.argmax(axis=0)
    line = [power[max(0, p - 2) : p + 3, i].sum() for i, p in enumerate(peak.tolist())]
    return peak, np.array(line)


def find_clipped(readings: NDArray[Any]) -> dict[int, float]:
    """Find sensors whose readings are limited by a range that is too small.

    readings (T, N).

    The density of heights of contacts falls towards the highest. A sensor is clipped if its extreme
    reading occurs more often than all readings in the 5 % of its range beside it, and in at least
    10 frames. Sensors with fewer than 16 distinct values are not judged.
    """
    found: dict[int, float] = {}
    for i, column in enumerate(columns(readings)):
        lowest, highest = column.min(), column.max()
        for limit, margin in ((highest, -1), (lowest, 1)):
            at_limit = np.count_nonzero(column == limit)
            if at_limit < _MIN_CLIPPED or at_limit > 0.5 * column.size:
                continue
            values, counts = count_values(column)
            beside = counts[-1 - _LEVELS : -1] if margin < 0 else counts[1 : 1 + _LEVELS]
            if at_limit <= 2 * beside.max(initial=0):
                continue  # of readings with few levels
            edge = limit + margin * _TOP * (float(highest) - float(lowest))
            near = np.count_nonzero(
                (column >= edge) & (column < limit)
                if margin < 0
                else (column <= edge) & (column > limit)
            )
            is_rest = values[counts.argmax()] == limit
            if at_limit > near and values.size >= _MIN_LEVELS and not is_rest:
                found[i] = float(at_limit) / column.size
    return found


@dataclass(frozen=True, eq=False)
class Regions:
    """Two regions that were touched one after the other.

    before, after: Sensors of each region.
    bridges: Sensors that were touched with both.
    frame: Frame at which the stimulation moves on.
    """

    before: NDArray[np.intp]
    after: NDArray[np.intp]
    bridges: NDArray[np.intp]
    frame: int


def find_regions(active: NDArray[np.bool_]) -> Regions | None:
    """Find two regions of the skin that were never touched together."""
    n_frames, n_sensors = active.shape
    splits = np.linspace(0, n_frames, _N_SPLITS + 2).astype(int)[:-1]
    between = [np.count_nonzero(active[a:b], axis=0) for a, b in pairwise([*splits, n_frames])]
    sums = np.cumsum(between, axis=0)
    counts = sums[-1]
    touched = counts >= 5
    if n_frames < 2 * _N_SPLITS or np.count_nonzero(touched) < 2 * _MAX_BRIDGES:
        return None
    best = None
    for split, before_split in zip(splits[1:].tolist(), sums, strict=False):
        share = before_split / np.maximum(counts, 1)
        before = np.flatnonzero(touched & (share >= 1 - _STRAY))
        after = np.flatnonzero(touched & (share <= _STRAY))
        bridges = np.flatnonzero(touched & (share > _STRAY) & (share < 1 - _STRAY))
        smaller = min(before.size, after.size)
        if (
            smaller >= max(3, _MIN_REGION * n_sensors)
            and bridges.size < _MAX_BRIDGES
            and (best is None or smaller > min(best.before.size, best.after.size))
        ):
            best = Regions(before, after, bridges, split)
    return best
