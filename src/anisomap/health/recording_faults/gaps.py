"""Gaps: readings that are missing in blocks, or were replaced by straight lines."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from anisomap.health.recording_faults.found import Found, in_readings
from anisomap.numerics.columns import columns
from anisomap.numerics.gaps import fill_gaps
from anisomap.numerics.signals import standardised
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording

_MIN_MISSING = 0.02  # share of a sensor's readings; fewer change no correlation; chosen by hand
_FALSE_ALARMS = 0.01  # expected number of straight lines that are found by chance
_ROUNDING = 1e-6  # share of the largest reading: some steps of float32
_MIN_RUN = 8  # frames; two contacts of a frame each make shorter lines; chosen by hand
_MIN_RISE = 0.03  # of the range: a slow drift rises less between two contacts; chosen by hand
_MIN_MIXED = 0.15  # share of the lines against the direction of the other lines of their sensor
_N_PARTNERS = 8  # most similar sensors from which readings are estimated; chosen by hand
_MAX_FRAMES = 20_000  # of a fit


def find_gaps(recording: Recording) -> Iterator[Found]:
    """Find readings that are missing, or on straight lines; the recording may be incomplete."""
    readings = recording.readings
    missing = ~np.isfinite(readings)
    for i, bridged in find_bridged(readings).items():
        missing[bridged, i] = True
    share = missing.mean(axis=0)
    missing &= (share >= _MIN_MISSING) & (share < 1)
    affected = np.flatnonzero(missing.any(axis=0))
    if affected.size:
        typical = float(np.median(share[affected]))
        on_lines = np.isfinite(readings[missing]).any()
        yield Found(
            affected,
            typical,
            f"{typical:.0%} of the readings of {affected.size} of {recording.n_sensors} sensors "
            f"are {'on straight lines, as if interpolated' if on_lines else 'missing'}",
            in_readings(lambda readings: _filled(readings, missing)),
        )


def find_bridged(readings: NDArray[Any]) -> dict[int, NDArray[np.intp]]:
    """Find readings on straight lines that are too long to occur by chance, of each sensor.

    If a share p of a sensor's readings continues a line, a line of n readings occurs in T frames of
    N sensors with probability N T p^n at most. Lines of a sensor that rise little are parts of a
    slow drift.
    """
    n_frames, n_sensors = readings.shape
    if n_frames < 2 * _MIN_RUN:
        return {}
    lines = {
        i: found
        for i, column in enumerate(columns(readings))
        if _may_have_lines(column) and (found := _lines(column.astype(np.float64), n_sensors))
    }
    rising = [[rises for _, _, rises in found] for found in lines.values()]
    fewer = sum(min(sum(up), len(up) - sum(up)) for up in rising)
    if fewer < _MIN_MIXED * sum(map(len, rising)):
        return {}
    return {
        i: np.concatenate([np.arange(start, stop) + 1 for start, stop, _ in found])
        for i, found in lines.items()
    }


def _may_have_lines(column: NDArray[Any]) -> bool:
    """Return whether a sensor has `_MIN_RUN` readings on a line, with twice the slack of `_lines`.

    Differences of float32 readings are rounded by less than the slack.
    """
    slack = 2 * _ROUNDING * max(column.max(), -column.min())
    if not np.isfinite(slack):
        return True
    slope = column[1:] - column[:-1]
    on_line = np.abs(slope[1:] - slope[:-1]) <= 2 * slack
    on_line &= np.abs(slope[1:]) > slack
    length = 1
    while length < _MIN_RUN:
        step = min(length, _MIN_RUN - length)
        on_line = on_line[:-step] & on_line[step:]
        length += step
    return bool(on_line.any())


def _lines(column: NDArray[np.float64], n_sensors: int) -> list[tuple[int, int, bool]]:
    """Return the first and last reading of each long line of a sensor, and whether it rises."""
    slope = np.diff(column)
    slack = _ROUNDING * np.nanmax(np.abs(column), initial=0)
    with np.errstate(invalid="ignore"):
        on_line = (np.abs(np.diff(slope)) <= 2 * slack) & (np.abs(slope[1:]) > 4 * slack)
    share = float(np.mean(on_line))
    if not 0 < share < 1:
        return []
    enough = math.log(column.size * n_sensors / _FALSE_ALARMS) / -math.log(share)
    found = [run for run in _runs(on_line) if run[1] - run[0] >= max(_MIN_RUN, enough)]
    rises = np.array([column[stop] - column[start] for start, stop in found])
    if not found or np.median(np.abs(rises)) < _MIN_RISE * (np.nanmax(column) - np.nanmin(column)):
        return []
    return [(start, stop, rise > 0) for (start, stop), rise in zip(found, rises, strict=True)]


def _filled(readings: NDArray[Any], missing: NDArray[np.bool_]) -> NDArray[Any]:
    """Estimate missing readings of sensors from similar ones; where there are none, by lines."""
    completed = fill_gaps(np.where(missing, np.nan, readings))
    rest = estimate_rest(completed)
    depth, standard = rest.depth(completed), standardised(completed)
    for i in np.flatnonzero(missing.any(axis=0)).tolist():
        known = np.flatnonzero(~missing[:, i])
        known = known[:: max(1, known.size // _MAX_FRAMES)]
        similarity = standard[known].T @ standard[known, i]
        similarity[i] = -np.inf
        partners = np.argsort(-similarity, kind="stable")[:_N_PARTNERS]
        partners = partners[similarity[partners] > 0]
        if known.size < 2 * _N_PARTNERS or not partners.size or not depth[known, i].any():
            continue
        weights, _ = nnls(depth[np.ix_(known, partners)], depth[known, i])
        gap = np.flatnonzero(missing[:, i])
        estimate = np.minimum(depth[np.ix_(gap, partners)] @ weights, depth[known, i].max())
        noise = rest.threshold[i] * (estimate > 0)
        completed[gap, i] = rest.value[i] + rest.side[i] * (estimate + noise)
    return np.asarray(completed)


def _runs(marks: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Yield the first and one past the last index of each run of True."""
    edges = np.diff(np.concatenate([[False], marks, [False]]).astype(np.int8))
    yield from zip(
        np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True
    )
