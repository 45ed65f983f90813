"""Unsuitable stimulation: too strong for the range of sensors, or of one region at a time."""

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
_LEVELS = 3  # beside the limit, of which none may be half as frequent
_MAX_BRIDGES = 3  # sensors touched with both regions: fewer cannot fix their relative place
_MIN_REGION = 0.1  # share of the sensors in the smaller region
_MAX_FRAMES = 8192  # in which regions are searched for
_N_SPLITS = 39  # moments at which a recording may be divided
_STRAY = 0.02  # share of a sensor's active frames with the other region


def find_clipped(recording: Recording) -> Iterator[Found]:
    """Find sensors whose readings are limited by a range that is too small.

    High contacts are rarer than low ones, so the extreme reading of a sensor should not occur twice
    as often as each of the values next to it. A reading that lasts occurs once.
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
        yield Found(
            clipped,
            share,
            f"{clipped.size} of {recording.n_sensors} sensors are at the end of their range in "
            f"{share:.1%} of the frames (median)",
        )


def _at_limit(column: NDArray[Any]) -> float:
    """Return the share of a sensor's frames, (T,), at its highest reading; 0 unless clipped."""
    frames = np.unique(column, return_counts=True)[1]
    times = np.unique(column[np.diff(column, prepend=np.nan) != 0], return_counts=True)[1]
    beside = times[-1 - _LEVELS : -1].max(initial=0)
    often = times[-1] >= MIN_CONTACTS and times[-1] > 2 * beside
    return float(frames[-1] / column.size) if often and frames.argmax() != frames.size - 1 else 0.0


def find_regions(recording: Recording) -> Iterator[Found]:
    """Find two regions of the skin that were never touched together."""
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
        yield Found(
            min(parts, key=len),
            bridges[best],
            f"two regions of {parts[0].size} and {parts[1].size} sensors were touched one "
            f"after the other, the second from frame {splits[best + 1] * step} on, and "
            f"{bridges[best] or 'no'} sensors with both",
        )
