"""Faults of a recording as a whole: which there are, and their repair.

To add a fault, add a `Check` and one line to `CHECKS`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from numpy.typing import ArrayLike

from anisomap.health import electronics, stimulation
from anisomap.health.findings import Check, Finding, Subject
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.recording import Recording
from anisomap.runs import as_runs

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
