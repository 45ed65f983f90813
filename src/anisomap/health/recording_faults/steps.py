"""Steps of readings at rest, by jumps of a supply or an amplifier, or by moved wires."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from anisomap.health.recording_faults import Found
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.numerics.signals import excerpt_frames, medians, normal_maximum, unit_rows
from anisomap.recording import Recording

_WINDOW, _N_WINDOWS = 25, 8  # frames per level, and levels compared on either side
_NOISE, _FINEST = 4.0, 1e-3  # least step in deviations of the noise; least noise relative to range
_NEAR = 5  # frames on either side that contain most of a step
_N_SIMILAR = 8
_MAX_MOMENTS = 40  # maximum number of frames examined
# If a contact moves a sensor, at most this share of similar sensors does not move to the same side;
# and probability of a larger share by chance.
_UNLIKE, _FALSE_ALARMS = 0.2, 0.01


def find_steps(recording: Recording) -> Iterator[Found]:
    """Find sensors whose reading at rest steps at one frame, and does not return.

    Contacts move readings to one side of rest. The level at rest is therefore the quartile furthest
    to the other side of 8 successive windows of 25 frames, unless a contact lasts for all windows.
    A sensor steps if its levels before and after a frame differ by 4 deviations of the noise,
    mostly within 5 frames, and if no level on one side of the step reaches the level on the other
    side. A lasting contact that begins or ends moves levels of similar sensors to one side. Sensors
    that step at a frame are found if the levels of too few of the most similar sensors move to the
    same side, by a binomial test, and if they step to both sides or no similar sensor moves.
    Sensors with fewer than 5 contacts are not judged.
    """
    readings, signals = recording.readings, recording.signals
    n_windows = len(readings) // _WINDOW
    if n_windows < 2 * _N_WINDOWS + 1:
        return
    side = signals.rest.side.astype(readings.dtype)
    changes = np.diff(readings[excerpt_frames(readings)], axis=0)
    size = np.abs(changes)
    noise = medians(size) / 0.954  # of the differences of two normal numbers
    noise = np.maximum(noise, np.where(size > 0, size, np.inf).min(axis=0) / 2)  # quantisation
    noise = np.maximum(noise, _FINEST * np.ptp(readings, axis=0)).astype(np.float64)
    least = _NOISE * noise
    windows = (side * readings[: n_windows * _WINDOW]).reshape(n_windows, _WINDOW, -1)
    windows = np.sort(np.ascontiguousarray(windows.swapaxes(1, 2)), axis=2)  # faster than by frames
    levels = windows[..., _WINDOW // 4].astype(np.float64)
    several = np.lib.stride_tricks.sliding_window_view(levels, _N_WINDOWS, axis=0).min(axis=-1)
    before, after = several[: -_N_WINDOWS - 1], several[_N_WINDOWS + 1 :]  # beside window k + 8
    step = after - before
    lowest_before = np.minimum.accumulate(levels, axis=0)[_N_WINDOWS - 1 :][: len(step)]
    lowest_after = np.minimum.accumulate(levels[::-1], axis=0)[::-1][_N_WINDOWS + 1 :][: len(step)]
    beyond = np.where(step > 0, lowest_after - before, lowest_before - after)
    # The limit is the maximum of as many normal numbers, since slow noise and drift change levels.
    usual = medians(np.abs(step)) / 0.6745 * normal_maximum(step.size)
    stepping = (np.abs(step) > np.maximum(least, usual)) & (beyond > np.abs(step) / 2)
    stepping &= signals.contacts >= MIN_CONTACTS  # with fewer, the side of contact is unknown
    counts = np.count_nonzero(stepping, axis=1)
    rows = unit_rows(changes) if counts.any() else changes.T
    frames, found = set[int](), np.zeros(len(noise), dtype=bool)
    for _ in range(_MAX_MOMENTS):
        k = int(counts.argmax())
        if not counts[k]:
            break
        counts[max(0, k - 2) : k + 3] = 0
        some = np.flatnonzero(stepping[k])
        begin = (k + _N_WINDOWS - 1) * _WINDOW
        near = (side * readings[begin - _NEAR : begin + 3 * _WINDOW + _NEAR]).astype(np.float64)
        soon = np.median(np.lib.stride_tricks.sliding_window_view(near, _NEAR, axis=0), axis=-1)
        change = soon[_NEAR:] - soon[:-_NEAR]
        jumps = np.diff(near, axis=0)[_NEAR - 1 :][: len(change)]
        at = int(np.clip(jumps[:, some] / step[k, some], -1, 1).sum(axis=1).argmax())
        beside = levels[k + _N_WINDOWS + 2] - levels[k + _N_WINDOWS - 2]
        both = np.minimum(change[at, some] / step[k, some], beside[some] / step[k, some])
        some = some[both > 0.5]
        if some.size and not _by_contact(some, np.sign(np.fix(2 * beside / least)), rows):
            frames.add(begin + at)
            found[some] = True
    if frames:
        values = {"frames": sorted(frames), "n_sensors": recording.n_sensors}
        yield Found(np.flatnonzero(found), float(found.mean()), values)


def _by_contact(some: NDArray[np.intp], sign: NDArray[Any], rows: NDArray[Any]) -> bool:
    """Return whether a contact may explain the moves of sensors; sign (N,): of each move, or 0."""
    similar = rows[some] @ rows.T
    similar[np.arange(some.size), some] = -np.inf
    nearest = np.argsort(-similar, axis=1, kind="stable")[:, :_N_SIMILAR]
    alike = sign[nearest] * sign[some][:, None]
    unlike = int(np.count_nonzero(alike <= 0))
    chance = bdtrc(unlike - 1, alike.size, _UNLIKE) if unlike else 1.0
    one_side = np.ptp(sign[some]) == 0 and alike.any()
    return bool(one_side or chance >= _FALSE_ALARMS)
