"""Health of sensors: dead, stuck, saturating, noisy, intermittent or isolated.

Each sensor is compared with the other sensors of the recording, since typical values differ between
skins. To add a fault, add one function and one line to `_TESTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.graph.neighbour_graphs import NO_SENSOR, greatest_of_rows, most_similar
from anisomap.numerics.signals import Signals, some_sensors, unit_rows
from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.rest import Rest
from anisomap.recording import Recording, as_runs, in_range

MAX_ALL_PAIRS = 4096
"""Number of sensors above which no matrix of all pairs is computed: 128 MB of float64."""

_N_NEAREST = 4  # most similar sensors that are checked for the same contact; chosen by hand
_MIN_CLEAR_R = 0.6  # sensors with a higher r are never tested for isolation; chosen by hand
_ROWS_AT_ONCE = 64  # of a product; single rows would be as slow as some
_N_SHIFTS = 19  # an unrelated sensor exceeds all of them with probability 1/20
_MIN_AUTOCORRELATION = 0.05  # at lag 2, for the noise share to use it; chosen by hand


@dataclass(frozen=True, eq=False)
class Behaviour:
    """Statistics of n varying sensors; arrays of shape (n,).

    rest: Rest values.
    distinct: Number of distinct readings.
    active: Share of frames beyond rest.
    contacts: Number of contacts: runs of frames beyond rest.
    at_ceiling: Share of active frames at the most extreme reading on the side of contact.
    unexplained: Share of active frames in which none of the most similar sensors is active.
    lag_correlation: Autocorrelation at a lag of one frame.
    noise_share: Share of white noise in the variance.
    best_match: Highest Pearson r with another sensor.
    shifted_match: Highest Pearson r with another sensor after circular shifts in time; -1 if not
        computed.
    n_frames: Number of frames.
    """

    rest: Rest
    distinct: NDArray[np.intp]
    active: NDArray[np.float64]
    contacts: NDArray[np.intp]
    at_ceiling: NDArray[np.float64]
    unexplained: NDArray[np.float64]
    lag_correlation: NDArray[np.float64]
    noise_share: NDArray[np.float64]
    best_match: NDArray[np.float64]
    shifted_match: NDArray[np.float64]
    n_frames: int


@dataclass(frozen=True, eq=False)
class Matches:
    """The most similar sensors of each sensor.

    nearest: Indices of the most similar sensors; -1 where there are fewer.
    best (n,): Highest Pearson r with another sensor; NaN if there is none.
    """

    nearest: NDArray[np.int64]
    best: NDArray[np.float64]

    def among(self, chosen: NDArray[np.bool_]) -> Matches:
        """Return the matches of some sensors, given as a mask, with indices renumbered."""
        number = np.append(np.where(chosen, np.cumsum(chosen) - 1, NO_SENSOR), NO_SENSOR)
        return Matches(number[self.nearest[chosen]], self.best[chosen])


def observe(signals: Signals, matches: Matches | None = None) -> Behaviour:
    """Compute the statistics of n varying sensors.

    For more than 4096 sensors, no matrix of all pairs is computed, and circular shifts are compared
    with 4096 evenly chosen sensors.
    """
    readings, n_frames = signals.readings, len(signals.readings)
    at_one, at_two = signals.autocorrelation(1, 2)
    found = matches or _find_matches(readings)
    return Behaviour(
        rest=signals.rest,
        distinct=signals.distinct,
        active=signals.n_active / n_frames,
        contacts=signals.contacts,
        at_ceiling=signals.at_extreme / np.maximum(signals.n_active, 1),
        unexplained=_unexplained(np.ascontiguousarray(signals.active.T), found.nearest),
        lag_correlation=at_one,
        noise_share=_noise_share(at_one, at_two),
        best_match=found.best,
        shifted_match=(
            np.full(len(found.best), -1.0) if matches else _match_after_shifts(readings, found.best)
        ),
        n_frames=n_frames,
    )


def _find_matches(readings: NDArray[np.floating]) -> Matches:
    n_sensors = readings.shape[1]
    count = min(_N_NEAREST, n_sensors - 1)
    if count < 1:
        return Matches(np.full((n_sensors, 1), NO_SENSOR), np.full(n_sensors, np.nan))
    if n_sensors > MAX_ALL_PAIRS:
        found, r = most_similar(unit_rows(readings), count)
        return Matches(found, r[:, 0].astype(np.float64))
    correlation = pearson(readings)
    np.fill_diagonal(correlation, -np.inf)
    nearest = np.nonzero(greatest_of_rows(correlation, count))[1].reshape(n_sensors, count)
    return Matches(nearest, correlation.max(axis=1))


def _unexplained(series: NDArray[np.bool_], nearest: NDArray[np.int64]) -> NDArray[np.float64]:
    """Compute the share of active frames in which none of the most similar sensors is active."""
    alone = [
        np.count_nonzero(mine > series[others[others != NO_SENSOR]].any(axis=0))
        for mine, others in zip(series, nearest, strict=True)
    ]
    counted = np.where((nearest != NO_SENSOR).any(axis=1), alone, 0)
    return np.asarray(counted / np.maximum(np.count_nonzero(series, axis=1), 1))


def _noise_share(at_one: NDArray[np.float64], at_two: NDArray[np.float64]) -> NDArray[np.float64]:
    """Estimate the share of white noise in the variance from lags of one and two frames.

    A signal with autocorrelation a^l and a share c of the variance, plus white noise, has
    rho_l = c a^l, so c = rho_1^2 / rho_2. Short contacts reduce both lags and do not count as
    noise. If rho_2 is near 0, c = rho_1.
    """
    signal = np.divide(at_one**2, at_two, out=at_one.copy(), where=at_two > _MIN_AUTOCORRELATION)
    return np.asarray(1 - np.clip(signal, 0, 1))


def _match_after_shifts(
    readings: NDArray[np.floating], best_match: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the highest r of a sensor with any other after circular shifts of its frames.

    Circular shifts preserve the autocorrelation, which formulas for independent frames ignore.
    Sensors with a high r are not shifted, and get -1.
    """
    n_frames, n_sensors = readings.shape
    highest = np.full(n_sensors, -1.0)
    suspects = np.flatnonzero(best_match < _MIN_CLEAR_R)
    if not suspects.size or n_frames < 2 * _N_SHIFTS:
        return highest
    others = some_sensors(n_sensors, MAX_ALL_PAIRS)
    every = others.size == n_sensors
    standard = unit_rows(readings if every else readings[:, others])
    shifts = [step * n_frames // (_N_SHIFTS + 1) for step in range(1, _N_SHIFTS + 1)]
    for start in range(0, suspects.size, MAX_ALL_PAIRS):
        part = suspects[start : start + MAX_ALL_PAIRS]
        mine = standard[part] if every else unit_rows(readings[:, part])
        itself = part[:, None] == others
        n_at_once = max(1, _ROWS_AT_ONCE // part.size)
        for begin in range(0, _N_SHIFTS, n_at_once):
            shifted = [np.roll(mine, shift, axis=1) for shift in shifts[begin : begin + n_at_once]]
            correlation = np.concatenate(shifted) @ standard.T
            for one in correlation.reshape(-1, *itself.shape):
                one[itself] = -1
                highest[part] = np.maximum(highest[part], one.max(axis=1))
    return highest


STATUSES = ("ok", "dead", "stuck", "saturating", "noisy", "intermittent", "isolated")
"""All statuses; a sensor with several faults has the first of them."""

MIN_CONTACTS = 5
"""Contacts below which statistics of a sensor are unreliable; chosen by hand."""

_OF_CONSTANT_SENSORS = {
    "distinct": 1,
    "active": 0.0,
    "contacts": 0,
    "lag_correlation": float("nan"),
    "best_match": float("nan"),
}
_SILENT = ("dead", "stuck", "isolated")
# Limits; where no source is given they were chosen by hand: no false alarm on four real recordings.
_OUTLIER = 5 * 1.4826  # 5 sd of a normal distribution, in median absolute deviations
_MAX_CEILING_EXCESS = 0.3  # share of active frames at the ceiling, above the median sensor
_MIN_CEILING_FRAMES = 10  # frames at the ceiling
_MAX_UNEXPLAINED = 0.5  # share of active frames without a similar sensor
_MAX_NOISE = 0.15  # share of the variance; the worst healthy real sensor has 0.09
_STANDARD_ERRORS = 4.0  # of an autocorrelation


@dataclass(frozen=True)
class SensorHealth:
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
        Number of distinct values.
    active : float
        Share of frames beyond rest, in [0, 1].
    contacts : int
        Number of contacts: runs of frames beyond rest.
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


def assess(
    recording: Recording | Sequence[Recording], *, matches: Matches | None = None
) -> tuple[SensorHealth, ...]:
    """Assess every sensor of a recording.

    Parameters
    ----------
    recording : Recording or sequence of Recording
        Missing readings are interpolated first. If some of several recordings of one skin lack
        sensors, each sensor is assessed in the run with most contacts, preferring runs in which it
        is not silent or isolated.
    matches : Matches, optional
        The most similar sensors, if known from more than this recording. No sensor is then
        reported as isolated.

    Returns
    -------
    tuple of SensorHealth
        In the order of the sensors.

    Notes
    -----
    The paper leaves out sensors that never vary, and keeps one that saturates intermittently
    (section "Prototyping Issues"). A status other than "ok" is a reason to inspect the sensor, not
    proof of a fault.
    """
    runs = as_runs(recording)
    with limited_blas(runs[0].n_sensors):
        return _assess(runs[0], matches) if len(runs) == 1 else _assess_runs(runs)


def _assess_runs(runs: Sequence[Recording]) -> tuple[SensorHealth, ...]:
    best: dict[str, SensorHealth] = {}
    for run in runs:
        for sensor in _assess(run, None):
            known = best.get(sensor.name)
            if known is None or _informative(sensor) > _informative(known):
                best[sensor.name] = sensor
    return tuple(best.values())


def _informative(sensor: SensorHealth) -> tuple[bool, int]:
    return sensor.status not in _SILENT, sensor.contacts


def _assess(recording: Recording, matches: Matches | None) -> tuple[SensorHealth, ...]:
    recording, unit = in_range(recording.complete("interpolate"))
    varying = recording.varying()
    behaviour = None
    if varying.any():
        nearest = None if matches is None else matches.among(varying)
        whole = varying.all()
        signals = recording.signals if whole else Signals(recording.readings[:, varying])
        behaviour = observe(signals, nearest)
    faults = _faults_of_constant(recording, varying, behaviour, unit)
    if behaviour is not None:
        active = np.flatnonzero(varying)
        for status, test in reversed(_TESTS.items()):
            for i, reason in test(behaviour).items():
                faults[int(active[i])] = (status, reason)
    lowest, highest = recording.extremes
    columns = {
        name: np.full(recording.n_sensors, constant)
        for name, constant in _OF_CONSTANT_SENSORS.items()
    }
    for name, column in columns.items() if behaviour is not None else ():
        column[varying] = getattr(behaviour, name)
    return tuple(
        SensorHealth(
            name,
            *faults.get(i, ("ok", "")),
            minimum=unit * float(lowest[i]),
            maximum=unit * float(highest[i]),
            **{of: column[i].item() for of, column in columns.items()},
        )
        for i, name in enumerate(recording.names)
    )


def _faults_of_constant(
    recording: Recording, varying: NDArray[np.bool_], behaviour: Behaviour | None, unit: float
) -> dict[int, tuple[str, str]]:
    """Return the status and the reason of each constant sensor."""
    rests = behaviour.rest.value if behaviour is not None else np.zeros(1)
    low, high = rests.min(), rests.max()
    lowest, highest = recording.extremes
    slack = 0.05 * (float(highest.max()) - float(lowest.min()))
    faults = {}
    for i in np.flatnonzero(~varying):
        value = lowest[i]
        if low - slack <= value <= high + slack:
            faults[int(i)] = (
                "dead",
                f"constant at {unit * value:g}, a rest value: never touched, or dead",
            )
        else:
            faults[int(i)] = (
                "stuck",
                f"constant at {unit * value:g}, which is not a rest value of other sensors",
            )
    return faults


def _above(
    values: NDArray[np.float64], limit: float, tested: NDArray[np.bool_], what: str
) -> dict[int, str]:
    """Report the tested sensors with shares above a limit, and the share of the typical sensor."""
    reason = f"{what} (typical: {np.median(values):.0%})"
    return {int(i): reason.format(values[i]) for i in np.flatnonzero(tested & (values > limit))}


def _outlying(values: NDArray[np.float64], slack: float = 0.0) -> float:
    """Return the limit of outliers, at least `slack` above the typical value."""
    typical = float(np.median(values))
    return typical + max(_OUTLIER * float(np.median(np.abs(values - typical))), slack)


def _saturating(b: Behaviour) -> dict[int, str]:
    often = b.at_ceiling * b.active * b.n_frames >= _MIN_CEILING_FRAMES
    limit = float(np.median(b.at_ceiling)) + _MAX_CEILING_EXCESS
    return _above(b.at_ceiling, limit, often, "at its extreme value in {:.0%} of its active frames")


def _noisy(b: Behaviour) -> dict[int, str]:
    limit = max(_MAX_NOISE, _outlying(b.noise_share, _STANDARD_ERRORS / np.sqrt(b.n_frames)))
    tested = b.contacts >= MIN_CONTACTS
    return _above(b.noise_share, limit, tested, "{:.0%} of the variance is white noise")


def _intermittent(b: Behaviour) -> dict[int, str]:
    limit = max(_MAX_UNEXPLAINED, _outlying(b.unexplained))
    tested = b.contacts >= MIN_CONTACTS
    return _above(
        b.unexplained, limit, tested, "no similar sensor is active in {:.0%} of its active frames"
    )


def _isolated(b: Behaviour) -> dict[int, str]:
    return {
        int(
            i
        ): f"no significant correlation with any sensor: its highest r is {b.best_match[i]:.2f}, "
        f"and after circular shifts {b.shifted_match[i]:.2f}"
        for i in np.flatnonzero(b.best_match <= b.shifted_match)
    }


_TESTS: dict[str, Callable[[Behaviour], dict[int, str]]] = {
    "saturating": _saturating,
    "noisy": _noisy,
    "intermittent": _intermittent,
    "isolated": _isolated,
}
