"""Summary of a recording, and reasons why a map of it may be unreliable.

Faults of a recording as a whole: which there are, and their repair.

To add a fault, add a `Check` and one line to `CHECKS`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from anisomap.health import checks as electronics
from anisomap.health import checks as stimulation
from anisomap.health.checks import Check, Finding, Subject
from anisomap.health.sensors import MIN_CONTACTS, SensorHealth, assess
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.recording import Recording, as_runs
from anisomap.wording import join_items

MIN_FRAMES = 500
"""Frames below which a recording is short: about half of the paper's shortest run (1,054)."""


@dataclass(frozen=True)
class RecordingSummary:
    """Summary of a recording.

    Attributes
    ----------
    n_frames, n_sensors : int
        Size.
    rate_hz, duration : float or None
        Frames per second, and seconds; None if unknown.
    minimum, maximum : float
        Range of all finite readings.
    share_of_zeros : float
        Share of readings that are exactly 0, in [0, 1].
    distinct_values : int
        Median number of distinct values per sensor.
    missing : int
        Number of readings that are NaN or infinite.
    n_constant : int
        Number of constant sensors.
    warnings : tuple of str
        Reasons why a map may be unreliable.
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


def summarise(
    recording: Recording, health: Sequence[SensorHealth] | None = None
) -> RecordingSummary:
    """Summarise a recording.

    Parameters
    ----------
    recording : Recording
    health : sequence of SensorHealth, optional
        From `assess`, if computed already.

    Returns
    -------
    RecordingSummary
    """
    readings = recording.readings
    finite = np.isfinite(readings)
    assessed = assess(recording) if health is None else health
    return RecordingSummary(
        n_frames=recording.n_frames,
        n_sensors=recording.n_sensors,
        rate_hz=recording.rate_hz,
        duration=recording.duration,
        minimum=float(readings.min(where=finite, initial=np.inf)),
        maximum=float(readings.max(where=finite, initial=-np.inf)),
        share_of_zeros=float(np.mean(readings == 0)),
        distinct_values=int(np.median([sensor.distinct for sensor in assessed])),
        missing=int(np.count_nonzero(~finite)),
        n_constant=int(np.count_nonzero(~recording.varying())),
        warnings=weaknesses(recording, assessed),
    )


def weaknesses(recording: Recording, health: Sequence[SensorHealth]) -> tuple[str, ...]:
    """List reasons why a map of a recording may be unreliable."""
    found = []
    if recording.n_frames < MIN_FRAMES:
        found.append(
            f"only {recording.n_frames} frames: statistics are unreliable; record {MIN_FRAMES} or "
            "more"
        )
    groups = {
        "never vary and carry no information": ("dead", "stuck"),
        "look faulty and may distort the whole map; drop them": (
            "saturating",
            "intermittent",
            "noisy",
        ),
        "have no significant correlation with another sensor, so their positions are arbitrary": (
            "isolated",
        ),
    }
    for fault, statuses in groups.items():
        names = [sensor.name for sensor in health if sensor.status in statuses]
        if names:
            caution = (
                "do not trust a map of this recording: " if 2 * len(names) > len(health) else ""
            )
            listed = join_items(names)
            found.append(f"{caution}{len(names)} of {len(health)} sensors {fault}: {listed}")
    rare = [s.name for s in health if 0 < s.contacts < MIN_CONTACTS and s.status == "ok"]
    if rare:
        found.append(
            f"{len(rare)} of {len(health)} sensors were touched fewer than {MIN_CONTACTS} "
            f"times: {join_items(rare)}"
        )
    return tuple(found)


def spoiling(findings: Sequence[Finding]) -> tuple[str, ...]:
    """List what spoils a map among the faults of its recording."""
    return tuple(
        f"{finding}" + ("; repair the recording" if finding.mendable else "")
        for finding in findings
        if finding.kind != "few-contacts"
    )


CHECKS: Mapping[str, Check] = MappingProxyType(
    {
        "clock-jitter": stimulation.CLOCK_JITTER,
        "gaps": stimulation.GAPS,
        "hum": electronics.HUM,
        "one-period": stimulation.ONE_PERIOD,
        "common-noise": electronics.COMMON_NOISE,
        "spikes": electronics.SPIKES,
        "drift": electronics.DRIFT,
        "saturation": stimulation.SATURATION,
        "inverted": electronics.INVERTED,
        "lags": electronics.LAGS,
        "leak": electronics.LEAK,
        "copies": electronics.COPIES,
        "separate-regions": stimulation.SEPARATE_REGIONS,
        "few-contacts": stimulation.FEW_CONTACTS,
    }
)
"""Checks in the order in which they are made.

Each fault is mended before the next is searched, since one fault can hide another or look like it:
the order is opposite to that in which faults arise, from contact to file.
"""

FINAL = ("one-period",)
"""Findings after which nothing else is searched."""


@dataclass(frozen=True, eq=False)
class Repair:
    """A repaired recording.

    Attributes
    ----------
    recording : Recording
        With all mendable faults mended.
    findings : tuple of Finding
        All faults that were found, mendable or not.
    """

    recording: Recording
    findings: tuple[Finding, ...]

    @property
    def done(self) -> tuple[str, ...]:
        """What was done, one sentence for each mended fault."""
        return tuple(
            f"{finding.what}: {finding.mended}" for finding in self.findings if finding.mendable
        )


def repair(recording: Recording | ArrayLike) -> Repair:
    """Find the faults of a recording, and mend those that can be mended.

    Parameters
    ----------
    recording : Recording or array_like of shape (T, N)
        Columns in the order in which channels are read, for leaks and lags. Missing readings are
        estimated from similar sensors where they are many, and else interpolated.

    Returns
    -------
    Repair
        The recording itself, if nothing was mended. Copies are left out, so it may have fewer
        sensors, and, after lags, fewer frames.

    Examples
    --------
    A skin of 60 sensors, of which one is wired twice:

    >>> import numpy as np
    >>> places = np.random.default_rng(0).uniform(0, 5, (60, 2))
    >>> touches = np.random.default_rng(1).uniform(0, 5, (2000, 1, 2))
    >>> readings = np.maximum(0, 1.5 - np.linalg.norm(touches - places, axis=2))
    >>> readings[:, 7] = readings[:, 31]
    >>> found = repair(readings)
    >>> found.recording.n_sensors
    59
    >>> [(finding.kind, finding.sensors) for finding in found.findings]
    [('copies', ('s7', 's31'))]
    """
    (run,) = as_runs(recording)
    return _examined(run)


def find_faults(
    recording: Recording | ArrayLike | Sequence[Recording],
) -> tuple[Finding, ...]:
    """Find the faults of a recording that spoil a map of it.

    Parameters
    ----------
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        Several recordings that lack sensors are examined one by one.

    Returns
    -------
    tuple of Finding
        In the order of `CHECKS`; empty if there are none.
    """
    found: dict[tuple[str, tuple[str, ...]], Finding] = {}
    for run in as_runs(recording):
        for finding in _examined(run).findings:
            found.setdefault((finding.kind, finding.sensors), finding)
    return tuple(found.values())


def _examined(recording: Recording) -> Repair:
    findings: list[Finding] = []
    with limited_blas(recording.n_sensors):
        current, subject = recording, Subject(recording)
        for kind, check in CHECKS.items():
            if kind not in _BEFORE_COMPLETION and current is subject.recording:
                current = current.complete("interpolate")
            if current is not subject.recording:
                subject = Subject(current)
            evidence = check.find(subject)
            if evidence is None:
                continue
            findings += check.describe(current, evidence)
            if kind in FINAL:
                break
            if check.mend is not None:
                current = check.mend(current, evidence)
    return Repair(current, tuple(findings))


_BEFORE_COMPLETION = ("clock-jitter", "gaps")  # these look at missing readings
