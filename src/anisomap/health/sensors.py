"""Health of sensors: silent, stuck, intermittent, noisy, isolated, and more: see `STATUSES`.

Each sensor is compared with the other sensors of the recording, since typical values differ between
skins, at the rate of false alarms of `anisomap.numerics.reliability.sampling_noise`. To add a
fault, add one function and one line to `_TESTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.base.immutable import Value
from anisomap.numerics.columns import transposed
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.graph.neighbour_graphs import most_similar
from anisomap.numerics.reliability.sampling_noise import outlying
from anisomap.numerics.signals import (
    MAX_PAIRED,
    Signals,
    excerpt_frames,
    some_sensors,
    squares_and_lagged,
    unit_rows,
)
from anisomap.recording import Recording, join_runs
from anisomap.sensor_map import FEW_CONTACTS, SILENT

MIN_CONTACTS = 5
"""Minimum number of contacts for reliable statistics of a sensor; chosen by hand."""

STATUSES = (
    *("ok", SILENT, "stuck", "intermittent", "noisy", "saturating", "isolated"),
    FEW_CONTACTS,
)
"""All statuses; of several faults of a sensor, the first in this order is its status."""

_MAX_COMPARED = 4096  # sensors compared with all sensors after shifts
_N_SHIFTS = 19  # circular shifts, whose highest r related sensors exceed
_FRAMES_AT_ONCE = 256  # whose differences stay in the cache
_ROWS_AT_ONCE = 4  # rows shifted at a time; the product of their shifts stays in the cache
_HARMFUL_MATCH = 0.75  # relative to the typical highest r; below, the position is less certain
_MIN_AT_EXTREME = 10  # frames of a saturating sensor
_LEAST_R = 1e-3
# Maximum number of levels of a sensor that noise may move a step from rest. A skin is on or off if
# a smaller share of the sensors has more than two levels; by hand.
_FEW_LEVELS, _SEVERAL = 8, 0.05
_HARMFUL_NOISE = 0.15  # share of the variance: r is 8 % lower
_NEGLIGIBLE = 0.01  # noise, in standard deviations of the typical sensor
_OF_WHITE_NOISE = 0.6745 * 6**0.5  # median of the second differences of white noise
_OF_MEDIAN = 2.0  # relative variance of the median of n overlapping differences, times n; simulated
_FLOAT32_RANGE = 1e15  # of readings whose differences are squared in float32
_MIN_AT_REST = 20  # differences for an estimate of noise; chosen by hand
_N_PARTNERS = 8  # most similar sensors, by number the neighbours on a square lattice
# Maximum share of readings of the typical sensor that repeat the preceding one; more hide noise.
_MAX_STILL = 1 / 3
_N_NEAR, _MIN_SPELLS = 4, 5  # similar sensors that indicate contact; number of spells; by hand
_MIN_HELD, _MIN_STAY = 0.05, 0.8  # share of frames; probability that a spell lasts a frame more
# Minimum ratios for spells unrelated to contact: the share of frames without contact in spells to
# that in other frames, and the jump at the ends to the distance of other readings at rest. By hand.
_MIN_INDEPENDENT, _MIN_JUMP = 0.5, 0.7


@dataclass(frozen=True, eq=False)
class Behaviour:
    """Statistics of n varying sensors; arrays of shape (n,), computed at first use.

    best_match: Highest Pearson r with another sensor; NaN for a single sensor.
    """

    signals: Signals
    best_match: NDArray[np.float64]

    @cached_property
    def _excerpt(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.bool_]]:
        """Standard deviations, (n,), second differences, and mask of frames at rest, (t, n)."""
        signals = self.signals
        frames = excerpt_frames(signals.readings)
        readings = signals.readings[frames]
        squares, _ = squares_and_lagged(readings, readings[0])  # exact for constant ones
        if squares.max() > _FLOAT32_RANGE:
            readings = readings.astype(np.float64)
        changes = np.empty((max(0, len(readings) - 2), len(squares)), readings.dtype)
        for begin in range(0, len(changes), _FRAMES_AT_ONCE):
            part = changes[begin : begin + _FRAMES_AT_ONCE]
            np.abs(np.diff(readings[begin : begin + len(part) + 2], 2, axis=0), out=part)
        active = signals.touched[frames] & signals.rest.known
        quiet = ~(active[2:] | active[1:-1] | active[:-2])
        return np.sqrt(squares / len(readings)), changes, quiet

    def noise(self, sensors: NDArray[Any] | slice = slice(None)) -> NDArray[np.float64]:
        """Return deviations of white noise, relative variances, deviations of readings, (3, n).

        White noise is estimated from second differences of frames without contact, since contacts
        of one frame change readings, too. With few such frames, the relative variance is inf.
        """
        deviation, changes, quiet = (one[..., sensors] for one in self._excerpt)
        rows = transposed(np.where(quiet, changes, changes.dtype.type(np.inf)))
        rows.sort(axis=1)
        counts = np.count_nonzero(quiet, axis=0)
        enough = np.flatnonzero(counts >= _MIN_AT_REST)
        white, variance = np.zeros(len(rows)), np.full(len(rows), np.inf)
        white[enough] = rows[enough, counts[enough] // 2] / _OF_WHITE_NOISE
        variance[enough] = _OF_MEDIAN / counts[enough]
        return np.stack([white, variance, deviation])

    def shared(self, sensor: int) -> float:
        """Return the share of a sensor's variance that the most similar sensors explain."""
        rows = self.signals.excerpt_rows
        similar = np.abs(rows @ rows[sensor])
        similar[sensor] = -1
        partners = rows[np.argsort(-similar)[: min(_N_PARTNERS, len(rows) - 1)]]
        weights, *_ = np.linalg.lstsq(partners.T, rows[sensor], rcond=None)
        left = float(np.linalg.norm(rows[sensor] - weights @ partners) ** 2)
        free = rows.shape[1] - 1
        return float(1 - left * free / max(1, free - len(partners)))

    @cached_property
    def _dithers(self) -> NDArray[np.bool_]:
        """Sensors of few levels that are mostly one step from rest when they are not at rest.

        If rest lies between two levels, noise alone moves a sensor by one step.
        """
        readings, rest = self.signals.readings, self.signals.rest
        found = rest.distinct <= _FEW_LEVELS
        if np.mean(rest.distinct > 2) < _SEVERAL:  # on or off
            return np.zeros_like(found)
        for i in np.flatnonzero(found).tolist():
            levels, counts = np.unique(readings[:, i], return_counts=True)
            step = np.abs(np.arange(levels.size) - counts.argmax())
            found[i] = counts[step == 1].sum() > counts[step > 1].sum()
        return np.asarray(found)

    @cached_property
    def unlike(self) -> NDArray[np.bool_]:
        """Sensors with contacts that resemble others clearly less than typical sensors do."""
        found = (self.signals.contacts >= MIN_CONTACTS) & ~self._dithers
        if found.any():
            best = np.nan_to_num(self.best_match[found])
            typical = np.full(best.size, np.median(best))
            low = np.flatnonzero(best < _HARMFUL_MATCH * typical)
            if not low.size:
                return np.zeros_like(found)
            # Distant sensors all resemble each other less.
            rows = self.signals.excerpt_rows[found]
            similar = np.abs(rows[low] @ rows.T)
            similar[np.arange(low.size), low] = -1
            partners = np.argsort(-similar, axis=1)[:, :_N_PARTNERS]
            weights = np.maximum(np.take_along_axis(similar, partners, axis=1), _LEAST_R)
            around = np.average(best[partners], axis=1, weights=weights)
            typical[low] = np.minimum(typical[low], around)
            # If contacts are weak, the noise of a sensor lowers r.
            share = noise_share(self.noise(np.flatnonzero(found)[low]))
            r = best.copy()
            r[low] /= np.sqrt(np.maximum(1 - share, 0.1))
            # A single different contact lowers r, so n contacts resolve no r closer to 1.
            most = 1 - 0.5 / self.signals.contacts[found]
            r, typical = (np.clip(one, _LEAST_R, most) for one in (r, typical))
            # Ratio of unexplained to explained variance; Fisher's z has the variance 1 / n.
            levels = (r**-2 - 1) / (typical**-2 - 1)
            unlikely = outlying(levels, 4 / typical**2 / self.signals.contacts[found])
            found[found] = unlikely & (r < _HARMFUL_MATCH * typical)
        return np.asarray(found)


def noise_share(noise: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share of white noise in the variance, from `Behaviour.noise`, (n,)."""
    return np.asarray(np.minimum((noise[0] / np.maximum(noise[2], 1e-300)) ** 2, 1))


def exceeded_by_chance(
    readings: NDArray[np.floating], sensors: NDArray[np.intp], best: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return whether the highest r of some sensors is exceeded after circular shifts in time.

    Shifts preserve the autocorrelation, which formulas for independent frames ignore.
    """
    n_frames, n_sensors = readings.shape
    found = np.zeros(sensors.size, dtype=bool)
    if not sensors.size or n_frames < 2 * _N_SHIFTS:
        return found
    others = some_sensors(n_sensors, _MAX_COMPARED)
    standard = unit_rows(readings[:, others])
    for start in range(0, sensors.size, _ROWS_AT_ONCE):
        part = sensors[start : start + _ROWS_AT_ONCE]
        mine = unit_rows(readings[:, part])
        shifts = [step * n_frames // (_N_SHIFTS + 1) for step in range(1, _N_SHIFTS + 1)]
        correlation = np.concatenate([np.roll(mine, n, axis=1) for n in shifts]) @ standard.T
        correlation = correlation.reshape(_N_SHIFTS, part.size, -1)
        correlation[:, part[:, None] == others] = -1
        exceeded = correlation.max(axis=2) >= best[part]
        found[start : start + part.size] = exceeded.any(axis=0)
    return found


@dataclass(frozen=True, eq=False)
class SensorHealth(Value):
    """Health and statistics of a sensor.

    Attributes
    ----------
    name : str
    status : str
        One of `STATUSES`.
    reason : str
        Reason for the status; empty if it is ``"ok"``.
    minimum, maximum : float
        Range of the readings; NaN if none is finite.
    distinct : int
        Number of distinct values; of continuous readings in over 8,192 frames, counted in 4,096.
    active : float
        Share of frames beyond rest, in [0, 1].
    contacts : int
        Number of contacts: runs of frames clearly beyond rest.
    lag_correlation : float
        Autocorrelation at a lag of one frame, in [-1, 1]; NaN for a constant sensor.
    best_match : float
        Highest Pearson r with another sensor; NaN if no other sensor varies.
    """

    name: str
    status: str
    reason: str
    minimum: float
    maximum: float
    distinct: int
    active: float
    contacts: int
    lag_correlation: float
    best_match: float


def assess(recording: Recording | Sequence[Recording]) -> tuple[SensorHealth, ...]:
    """Assess every sensor of a recording.

    Parameters
    ----------
    recording : Recording or sequence of Recording
        Missing readings are interpolated first. If some of several recordings of one skin lack
        sensors, each sensor is assessed in the run with most contacts.

    Returns
    -------
    tuple of SensorHealth
        In the order of the sensors.

    Raises
    ------
    InputError
        If the recordings do not match: see `anisomap.join_runs`.

    Notes
    -----
    Sensors that are constant at rest are ``"silent"``: dead and untouched sensors have the same
    readings. ``"few contacts"`` means fewer than 5, too few for other tests. The other statuses are
    faults, such as far more white noise than that of other sensors, or no similarity to any of
    them. Each test flags 0.05 healthy sensors of a recording on average, and at most one in 1,000:
    see `anisomap.numerics.reliability.sampling_noise`. The paper omits sensors that never vary, and
    keeps one that saturates intermittently (section "Prototyping Issues").
    """
    parts = join_runs(recording).parts
    with limited_blas(parts[0].n_sensors):
        if len(parts) == 1:
            return _assess(parts[0])
        best: dict[str, SensorHealth] = {}
        for sensor in (one for part in parts for one in _assess(part)):
            known = best.get(sensor.name)
            if known is None or sensor.contacts > known.contacts:
                best[sensor.name] = sensor
        return tuple(best.values())


def _assess(recording: Recording) -> tuple[SensorHealth, ...]:
    recording = recording.complete("interpolate")
    varying = recording.varying()
    statuses = _of_constant(recording, varying)
    n_sensors = recording.n_sensors
    measured: dict[str, NDArray[Any]] = {
        "distinct": np.ones(n_sensors, dtype=np.intp),
        "active": np.zeros(n_sensors),
        "contacts": np.zeros(n_sensors, dtype=np.intp),
        "lag_correlation": np.full(n_sensors, np.nan),
        "best_match": np.full(n_sensors, np.nan),
    }
    if varying.any():
        signals = recording.signals if varying.all() else Signals(recording.readings[:, varying])
        behaviour = Behaviour(signals, _best_match(signals))
        sensors = np.flatnonzero(varying)
        for status, test in reversed(_TESTS.items()):
            for i, reason in test(behaviour).items():
                statuses[int(sensors[i])] = status, reason
        measured["distinct"][varying] = signals.rest.distinct
        measured["active"][varying] = signals.n_active / recording.n_frames
        measured["contacts"][varying] = signals.contacts
        measured["lag_correlation"][varying] = signals.lag_correlation
        measured["best_match"][varying] = behaviour.best_match
    ends = (end.astype(np.float64) for end in recording.extremes)
    rows = zip(*(column.tolist() for column in (*ends, *measured.values())), strict=True)
    return tuple(
        SensorHealth(name, *statuses.get(i, ("ok", "")), *row)
        for i, (name, row) in enumerate(zip(recording.names, rows, strict=True))
    )


def _best_match(signals: Signals) -> NDArray[np.float64]:
    """Return the highest Pearson r of each sensor with another, (N,); NaN for a single sensor."""
    n_sensors = signals.readings.shape[1]
    if n_sensors > MAX_PAIRED:
        return most_similar(unit_rows(signals.readings), 1)[1][:, 0].astype(np.float64)
    others = np.where(np.eye(n_sensors, dtype=bool), -np.inf, signals.pearson[0])
    best = others.max(axis=1)
    return np.where(np.isneginf(best), np.nan, best)


def _of_constant(recording: Recording, varying: NDArray[np.bool_]) -> dict[int, tuple[str, str]]:
    """Return the status and the reason of each constant sensor."""
    rest = recording.signals.rest
    rests = rest.value[varying & rest.known]
    typical = float(np.median(np.where(varying, rest.value, recording.extremes[0])))
    lowest, highest = recording.extremes
    slack = 0.05 * (float(highest.max()) - float(lowest.min()))
    found = {}
    for i in np.flatnonzero(~varying).tolist():
        value = float(lowest[i])
        resting = abs(value - typical) <= slack or (
            rests.size and rests.min() - slack <= value <= rests.max() + slack
        )
        status, what = (
            (SILENT, "like other sensors at rest: never touched, or dead")
            if resting
            else ("stuck", "unlike other sensors at rest")
        )
        found[i] = status, f"constant at {value:g}, {what}"
    return found


def _few_contacts(b: Behaviour) -> dict[int, str]:
    return {
        i: f"number of contacts: {b.signals.contacts[i]}; a position needs at least {MIN_CONTACTS}"
        for i in np.flatnonzero(b.signals.contacts < MIN_CONTACTS).tolist()
    }


def _noisy(b: Behaviour) -> dict[int, str]:
    measured = b.noise()
    (noise, variance, deviation), share = measured, noise_share(measured)
    floor = _NEGLIGIBLE * max(float(np.median(deviation)), 1e-300)
    seen = np.where(b.signals.differ_by_less(noise), noise, 0)
    told = np.flatnonzero(variance < np.inf)
    found = np.zeros(len(noise), dtype=bool)
    found[told] = outlying(np.maximum(seen, floor)[told], variance[told])
    found &= share >= _HARMFUL_NOISE
    reason = f"{{:.0%}} of the variance is white noise (typical: {np.median(share):.0%})"
    # Contacts of one frame are no noise: other sensors explain more than half of their variance.
    return {
        i: reason.format(share[i])
        for i in np.flatnonzero(found).tolist()
        if b.shared(i) <= 1 - share[i] / 2
    }


def _intermittent(b: Behaviour) -> dict[int, str]:
    """Find sensors that hold one value in spells, while noise changes them between spells.

    Readings at the end of a range are held as well, but only while there is no contact, and they
    approach this end gradually.
    """
    readings = b.signals.readings
    repeats = readings[1:] == readings[:-1]
    still = np.count_nonzero(repeats, axis=0)
    if np.median(still) > _MAX_STILL * len(readings):
        return {}
    rows, reasons = b.signals.excerpt_rows, {}
    for i in np.flatnonzero(still >= _MIN_STAY * _MIN_HELD * len(readings)).tolist():
        values, counts = np.unique(readings[1:, i][repeats[:, i]], return_counts=True)
        value = values[counts.argmax()]
        similar = np.abs(rows @ rows[i])
        similar[i] = -1
        near = np.argsort(-similar, kind="stable")[:_N_NEAR]
        free = np.asarray(~b.signals.touched[:, near].any(axis=1))
        held, both = readings[:, i] == value, free[1:] & free[:-1]
        ends, begins = (both & (one[:-1] > one[1:]) for one in (held, ~held))
        if ends.sum() < _MIN_SPELLS or not (free & ~held).any():
            continue
        stays = min(
            1 - one.sum() / (both & state[:-1]).sum()
            for one, state in ((ends, held), (begins, ~held))
        )
        off = np.abs(readings[:, i].astype(np.float64) - value)
        beside = np.concatenate([off[1:][ends], off[:-1][begins]])
        if (
            stays >= _MIN_STAY
            and free[~held].mean() >= _MIN_INDEPENDENT * free[held].mean()
            and np.median(beside) >= _MIN_JUMP * np.median(off[free & ~held])
        ):
            reasons[i] = (
                f"stays at one value in {held.mean():.0%} of the frames, for periods unrelated to "
                "contact"
            )
    return reasons


def _saturating(b: Behaviour) -> dict[int, str]:
    if not b.unlike.any():
        return {}
    at_extreme = b.signals.at_extreme
    share = at_extreme / np.maximum(b.signals.n_active, 1)
    often = (
        (at_extreme >= _MIN_AT_EXTREME)
        & (share > 2 * np.median(share))
        & (b.signals.rest.distinct > 2)
    )
    return {
        i: f"at its highest or lowest reading in {share[i]:.0%} of its active frames, unlike "
        f"similar sensors (typical: {np.median(share):.0%})"
        for i in np.flatnonzero(b.unlike & often).tolist()
    }


def _isolated(b: Behaviour) -> dict[int, str]:
    typical = float(np.median(np.nan_to_num(b.best_match)))
    return {
        i: f"less similar to other sensors than most sensors are: highest r {b.best_match[i]:.2f} "
        f"(typical: {typical:.2f})"
        for i in np.flatnonzero(b.unlike).tolist()
    }


_TESTS: dict[str, Callable[[Behaviour], dict[int, str]]] = {
    "intermittent": _intermittent,
    "noisy": _noisy,
    "saturating": _saturating,
    "isolated": _isolated,
    FEW_CONTACTS: _few_contacts,
}
