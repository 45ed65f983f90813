"""Verdicts on sensors: dead, stuck, saturating, noisy, intermittent, isolated.

Every verdict compares a sensor with the other sensors of the same recording, since what is normal
differs between skins. To add a fault, add one function and one line to `_TESTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.health.behaviour import Behaviour, Matches, observe
from anisomap.numerics.columns import columns, count_values
from anisomap.recording import Recording
from anisomap.runs import as_runs

STATUSES = ("ok", "dead", "stuck", "saturating", "noisy", "intermittent", "isolated")
"""Every status that a sensor can have; one that has several faults has the first."""

FEWEST_CONTACTS = 5
"""A sensor that was touched less often has statistics made of anecdotes."""

_SILENT = ("dead", "stuck", "isolated")
_OUTLIER = 5 * 1.4826  # five standard deviations of a normal population, from its median deviation
_CEILING_EXCESS = 0.3
_CEILING_FRAMES = 10
_UNEXPLAINED = 0.5
_NOISE = 0.15  # of the variance; of healthy real sensors, the worst show 0.09
_CHANCE = 4.0  # standard errors of an autocorrelation


@dataclass(frozen=True)
class SensorHealth:
    """What one sensor did during a recording, and whether it looks well.

    Attributes
    ----------
    name : str
        The sensor.
    status : str
        One of `STATUSES`.
    reason : str
        Why it is not ``"ok"``, in a sentence; empty if it is.
    minimum, maximum : float
        Range of its readings; NaN if none is finite.
    distinct : int
        How many different values it read.
    active : float
        Share of frames in which it was beyond rest, in [0, 1].
    contacts : int
        How many separate times it went beyond rest.
    lag_correlation : float
        Correlation of its readings with those one frame later, in [-1, 1]; NaN if it never varies.
    best_match : float
        Highest Pearson r with another sensor; NaN if there is none that varies.
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
    (section "Prototyping Issues"). A status other than "ok" calls for inspection; it is no proof.
    """
    runs = as_runs(recording)
    if len(runs) == 1:
        return _assess(runs[0], matches)
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
    distinct = [count_values(column)[0].size for column in columns(readings)]
    behaviour = None
    if varying.any():
        known = None if matches is None else matches.among(varying)
        behaviour = observe(readings if varying.all() else readings[:, varying], known)
    verdicts = _constant_verdicts(readings, varying, behaviour)
    if behaviour is not None:
        living = np.flatnonzero(varying)
        for status, test in reversed(_TESTS.items()):
            for i, reason in test(behaviour).items():
                verdicts[int(living[i])] = (status, reason)
    position = np.cumsum(varying) - 1
    result = []
    for i, name in enumerate(recording.names):
        status, reason = verdicts.get(i, ("ok", ""))
        moving = behaviour if varying[i] else None
        at = position[i]
        result.append(
            SensorHealth(
                name=name,
                status=status,
                reason=reason,
                minimum=float(readings[:, i].min()),
                maximum=float(readings[:, i].max()),
                distinct=distinct[i],
                active=float(moving.active[at]) if moving else 0.0,
                contacts=int(moving.contacts[at]) if moving else 0,
                lag_correlation=float(moving.lag_correlation[at]) if moving else float("nan"),
                best_match=float(moving.best_match[at]) if moving else float("nan"),
            )
        )
    return tuple(result)


def _constant_verdicts(
    readings: NDArray[np.floating], varying: NDArray[np.bool_], behaviour: Behaviour | None
) -> dict[int, tuple[str, str]]:
    rests = behaviour.rest.value if behaviour is not None else np.zeros(1)
    low, high = rests.min(), rests.max()
    slack = 0.05 * (float(readings.max()) - float(readings.min()))
    verdicts = {}
    for i in np.flatnonzero(~varying):
        value = readings[0, i]
        if low - slack <= value <= high + slack:
            verdicts[int(i)] = ("dead", f"always reads {value:g}, as if never touched")
        else:
            verdicts[int(i)] = ("stuck", f"always reads {value:g}, where others never rest")
    return verdicts


def _judged(b: Behaviour) -> NDArray[np.bool_]:
    """Tell which sensors were active often enough to be judged by how they were."""
    return np.asarray(b.contacts >= FEWEST_CONTACTS)


def _saturating(b: Behaviour) -> dict[int, str]:
    typical = float(np.median(b.at_ceiling))
    often = b.at_ceiling * b.active * b.n_frames >= _CEILING_FRAMES
    suspects = often & (b.at_ceiling > typical + _CEILING_EXCESS)
    return {
        int(i): f"at its extreme value in {b.at_ceiling[i]:.0%} of its active frames "
        f"(typical: {typical:.0%})"
        for i in np.flatnonzero(suspects)
    }


def _noisy(b: Behaviour) -> dict[int, str]:
    typical = float(np.median(b.noise_share))
    slack = max(_OUTLIER * _spread(b.noise_share), _CHANCE / np.sqrt(b.n_frames))
    suspects = _judged(b) & (b.noise_share > max(_NOISE, typical + slack))
    return {
        int(i): f"{b.noise_share[i]:.0%} of its variance is noise from frame to frame "
        f"(typical: {typical:.0%})"
        for i in np.flatnonzero(suspects)
    }


def _intermittent(b: Behaviour) -> dict[int, str]:
    typical = float(np.median(b.unexplained))
    limit = max(_UNEXPLAINED, typical + _OUTLIER * _spread(b.unexplained))
    suspects = _judged(b) & (b.unexplained > limit)
    return {
        int(
            i
        ): f"active while its nearest kin are not in {b.unexplained[i]:.0%} of its active frames "
        f"(typical: {typical:.0%})"
        for i in np.flatnonzero(suspects)
    }


def _isolated(b: Behaviour) -> dict[int, str]:
    return {
        int(
            i
        ): f"related to no other sensor beyond chance: its highest r is {b.best_match[i]:.2f}, "
        f"and chance alone gives up to {b.chance_match[i]:.2f}"
        for i in np.flatnonzero(b.best_match <= b.chance_match)
    }


_TESTS: dict[str, Callable[[Behaviour], dict[int, str]]] = {
    "saturating": _saturating,
    "noisy": _noisy,
    "intermittent": _intermittent,
    "isolated": _isolated,
}


def _spread(values: NDArray[np.float64]) -> float:
    return float(np.median(np.abs(values - np.median(values))))
