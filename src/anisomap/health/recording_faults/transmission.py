"""Errors of transmission: readings that are lost, far off, or that jump for one frame."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from anisomap.health.recording_faults import (
    Found,
    has_contacts,
    in_readings,
    linked_groups,
)
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.numerics.columns import columns
from anisomap.numerics.gaps import fill_gaps
from anisomap.numerics.signals import (
    count_contacts,
    excerpt_frames,
    medians,
    some_sensors,
    standardised,
    unit_rows,
)
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording

_MIN_MISSING = 0.02  # share of a sensor's readings; fewer change no correlation; chosen by hand
_FALSE_ALARMS = 0.01  # expected number of straight lines that are found by chance
_ROUNDING = 1e-6  # share of the largest reading: some steps of float32
_MIN_LINE = 8  # frames; two contacts of a frame each make shorter lines; chosen by hand
_MIN_RISE = 0.03  # of the range: a slow drift rises less between two contacts; chosen by hand
_MIN_MIXED = 0.15  # share of the lines against the direction of the other lines of their sensor
_N_PARTNERS = 8  # most similar sensors from which readings are estimated; chosen by hand
_MAX_FITTED = 20_000  # of a fit


def find_gaps(recording: Recording) -> Iterator[Found]:
    """Find readings that are missing, or on straight lines; the recording may be incomplete."""
    readings = recording.readings
    on_lines = find_bridged(readings)
    if not on_lines and np.isfinite(recording.extremes).all():
        return
    missing = ~np.isfinite(readings)
    for i, bridged in on_lines.items():
        missing[bridged, i] = True
    share = missing.mean(axis=0)
    missing &= (share >= _MIN_MISSING) & (share < 1)
    affected = np.flatnonzero(missing.any(axis=0))
    if affected.size:
        typical = float(np.median(share[affected]))
        known = np.isfinite(readings[missing]).any()
        yield Found(
            affected,
            typical,
            f"{typical:.0%} of the readings of {affected.size} of {recording.n_sensors} sensors "
            f"are {'on straight lines, as if interpolated' if known else 'missing'}",
            in_readings(lambda readings: _filled(readings, missing)),
        )


def find_bridged(readings: NDArray[Any]) -> dict[int, NDArray[np.intp]]:
    """Find readings on straight lines that are too long to occur by chance, of each sensor.

    If a share p of a sensor's readings continues a line, a line of n readings occurs in T frames of
    N sensors with probability N T p^n at most. Lines of a sensor that rise little are parts of a
    slow drift.
    """
    n_frames, n_sensors = readings.shape
    if n_frames < 2 * _MIN_LINE:
        return {}
    found, n_lines, n_fewer = {}, 0, 0
    perhaps = np.flatnonzero(_may_have_lines(readings))
    for i, column in zip(perhaps.tolist(), columns(readings[:, perhaps]), strict=True):
        lines = _lines(column.astype(np.float64), n_sensors)
        if lines is not None:
            found[i], rises = lines
            n_rising = int(np.count_nonzero(rises > 0))
            n_lines += rises.size
            n_fewer += min(n_rising, rises.size - n_rising)
    return found if n_fewer >= _MIN_MIXED * n_lines else {}


def _may_have_lines(readings: NDArray[Any]) -> NDArray[np.bool_]:
    """Return whether sensors may have `_MIN_LINE` readings on a line, with twice the slack, (N,).

    Only every fourth frame is examined, with the frames beside it: a line of `_MIN_LINE` readings
    contains two of these in succession. Differences of float32 readings are rounded by less than
    the slack.
    """
    slack = 2 * _ROUNDING * np.maximum(readings.max(axis=0), -readings.min(axis=0))
    before, middle, after = (readings[i : len(readings) - 2 + i : _MIN_LINE // 2] for i in range(3))
    with np.errstate(invalid="ignore", over="ignore"):
        slope = after - middle
        on_line = np.abs(slope - (middle - before)) <= 2 * slack
        on_line &= np.abs(slope) > slack
    return np.asarray((on_line[1:] & on_line[:-1]).any(axis=0) | ~np.isfinite(slack))


def _lines(
    column: NDArray[np.float64], n_sensors: int
) -> tuple[NDArray[np.intp], NDArray[np.float64]] | None:
    """Return the readings on long lines of a sensor, and by how much each line rises, if any."""
    slack = _ROUNDING * np.nanmax(np.abs(column), initial=0)
    with np.errstate(invalid="ignore"):
        slope = np.diff(column)
        on_line = (np.abs(np.diff(slope)) <= 2 * slack) & (np.abs(slope[1:]) > 4 * slack)
    share = float(np.mean(on_line))
    if not 0 < share < 1:
        return None
    enough = math.log(column.size * n_sensors / _FALSE_ALARMS) / -math.log(share)
    start, stop = np.flatnonzero(np.diff(on_line, prepend=False, append=False)).reshape(-1, 2).T
    long = stop - start >= max(_MIN_LINE, enough)
    rises = (column[stop] - column[start])[long]
    least = _MIN_RISE * (np.nanmax(column) - np.nanmin(column))
    if not rises.size or np.median(np.abs(rises)) < least:
        return None
    return np.flatnonzero(on_line)[np.repeat(long, stop - start)] + 1, rises


def _filled(readings: NDArray[Any], missing: NDArray[np.bool_]) -> NDArray[Any]:
    """Estimate missing readings of sensors from similar ones; where there are none, by lines."""
    completed = fill_gaps(np.where(missing, np.nan, readings))
    rest = estimate_rest(completed)
    depth, standard = rest.depth(completed), standardised(completed)
    for i in np.flatnonzero(missing.any(axis=0)).tolist():
        known = np.flatnonzero(~missing[:, i])
        known = known[:: max(1, known.size // _MAX_FITTED)]
        similarity = standard[known].T @ standard[known, i]
        similarity[i] = -np.inf
        partners = np.argsort(-similarity, kind="stable")[:_N_PARTNERS]
        partners = partners[similarity[partners] > 0]
        if known.size < 2 * _N_PARTNERS or not partners.size or not depth[known, i].any():
            continue
        weights, _ = nnls(depth[np.ix_(known, partners)], depth[known, i])
        gap = np.flatnonzero(missing[:, i])
        estimate = depth[np.ix_(gap, partners)] @ weights
        # Scaled to the highest known depth: clipping would leave many equal readings.
        estimate *= min(1.0, depth[known, i].max() / max(estimate.max(), 1e-300))
        noise = rest.threshold[i] * (estimate > 0)
        completed[gap, i] = rest.value[i] + rest.side[i] * (estimate + noise)
    return np.asarray(completed)


# Multiple of the reach of the typical sensor and of its sensor's other readings; chosen by hand.
_FAR = 10.0
_SAMPLE = 1024  # frames of which the median is taken
_MAX_GLITCHES = 0.01  # of the readings of a sensor: more are saturation, or contact


def find_glitches(recording: Recording) -> Iterator[Found]:
    """Find readings that jump far beyond all others of their sensor and of sensors in contact.

    A contact is also far beyond the noise of other sensors, so nothing is found unless some sensors
    were touched several times. What approaches a sensor raises its readings steeply, but by
    degrees: there are readings as high as other contacts beside the highest ones. High readings at
    the beginning or end of the recording may be parts of contacts.
    """
    readings, n_frames = recording.readings, recording.n_frames
    count = int(_MAX_GLITCHES * n_frames)
    if not count:
        return
    middle = medians(readings[:: -(-n_frames // _SAMPLE)]).astype(np.float64)
    lowest, highest = recording.extremes
    reach = np.maximum(highest - middle, middle - lowest)
    varying = reach[reach > 0]
    if not varying.size or varying.max() <= _FAR * np.median(varying):
        return
    touched = recording.signals.contacts >= MIN_CONTACTS
    typical = float(np.median(reach[touched])) if touched.any() else math.inf
    far = np.flatnonzero(reach > _FAR * typical)
    deviation = np.abs(readings[:, far] - middle[far])
    own = np.partition(deviation, n_frames - 1 - count, axis=0)[n_frames - 1 - count]
    usual = np.maximum(own, typical)
    wrong = deviation > _FAR * usual
    # Beside a glitch may be a contact, but none of a hundredth of the highest glitches.
    least = np.maximum(usual, deviation.max(axis=0, initial=0) / _FAR**2)
    for i, high in enumerate((deviation > least).T):
        by_degrees = high & ~wrong[:, i]
        by_degrees[[0, -1]] = True  # a contact may begin or end there
        wrong[:, i] &= ~_in_runs_with(by_degrees, high)
    affected, number = far[wrong.any(axis=0)], np.count_nonzero(wrong)
    if number:
        yield Found(
            affected,
            float(number),
            f"{number} readings of {affected.size} sensors are far beyond all others",
            in_readings(lambda readings: _interpolated(readings, far, wrong)),
        )


def _in_runs_with(some: NDArray[np.bool_], frames: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Mark runs of frames, (T,), that contain some of them."""
    run = np.cumsum(np.diff(frames, prepend=False))  # odd within runs
    return np.asarray(frames & np.isin(run, run[some]))


def _interpolated(
    readings: NDArray[Any], sensors: NDArray[np.intp], wrong: NDArray[np.bool_]
) -> NDArray[Any]:
    """Replace readings of some sensors, (T, n), by a line between the readings beside them."""
    mended, frames = np.array(readings), np.arange(len(readings))
    for i, bad in zip(sensors.tolist(), wrong.T, strict=True):
        mended[bad, i] = np.interp(frames[bad], frames[~bad], readings[~bad, i])
    return mended


_MIN_GROUP = 5  # sensors of a board; three or four may be touched alike by a flat object
_MIN_LEVELS = 8  # distinct heights of jumps: sensors with two values always jump by the same
_MIN_SPIKES = 5  # in a recording
_MAX_SPIKES = 0.15  # of the frames; white noise jumps up in a third of them
_MIN_LINK = 0.7  # correlation of the jumps of two sensors of a board; chosen by hand
_MIN_HEIGHT = 0.1  # standard deviations of the readings; less changes no correlation
_MIN_EQUAL = 0.5  # share of the common jumps that are spikes; chosen by hand
_MIN_JUDGED = 20  # common jumps; in fewer, half that share cannot be required; chosen by hand
_MAX_SPREAD = 0.1  # relative spread of the jumps of the sensors of a board; contacts have 0.3
_FRAMES_AT_ONCE, _SENSORS_AT_ONCE = 4096, 64  # of which jumps are computed; they fit in the cache
_MAX_SENSORS = 1024  # in which spikes are searched for
_STEEP = 2.0  # height of a spike over the changes beside it; tops of contacts have less; by hand
_MIN_DURATION = 2.0  # times that of contacts in shuffled frames, which look like spikes; by hand
_MIN_AT_ONCE = 0.6  # share of the sensors of a board that must jump: the others are in contact


def find_spikes(recording: Recording) -> Iterator[Found]:
    """Find spikes that groups of sensors share.

    A contact rises and falls over several frames or is highest in the middle; a spike of a board
    lasts one frame and is equally high in all of its sensors. Sensors are grouped by the
    correlation of their jumps, the excess of a reading over both readings beside it. A group is not
    judged if it has no other contacts, or only contacts of single frames or of one kind.
    """
    n_frames, n_sensors = recording.readings.shape
    if n_frames < 100 or n_sensors < _MIN_GROUP:
        return
    chosen = some_sensors(n_sensors, _MAX_SENSORS)
    jumps = _jumps(recording.readings, chosen, excerpt_frames(recording.readings))
    jumping = np.count_nonzero(jumps, axis=1) >= _MIN_SPIKES
    if np.count_nonzero(jumping) < _MIN_GROUP:
        return
    chosen, jumps = chosen[jumping], jumps[jumping]
    for group in linked_groups(unit_rows(jumps.T), _MIN_LINK, _MIN_GROUP):
        if _may_be_equal(jumps[group]):
            yield from _shared(recording, chosen[group])


def _jumps(readings: NDArray[Any], sensors: NDArray[np.intp], frames: slice) -> NDArray[np.float32]:
    """Return the excess of readings over both readings beside them, shape (n, t); at least 0.

    It is 0 in the first and the last frame.
    """
    jumps = np.zeros((sensors.size, len(range(len(readings))[frames])), dtype=np.float32)
    for begin in range(0, sensors.size, _SENSORS_AT_ONCE):
        part = slice(begin, begin + _SENSORS_AT_ONCE)
        values = readings.T[sensors[part], frames]
        # Single precision would lose small changes of large readings.
        values = (values - values[:, :1]).astype(np.float32, copy=False)
        beside = np.maximum(values[:, :-2], values[:, 2:])
        np.subtract(values[:, 1:-1], beside, out=beside)
        np.maximum(beside, 0, out=jumps[part, 1:-1])
    return jumps


def _may_be_equal(jumps: NDArray[np.float32]) -> bool:
    """Return whether jumps of a group, shape (n, t), can be spikes, or are too few to tell."""
    frames = _jumping_together(jumps)
    if frames.size < _MIN_JUDGED:
        return frames.size > 0
    return bool(np.mean(_equal(jumps[:, frames])[1]) >= _MIN_EQUAL / 2)


def _jumping_together(jumps: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the frames in which most sensors jump."""
    return np.flatnonzero(np.count_nonzero(jumps, axis=0) >= _MIN_AT_ONCE * len(jumps))


def _equal(heights: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return the median height of jumps, shape (n, t), and where all are about equally high."""
    height = np.median(heights, axis=0)
    spread = np.median(np.abs(heights - height), axis=0) / np.maximum(height, 1e-30)
    return height, spread <= _MAX_SPREAD


def _shared(recording: Recording, members: NDArray[np.intp]) -> Iterator[Found]:
    """Find the spikes of a group; there are none if its jumps differ, as those of contacts do."""
    readings, n_frames = recording.readings, recording.n_frames
    often, tall = [], []
    for begin in range(1, n_frames - 1, _FRAMES_AT_ONCE):
        stop = min(begin + _FRAMES_AT_ONCE, n_frames - 1)
        jumps = _jumps(readings, members, slice(begin - 1, stop + 1))[:, 1:-1]
        found = _jumping_together(jumps)
        often.append(begin + found)
        tall.append(jumps[:, found])
    frames, heights = np.concatenate(often), np.concatenate(tall, axis=1)
    around = np.clip(frames + np.array([[-2], [-1], [1], [2]]), 0, n_frames - 1)
    beside = readings[around[..., None], members]
    changes = np.maximum(np.abs(beside[1] - beside[0]), np.abs(beside[2] - beside[3]))
    steep = np.median(heights, axis=0) > _STEEP * np.median(changes, axis=1)
    frames, (height, equal) = frames[steep], _equal(heights[:, steep])
    if not _MIN_SPIKES <= frames.size <= _MAX_SPIKES * n_frames:
        return
    frames, height = frames[equal], height[equal]
    if (
        frames.size < max(_MIN_SPIKES, _MIN_EQUAL * equal.size)
        or _n_distinct(height) < min(_MIN_LEVELS, frames.size / 2)
        or np.median(height) < _MIN_HEIGHT * np.median(readings[:, members].std(axis=0))
        or not _persist(np.delete(recording.signals.touched[:, members], frames, axis=0))
    ):
        return
    mend = in_readings(lambda readings: _smoothed(readings, frames, members))
    if not has_contacts(mend(recording), members):
        return
    yield Found(
        members,
        frames.size / n_frames,
        f"a group of {members.size} sensors jumps for single frames, {frames.size} times by ",
        mend,
        height=float(np.median(height)),
    )


def _n_distinct(heights: NDArray[np.float32]) -> int:
    """Count heights, shape (n,), that differ by more than rounding."""
    return int(np.unique((heights / heights.max()).round(6)).size)


def _persist(touched: NDArray[np.bool_]) -> bool:
    """Return whether contacts, shape (t, n), last clearly longer than in shuffled frames."""
    n_frames = np.count_nonzero(touched) * (1 - touched.mean())
    return bool(n_frames > _MIN_DURATION * count_contacts(touched).sum())


def _smoothed(
    readings: NDArray[Any], frames: NDArray[np.intp], sensors: NDArray[np.intp]
) -> NDArray[Any]:
    """Replace readings of some sensors in some frames by the mean of the frames beside them."""
    mended = np.array(readings)
    beside = (readings[frames - 1] + readings[frames + 1]) / 2
    mended[np.ix_(frames, sensors)] = beside[:, sensors]
    return mended
