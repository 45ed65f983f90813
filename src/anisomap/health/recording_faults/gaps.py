"""Gaps: readings that are lost, that something interpolated, or that repeat the ones before."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from anisomap.health.recording_faults import Found, with_readings
from anisomap.numerics.columns import columns
from anisomap.numerics.gaps import fill_gaps
from anisomap.numerics.signals import standardised
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
_MIN_PRESENT = 0.5  # share of the weight of similar sensors that have readings
# Share of the other readings that repeat: of more, contacts are still, and no noise tells. Also of
# those of the typical sensor, if all must repeat. By hand.
_MAX_STILL, _MAX_STILL_EACH = 0.05, 1 / 3
_MAX_FROZEN = 0.5  # of the frames; more are a rest


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
        lines = bool(np.isfinite(readings[missing]).any())
        values = {"n_sensors": recording.n_sensors, "lines": lines}
        mend = with_readings(lambda readings: _filled(readings, missing))
        yield Found(affected, typical, values, mend)


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
    """Estimate missing readings of sensors from similar ones where that is better than lines.

    Whether it is better is seen from known readings: those of other frames, as many and as long in
    a row. Where most of the similar sensors miss readings as well, lines are kept.
    """
    completed = fill_gaps(np.where(missing, np.nan, readings))
    rest = estimate_rest(completed)
    depth, standard = rest.depth(completed), standardised(completed)
    for i in np.flatnonzero(missing.any(axis=0)).tolist():
        gap = missing[:, i]
        held = np.roll(gap, len(gap) // 2) & ~gap
        fitted = np.flatnonzero(~gap & ~held)
        fitted = fitted[:: max(1, fitted.size // _MAX_FITTED)]
        similarity = standard[fitted].T @ standard[fitted, i]
        similarity[i] = -np.inf
        partners = np.argsort(-similarity, kind="stable")[:_N_PARTNERS]
        partners = partners[similarity[partners] > 0]
        if fitted.size < 2 * _N_PARTNERS or not partners.size or not depth[fitted, i].any():
            continue
        weights, _ = nnls(depth[np.ix_(fitted, partners)], depth[fitted, i])
        present = ~missing[:, partners] @ weights > _MIN_PRESENT * weights.sum()
        estimate = depth[:, partners] @ weights
        # Scaled to the highest known depth: clipping would leave many equal readings.
        highest = estimate[gap & present].max(initial=1e-300)
        estimate *= min(1.0, depth[fitted, i].max() / highest)
        noise = rest.threshold[i] * (estimate > 0)
        estimate = rest.value[i] + rest.side[i] * (estimate + noise)
        held &= present
        known = np.where(gap | held, np.nan, completed[:, i])
        lines, true = fill_gaps(known[:, None])[held, 0], completed[held, i]
        if np.sum((estimate[held] - true) ** 2) < np.sum((lines - true) ** 2):
            completed[gap & present, i] = estimate[gap & present]
    return np.asarray(completed)


def find_frozen(recording: Recording) -> Iterator[Found]:
    """Find frames in which all sensors, or else some, repeat their readings.

    If a share p of the other readings repeats the one before, n in succession do so with
    probability N T p^n at most, in T frames of N sensors. Where readings often repeat, no noise
    shows that time passes: a still contact looks the same, and nothing is found. Nor are readings
    at rest, or at an end of the range.
    """
    varying = np.flatnonzero(recording.varying())
    readings = recording.readings[:, varying]
    if varying.size < 2 or len(readings) < 2 * _MIN_LINE:
        return
    repeats = np.zeros(readings.shape, dtype=bool)
    np.equal(readings[1:], readings[:-1], out=repeats[1:])
    share = repeats.mean(axis=0)
    whole = _long_spans(np.asarray(repeats.all(axis=1)), readings, 1)
    if whole is not None and np.median(share) <= whole.mean() + _MAX_STILL_EACH:
        kept = np.flatnonzero(~whole)

        def left(recording: Recording) -> Recording:
            times = None if recording.times is None else recording.times[kept]
            return replace(recording, readings=recording.readings[kept], times=times)

        yield Found(varying, float(whole.mean()), {"n_sensors": varying.size}, left)
        return
    some = np.flatnonzero((share >= _MIN_MISSING) & (share <= _MAX_FROZEN))
    found = [_long_spans(repeats[:, i], readings[:, [i]], varying.size) for i in some]
    sizes = [0.0 if spans is None else float(spans.mean()) for spans in found]
    if any(sizes):
        sensors = varying[some[np.array(sizes) > 0]]
        size = float(np.median([one for one in sizes if one > 0]))
        yield Found(sensors, size, {"n_sensors": varying.size})


def _long_spans(
    repeats: NDArray[np.bool_], readings: NDArray[Any], n_tests: int
) -> NDArray[np.bool_] | None:
    """Mark the frames, (T,), in long spans of repeated readings, (T, n); None without any."""
    start, stop = np.flatnonzero(np.diff(repeats, prepend=False, append=False)).reshape(-1, 2).T
    long = stop - start >= _MIN_LINE
    if not long.any():
        return None
    others = np.repeat(True, len(repeats))
    others[np.flatnonzero(repeats)] = np.repeat(~long, stop - start)
    usual = readings[start] == estimate_rest(readings[others]).value.astype(readings.dtype)
    if readings.shape[1] == 1:
        usual |= (readings[start] == readings.min()) | (readings[start] == readings.max())
    long &= ~usual.all(axis=1)
    n_others = len(repeats) - int((stop - start)[long].sum())
    share = max(n_others - int(np.count_nonzero(~repeats)), 1) / n_others
    if share > _MAX_STILL:
        return None
    long &= stop - start >= math.log(len(repeats) * n_tests / _FALSE_ALARMS) / -math.log(share)
    found = np.zeros_like(repeats)
    found[np.flatnonzero(repeats)] = np.repeat(long, stop - start)
    return found if found.mean() >= _MIN_MISSING else None
