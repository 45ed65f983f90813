"""Unsuitable stimulation: beyond the range of sensors, of separate regions, or of one period."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.health.recording_faults import Found
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.numerics.columns import columns
from anisomap.recording import Recording

_MIN_CLIPPED = 10  # frames at the limit
_LEVELS = 3  # adjacent to the limit, none of which may be half as frequent
_MAX_BRIDGES = 3  # sensors touched with both regions; fewer do not determine their arrangement
_MIN_REGION = 0.1  # share of the sensors in the smaller region
_MAX_FRAMES = 8192  # frames in which regions are searched for
_N_SPLITS = 39  # frames at which a recording may be divided
_STRAY = 0.02  # share of a sensor's active frames with the other region


def find_clipped(recording: Recording) -> Iterator[Found]:
    """Find sensors whose readings are limited by a range that is too small.

    Deep contacts are rarer than shallow ones, so the extreme reading of a sensor should not be
    twice as frequent as each adjacent value. A repeated reading counts once.
    """
    readings, shares = recording.readings, np.zeros(recording.n_sensors)
    for sign, limit in zip((-1, 1), recording.extremes, strict=True):
        counts = np.count_nonzero(readings == limit, axis=0)
        often = np.flatnonzero((counts >= _MIN_CLIPPED) & (counts <= 0.5 * len(readings)))
        for i, column in zip(often.tolist(), columns(readings[:, often]), strict=True):
            shares[i] = max(shares[i], _at_limit(sign * column))
    clipped = np.flatnonzero(shares)
    if clipped.size:
        share = float(np.median(shares[clipped]))
        yield Found(clipped, share, {"n_sensors": recording.n_sensors})


def _at_limit(column: NDArray[Any]) -> float:
    """Return the share of a sensor's frames, (T,), at its highest reading; 0 unless clipped."""
    frames = np.unique(column, return_counts=True)[1]
    times = np.unique(column[np.diff(column, prepend=np.nan) != 0], return_counts=True)[1]
    beside = times[-1 - _LEVELS : -1].max(initial=0)
    often = times[-1] >= MIN_CONTACTS and times[-1] > 2 * beside
    return float(frames[-1] / column.size) if often and frames.argmax() != frames.size - 1 else 0.0


def find_regions(recording: Recording) -> Iterator[Found]:
    """Find two regions of the skin that were never touched simultaneously."""
    step = -(-recording.n_frames // _MAX_FRAMES)
    active = recording.signals.active[::step]
    n_frames, n_sensors = active.shape
    splits = np.linspace(0, n_frames, _N_SPLITS + 2).astype(int)
    between = [np.count_nonzero(active[a:b], axis=0) for a, b in pairwise(splits)]
    sums = np.cumsum(between, axis=0)
    touched = sums[-1] >= 5
    if n_frames < 2 * _N_SPLITS or np.count_nonzero(touched) < 2 * _MAX_BRIDGES:
        return
    shares = sums[:-1] / np.maximum(sums[-1], 1)
    before, after = touched & (shares >= 1 - _STRAY), touched & (shares <= _STRAY)
    bridges = np.count_nonzero(touched & ~before & ~after, axis=1)
    sizes = np.minimum(before.sum(axis=1), after.sum(axis=1))
    sizes[bridges >= _MAX_BRIDGES] = 0
    best = int(sizes.argmax())
    if sizes[best] >= max(3, _MIN_REGION * n_sensors):
        parts = np.flatnonzero(before[best]), np.flatnonzero(after[best])
        values = {
            "sizes": tuple(part.size for part in parts),
            "frame": int(splits[best + 1] * step),
        }
        yield Found(min(parts, key=len), bridges[best], values)


_MIN_SENSORS = 0.8  # share of the sensors that have one period; chosen by hand
_MIN_CYCLES = 3  # of a recording that is one sine
_HALF_LINE = 2  # frequencies on each side that belong to a line
# At a lower frequency, or among fewer frequencies, a line is as wide as the spectrum of contacts,
# and must contain all variance: of 720 clean recordings of 50 frames, 11 had .7, and 2 had .95.
_MIN_NARROW, _MIN_FREQUENCIES = 4 * _HALF_LINE, 10 * (2 * _HALF_LINE + 1)
_ALL_OF_IT = 0.95
_MIN_LINE_SHARE = 0.7  # share of the variance in one line; less for a contact per turn; by hand


def one_period(recording: Recording) -> tuple[float, float] | None:
    """Return a sine's share of the variance, and its period in frames, if it is most of it."""
    if recording.n_frames < 8 * _MIN_CYCLES:
        return None
    power = recording.signals.spectra[1]
    power = power[:, power.any(axis=0)]
    if power.shape[1] < 3:
        return None
    peak = 1 + power[1:].argmax(axis=0)
    near = np.abs(np.arange(len(power))[:, None] - peak) <= _HALF_LINE
    line = (power * near).sum(axis=0) / power[1:].sum(axis=0)
    usual = int(np.median(peak))
    share = float(np.median(line))
    narrow = usual >= _MIN_NARROW and len(power) > _MIN_FREQUENCIES
    least = _MIN_LINE_SHARE if narrow else _ALL_OF_IT
    same = np.mean((np.abs(peak - usual) <= 1) & (line >= least))
    if usual < _MIN_CYCLES or same < _MIN_SENSORS:
        return None
    return share, recording.n_frames / usual
