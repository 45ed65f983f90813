"""Gaps: readings that are missing, or that repeat the preceding readings."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from anisomap.health.recording_faults import Found, with_readings
from anisomap.numerics.columns import fill_gaps
from anisomap.numerics.signals import standardised
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording

_MIN_MISSING = 0.02  # share of a sensor's readings; fewer hardly change correlations; by hand
_FALSE_ALARMS = 0.01  # expected number of spans found by chance
_MIN_SPAN = 8  # successive frames that repeat the preceding frame; chosen by hand
_N_PARTNERS = 8  # most similar sensors from which readings are estimated; chosen by hand
_MAX_FITTED = 20_000  # frames of a fit
_MIN_PRESENT = 0.5  # minimum share of the weight of similar sensors that have readings
# Maximum share of the other readings that repeat: with more, noise does not reveal still contacts.
# The second applies to the typical sensor, if all sensors must repeat. By hand.
_MAX_STILL, _MAX_STILL_EACH = 0.05, 1 / 3
_MAX_FROZEN = 0.5  # share of the frames; a larger share is rest


def find_gaps(recording: Recording) -> Iterator[Found]:
    """Find missing readings of an incomplete recording."""
    if np.isfinite(recording.extremes).all():
        return
    missing = ~np.isfinite(recording.readings)
    share = missing.mean(axis=0)
    missing &= (share >= _MIN_MISSING) & (share < 1)
    affected = np.flatnonzero(missing.any(axis=0))
    if affected.size:
        typical = float(np.median(share[affected]))
        values = {"n_sensors": recording.n_sensors}
        mend = with_readings(lambda readings: _filled(readings, missing))
        yield Found(affected, typical, values, mend)


def _filled(readings: NDArray[Any], missing: NDArray[np.bool_]) -> NDArray[Any]:
    """Estimate missing readings from similar sensors where this is better than interpolation.

    Both estimates are compared on known readings, in gaps of equal number and length in other
    frames. Interpolation is kept where most of the similar sensors lack readings as well.
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
        # Estimates are scaled to the highest known depth: clipping would cause many equal readings.
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
    """Find frames in which all sensors, or else some sensors, repeat their readings.

    If a share p of the other readings repeats the preceding reading, n successive repetitions occur
    with probability N T p^n at most, in T frames of N sensors. Nothing is found if readings often
    repeat, since a still contact without noise looks the same. Readings at rest or at an end of the
    range are not found either.
    """
    varying = np.flatnonzero(recording.varying())
    if varying.size < 2 or recording.n_frames < 2 * _MIN_SPAN:
        return
    readings = recording.select(varying).readings
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
    """Mark the frames, (T,), in long spans of repeated readings, (T, n); None without spans."""
    start, stop = np.flatnonzero(np.diff(repeats, prepend=False, append=False)).reshape(-1, 2).T
    long = stop - start >= _MIN_SPAN
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
