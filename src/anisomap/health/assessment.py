"""Health of sensors: dead, stuck, saturating, noisy, intermittent or isolated.

Each sensor is compared with the other sensors of the recording, since typical values differ between
skins. To add a fault, add one function and one line to `_TESTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.health.behaviour import Behaviour, Matches, observe
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.recording import Recording
from anisomap.runs import as_runs

STATUSES = ("ok", "dead", "stuck", "saturating", "noisy", "intermittent", "isolated")
"""All statuses; a sensor with several faults has the first of them."""

MIN_CONTACTS = 5
"""Contacts below which statistics of a sensor are unreliable; chosen by hand."""

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
    recording = recording.complete("interpolate")
    readings = recording.readings
    varying = recording.varying()
    behaviour = None
    if varying.any():
        nearest = None if matches is None else matches.among(varying)
        behaviour = observe(readings if varying.all() else readings[:, varying], nearest)
    faults = _faults_of_constant(recording, varying, behaviour)
    if behaviour is not None:
        active = np.flatnonzero(varying)
        for status, test in reversed(_TESTS.items()):
            for i, reason in test(behaviour).items():
                faults[int(active[i])] = (status, reason)
    position = np.cumsum(varying) - 1
    lowest, highest = recording.extremes
    result = []
    for i, name in enumerate(recording.names):
        status, reason = faults.get(i, ("ok", ""))
        known = behaviour if varying[i] else None
        at = position[i]
        result.append(
            SensorHealth(
                name=name,
                status=status,
                reason=reason,
                minimum=float(lowest[i]),
                maximum=float(highest[i]),
                distinct=int(known.distinct[at]) if known else 1,
                active=float(known.active[at]) if known else 0.0,
                contacts=int(known.contacts[at]) if known else 0,
                lag_correlation=float(known.lag_correlation[at]) if known else float("nan"),
                best_match=float(known.best_match[at]) if known else float("nan"),
            )
        )
    return tuple(result)


def _faults_of_constant(
    recording: Recording, varying: NDArray[np.bool_], behaviour: Behaviour | None
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
                f"constant at {value:g}, a rest value: never touched, or dead",
            )
        else:
            faults[int(i)] = (
                "stuck",
                f"constant at {value:g}, which is not a rest value of other sensors",
            )
    return faults


def _testable(b: Behaviour) -> NDArray[np.bool_]:
    """Select sensors with enough contacts to be tested."""
    return np.asarray(b.contacts >= MIN_CONTACTS)


def _saturating(b: Behaviour) -> dict[int, str]:
    typical = float(np.median(b.at_ceiling))
    often = b.at_ceiling * b.active * b.n_frames >= _MIN_CEILING_FRAMES
    suspects = often & (b.at_ceiling > typical + _MAX_CEILING_EXCESS)
    return {
        int(i): f"at its extreme value in {b.at_ceiling[i]:.0%} of its active frames "
        f"(typical: {typical:.0%})"
        for i in np.flatnonzero(suspects)
    }


def _noisy(b: Behaviour) -> dict[int, str]:
    typical = float(np.median(b.noise_share))
    slack = max(_OUTLIER * _spread(b.noise_share), _STANDARD_ERRORS / np.sqrt(b.n_frames))
    suspects = _testable(b) & (b.noise_share > max(_MAX_NOISE, typical + slack))
    return {
        int(i): f"{b.noise_share[i]:.0%} of the variance is white noise (typical: {typical:.0%})"
        for i in np.flatnonzero(suspects)
    }


def _intermittent(b: Behaviour) -> dict[int, str]:
    typical = float(np.median(b.unexplained))
    limit = max(_MAX_UNEXPLAINED, typical + _OUTLIER * _spread(b.unexplained))
    suspects = _testable(b) & (b.unexplained > limit)
    return {
        int(i): f"no similar sensor is active in {b.unexplained[i]:.0%} of its active frames "
        f"(typical: {typical:.0%})"
        for i in np.flatnonzero(suspects)
    }


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


def _spread(values: NDArray[np.float64]) -> float:
    return float(np.median(np.abs(values - np.median(values))))
