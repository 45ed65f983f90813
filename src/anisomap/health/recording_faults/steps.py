"""Steps of the reading at rest, of several sensors at once: a supply or an amplifier that jumps."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.health.recording_faults import Found
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.numerics.signals import excerpt_frames, unit_rows
from anisomap.recording import Recording

# Chosen by hand on the seeds 741 to 750 of benchmark `faults`, and on blocks that are moved from
# place to place at once, of which 2 of 360 recordings are accused.
_WINDOW, _N_WINDOWS = 25, 8  # frames whose median is taken; windows on either side
_MIN_SENSORS, _MAX_MOMENTS = 3, 40  # that step at once; moments that are examined
_NOISE, _FINEST = 6.0, 1e-3  # deviations of the noise of a step, which is this share of the range
_NEAR = 5  # frames on either side in which most of a step is made
_BEYOND, _TOUCHED, _AT_REST = 0.02, 0.3, 0.5  # shares of frames
_MAX_AGAIN, _MAX_ALIKE = 0.3, 0.5  # see `find_steps`
_N_SIMILAR = 3


def find_steps(recording: Recording) -> Iterator[Found]:
    """Find sensors whose reading at rest steps, to both sides, at one frame and for good.

    A contact that begins or ends moves sensors to one side. Where one contact replaces another,
    most similar sensors move alike, return to levels that they had, or are few of those that move
    at this frame. Skins that are hardly touched are not judged.
    """
    readings, signals = recording.readings, recording.signals
    n_windows = len(readings) // _WINDOW
    if n_windows < 2 * _N_WINDOWS or np.median(signals.contacts) < MIN_CONTACTS:
        return
    changes = np.abs(np.diff(readings[excerpt_frames(readings)], axis=0))
    noise = np.median(changes, axis=0) / 0.954  # of the differences of two normal numbers
    noise = np.maximum(noise, _FINEST * np.ptp(readings, axis=0)).astype(np.float64)
    least = _NOISE * np.maximum(noise, 1e-300)
    windows = readings[: n_windows * _WINDOW].reshape(n_windows, _WINDOW, -1)
    medians = np.median(windows, axis=1).astype(np.float64)
    several = np.lib.stride_tricks.sliding_window_view(medians, _N_WINDOWS, axis=0)
    level = np.median(several, axis=-1)
    at = np.arange(n_windows)
    change = level[np.minimum(at, len(level) - 1)] - level[np.maximum(at - _N_WINDOWS, 0)]
    change[:2] = change[-1:] = 0
    counts = np.count_nonzero(np.abs(change) > least, axis=1)
    frames, stepping = set[int](), np.zeros(len(noise), dtype=bool)
    for _ in range(_MAX_MOMENTS):
        i = int(counts.argmax())
        if counts[i] < _MIN_SENSORS:
            break
        counts[max(0, i - 2) : i + 3] = 0
        moved = np.abs(change[i]) > least
        near = readings[(i - 2) * _WINDOW : (i + 2) * _WINDOW, moved].astype(np.float64)
        jumps = np.diff(near, axis=0) * np.sign(change[i, moved]) > np.abs(change[i, moved]) / 2
        frame = (i - 2) * _WINDOW + 1 + int(jumps.sum(axis=1).argmax())
        if frame in frames or not 2 * _WINDOW <= frame <= len(readings) - 2 * _WINDOW:
            continue
        found = _at(recording, frame, least)
        stepping[found] = True
        frames |= {frame} if found.size else set()
    if frames:
        values = {"frames": sorted(frames), "n_sensors": recording.n_sensors}
        yield Found(np.flatnonzero(stepping), float(stepping.mean()), values)


def _at(recording: Recording, frame: int, least: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the sensors that step at a frame; none unless they are as `find_steps` says."""
    readings, reach = recording.readings, _N_WINDOWS * _WINDOW
    before, after = (
        part.astype(np.float64)
        for part in (readings[max(0, frame - reach) : frame], readings[frame : frame + reach])
    )
    low, high = np.median(before, axis=0), np.median(after, axis=0)
    step, jump, sign = high - low, after[0] - before[-1], np.sign(high - low)
    soon = np.median(after[:_NEAR], axis=0) - np.median(before[-_NEAR:], axis=0)
    sudden = (np.abs(soon) > least) & (np.sign(soon) * jump > np.abs(soon) / 2)
    stepping = np.abs(step) > least
    stepping &= sign * np.where(sign * jump < sign * soon, jump, soon) > np.abs(step) / 2
    near = np.maximum(least, _NOISE * np.abs(step) / 20)

    def share(part: NDArray[Any], level: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray((np.abs(part - level) <= near).mean(axis=0))

    # A contact moves readings to one side: the other side of a level at rest is not visited.
    middle = (low + high) / 2
    crossed = [
        (sign * (before - middle) > 0).mean(axis=0),
        (sign * (after - middle) < 0).mean(axis=0),
    ]
    stepping &= (np.min(crossed, axis=0) <= _BEYOND) & (np.max(crossed, axis=0) <= _TOUCHED)
    stepping &= np.minimum(share(before, low), share(after, high)) >= _AT_REST
    stepping &= (
        np.maximum(share(readings[:frame], high), share(readings[frame:], low)) <= _MAX_AGAIN
    )
    some = np.flatnonzero(stepping)
    n_up = np.count_nonzero(step[some] > 0)
    if some.size < max(_MIN_SENSORS, np.count_nonzero(sudden) / 2) or n_up in (0, some.size):
        return some[:0]
    rows = unit_rows(np.diff(readings[excerpt_frames(readings)], axis=0))
    similar = rows[some] @ rows.T
    similar[np.arange(some.size), some] = -np.inf
    nearest = np.argsort(-similar, axis=1, kind="stable")[:, :_N_SIMILAR]
    alike = (np.abs(step) > least)[nearest] & (sign[nearest] == sign[some][:, None])
    return some if alike.any(axis=1).mean() <= _MAX_ALIKE else some[:0]
