"""What is in a recording, and which of its sensors can be trusted.

Every verdict compares a sensor with the other sensors of the same recording, since what is normal
differs between skins. To add a fault, add one function and one line to `_TESTS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.activity import Rest, estimate_rest
from anisomap.numerics.similarity import pearson
from anisomap.recording import Recording

STATUSES = ("ok", "dead", "stuck", "saturating", "noisy", "intermittent", "isolated")
"""Every status that a sensor can have; one that has several faults has the first."""

FEWEST_FRAMES = 500
"""The paper's shortest run has 1,054 frames; below half of that its correlations are unsteady."""

FEWEST_CONTACTS = 5
"""A sensor that was touched less often has statistics made of anecdotes."""

_OUTLIER = 5 * 1.4826  # five standard deviations of a normal population, from its median deviation
_MATCHES = 4  # neighbours that are asked whether they felt a contact, too
_CEILING_EXCESS = 0.3
_CEILING_FRAMES = 10
_UNEXPLAINED = 0.5
_NOISE_RATIO = 0.5
_CHANCE = 4.0  # standard errors of an autocorrelation
_CLEAR_RELATION = 0.6  # no sensor with such a match is suspected of having none
_SHIFTS = 19  # an unrelated sensor beats all of them in one case of twenty


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


@dataclass(frozen=True)
class RecordingSummary:
    """What is in a recording, in a few numbers.

    Attributes
    ----------
    n_frames, n_sensors : int
        Its size.
    rate_hz, duration : float or None
        Frames a second, and seconds; None if not known.
    minimum, maximum : float
        Range of all finite readings.
    share_of_zeros : float
        Share of readings that are exactly 0, in [0, 1].
    distinct_values : int
        Median number of different values a sensor.
    missing : int
        How many readings are NaN or infinite.
    n_constant : int
        How many sensors never vary.
    warnings : tuple of str
        Why a map of it may be weak.
    """

    n_frames: int
    n_sensors: int
    rate_hz: float | None
    duration: float | None
    minimum: float
    maximum: float
    share_of_zeros: float
    distinct_values: int
    missing: int
    n_constant: int
    warnings: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Behaviour:
    """What the tests look at: an entry a varying sensor, shape (n,) each."""

    rest: Rest
    active: NDArray[np.float64]
    contacts: NDArray[np.intp]
    at_ceiling: NDArray[np.float64]
    unexplained: NDArray[np.float64]
    lag_correlation: NDArray[np.float64]
    best_match: NDArray[np.float64]
    chance_match: NDArray[np.float64]
    n_frames: int


def assess(recording: Recording) -> tuple[SensorHealth, ...]:
    """Judge every sensor of a recording.

    Parameters
    ----------
    recording : Recording
        Missing readings are interpolated for the judgement.

    Returns
    -------
    tuple of SensorHealth
        In the order of the sensors.

    Notes
    -----
    The paper leaves out sensors that never vary, and keeps one that saturates intermittently
    (section "Prototyping Issues"). A status is a reason to look, not a proof.
    """
    recording = recording.complete("interpolate")
    readings = np.asarray(recording.readings, dtype=np.float64)
    varying = recording.varying()
    distinct = [np.unique(column).size for column in readings.T]
    behaviour = _behaviour(readings[:, varying]) if varying.any() else None
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


def summarise(
    recording: Recording, health: Sequence[SensorHealth] | None = None
) -> RecordingSummary:
    """Describe a recording in a few numbers.

    Parameters
    ----------
    recording : Recording
    health : sequence of SensorHealth, optional
        Its assessment, if it is at hand already.

    Returns
    -------
    RecordingSummary
    """
    readings = recording.readings
    finite = np.isfinite(readings)
    judged = assess(recording) if health is None else health
    return RecordingSummary(
        n_frames=recording.n_frames,
        n_sensors=recording.n_sensors,
        rate_hz=recording.rate_hz,
        duration=recording.duration,
        minimum=float(readings.min(where=finite, initial=np.inf)),
        maximum=float(readings.max(where=finite, initial=-np.inf)),
        share_of_zeros=float(np.mean(readings == 0)),
        distinct_values=int(np.median([sensor.distinct for sensor in judged])),
        missing=int(np.count_nonzero(~finite)),
        n_constant=int(np.count_nonzero(~recording.varying())),
        warnings=weaknesses(recording, judged),
    )


def weaknesses(recording: Recording, health: Sequence[SensorHealth]) -> tuple[str, ...]:
    """Say why a map of a recording may be weak, a sentence a reason.

    Parameters
    ----------
    recording : Recording
    health : sequence of SensorHealth
        Its assessment.

    Returns
    -------
    tuple of str
        Empty if nothing speaks against it.
    """
    found = []
    if recording.n_frames < FEWEST_FRAMES:
        found.append(
            f"only {recording.n_frames} frames: statistics of so few are unsteady; "
            f"record {FEWEST_FRAMES} or more"
        )
    groups = {
        "never vary and carry no information": ("dead", "stuck"),
        "look faulty": ("saturating", "intermittent", "noisy"),
        "are related to no other sensor beyond chance, so their place is a guess": ("isolated",),
    }
    for what, statuses in groups.items():
        names = [sensor.name for sensor in health if sensor.status in statuses]
        if names:
            verdict = "do not trust a map of this: " if 2 * len(names) > len(health) else ""
            listed = shortened(names)
            found.append(f"{verdict}{len(names)} of {len(health)} sensors {what}: {listed}")
    rare = [s.name for s in health if 0 < s.contacts < FEWEST_CONTACTS and s.status == "ok"]
    if rare:
        found.append(
            f"{len(rare)} of {len(health)} sensors were touched fewer than {FEWEST_CONTACTS} "
            f"times: {shortened(rare)}"
        )
    return tuple(found)


def _behaviour(readings: NDArray[np.float64]) -> _Behaviour:
    rest = estimate_rest(readings)
    active = rest.active(readings)
    correlation = pearson(readings)
    np.fill_diagonal(correlation, -np.inf)
    has_match = correlation.shape[0] > 1
    best_match = correlation.max(axis=1) if has_match else np.full(1, np.nan)
    # The far end of the range on the side of contact: where a sensor that saturates is held.
    ceiling = (rest.side * readings).max(axis=0)
    return _Behaviour(
        rest=rest,
        active=active.mean(axis=0),
        contacts=active[0] + np.count_nonzero(active[1:] & ~active[:-1], axis=0),
        at_ceiling=_share(active & (rest.side * readings == ceiling), active),
        unexplained=_unexplained(active, correlation),
        lag_correlation=_lag_correlation(readings),
        best_match=best_match,
        chance_match=_chance_match(readings, best_match),
        n_frames=len(readings),
    )


def _constant_verdicts(
    readings: NDArray[np.float64], varying: NDArray[np.bool_], behaviour: _Behaviour | None
) -> dict[int, tuple[str, str]]:
    rests = behaviour.rest.value if behaviour is not None else np.zeros(1)
    low, high = rests.min(), rests.max()
    slack = 0.05 * np.ptp(readings)
    verdicts = {}
    for i in np.flatnonzero(~varying):
        value = readings[0, i]
        if low - slack <= value <= high + slack:
            verdicts[int(i)] = ("dead", f"always reads {value:g}, as if never touched")
        else:
            verdicts[int(i)] = ("stuck", f"always reads {value:g}, where others never rest")
    return verdicts


def _judged(b: _Behaviour) -> NDArray[np.bool_]:
    """Tell which sensors were active often enough to be judged by how they were."""
    return np.asarray(b.contacts >= FEWEST_CONTACTS)


def _saturating(b: _Behaviour) -> dict[int, str]:
    typical = float(np.median(b.at_ceiling))
    often = b.at_ceiling * b.active * b.n_frames >= _CEILING_FRAMES
    suspects = often & (b.at_ceiling > typical + _CEILING_EXCESS)
    return {
        int(i): f"at its extreme value in {b.at_ceiling[i]:.0%} of its active frames "
        f"(typical: {typical:.0%})"
        for i in np.flatnonzero(suspects)
    }


def _intermittent(b: _Behaviour) -> dict[int, str]:
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


def _noisy(b: _Behaviour) -> dict[int, str]:
    typical = float(np.median(b.lag_correlation))
    spread = max(_OUTLIER * _spread(b.lag_correlation), _CHANCE / np.sqrt(b.n_frames))
    limit = min(_NOISE_RATIO * typical, typical - spread)
    suspects = _judged(b) & (b.lag_correlation < limit)
    return {
        int(i): f"jumps from frame to frame: lag-1 autocorrelation {b.lag_correlation[i]:.2f} "
        f"(typical: {typical:.2f})"
        for i in np.flatnonzero(suspects)
    }


def _isolated(b: _Behaviour) -> dict[int, str]:
    return {
        int(
            i
        ): f"related to no other sensor beyond chance: its highest r is {b.best_match[i]:.2f}, "
        f"and chance alone gives up to {b.chance_match[i]:.2f}"
        for i in np.flatnonzero(b.best_match <= b.chance_match)
    }


_TESTS: dict[str, Callable[[_Behaviour], dict[int, str]]] = {
    "saturating": _saturating,
    "noisy": _noisy,
    "intermittent": _intermittent,
    "isolated": _isolated,
}


def _unexplained(
    active: NDArray[np.bool_], correlation: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Share of a sensor's active frames in which none of its nearest kin is active."""
    n_sensors = active.shape[1]
    matches = min(_MATCHES, n_sensors - 1)
    if matches < 1:
        return np.zeros(n_sensors)
    kin = np.argpartition(-correlation, matches - 1, axis=1)[:, :matches]
    alone = [active[:, i] & ~active[:, kin[i]].any(axis=1) for i in range(n_sensors)]
    return _share(np.column_stack(alone), active)


def _lag_correlation(readings: NDArray[np.float64]) -> NDArray[np.float64]:
    centred = readings - readings.mean(axis=0)
    centred /= np.abs(centred).max(axis=0)
    return np.asarray((centred[1:] * centred[:-1]).sum(axis=0) / (centred**2).sum(axis=0))


def _chance_match(
    readings: NDArray[np.float64], best_match: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Give the highest r that a sensor has with any other if its frames are shifted in time.

    Frames overlap in time, so that no formula for independent frames holds; a shift leaves all
    that a sensor does as it is, but for when. A sensor with a clear relation is not shifted: -1.
    """
    n_frames, n_sensors = readings.shape
    chance = np.full(n_sensors, -1.0)
    suspects = np.flatnonzero(best_match < _CLEAR_RELATION)
    if not suspects.size or n_frames < 2 * _SHIFTS:
        return chance
    standard = readings - readings.mean(axis=0)
    standard /= np.abs(standard).max(axis=0)
    standard /= np.linalg.norm(standard, axis=0)
    for step in range(1, _SHIFTS + 1):
        shifted = np.roll(standard[:, suspects], step * n_frames // (_SHIFTS + 1), axis=0)
        correlation = shifted.T @ standard
        correlation[np.arange(suspects.size), suspects] = -1
        chance[suspects] = np.maximum(chance[suspects], correlation.max(axis=1))
    return chance


def _share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> NDArray[np.float64]:
    counts = np.count_nonzero(whole, axis=0)
    return np.asarray(np.count_nonzero(part, axis=0) / np.maximum(counts, 1))


def _spread(values: NDArray[np.float64]) -> float:
    return float(np.median(np.abs(values - np.median(values))))


def shortened(items: Sequence[object], most: int = 8) -> str:
    """List the first few items, and say how many more there are."""
    more = f" and {len(items) - most} more" if len(items) > most else ""
    return ", ".join(map(str, items[:most])) + more
