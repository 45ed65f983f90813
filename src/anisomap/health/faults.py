"""Faults of a recording as a whole: which there are, and their repair.

To add a fault, write a function that yields what it found, and add one line to `CHECKS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from anisomap.base.wording import noun_and_items
from anisomap.health.recording_faults import Found
from anisomap.health.recording_faults.common_signals import (
    find_common_noise,
    find_hum,
    find_one_period,
)
from anisomap.health.recording_faults.copies import find_copied
from anisomap.health.recording_faults.drift import find_drift
from anisomap.health.recording_faults.lags import find_lags
from anisomap.health.recording_faults.leaks import find_leak
from anisomap.health.recording_faults.stimulation import find_clipped, find_regions
from anisomap.health.recording_faults.transmission import find_gaps, find_glitches, find_spikes
from anisomap.health.recording_faults.wiring import find_change, find_inverted
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.recording import Recording, as_runs, in_range


@dataclass(frozen=True)
class Finding:
    """A fault of the read-out or of the stimulation that spoils maps.

    Attributes
    ----------
    kind : str
        A key of `CHECKS`, or ``"board-noise"``: common noise of a group of sensors.
    sensors : tuple of str
        Names of the affected sensors.
    size : float
        Size of the fault, in `unit`.
    unit : str
        Unit of `size`; ``"share"`` for shares in [0, 1].
    what : str
        Description with the size, without sensors.
    consequence : str
        What a map of the recording suffers.
    mendable : bool
        Whether `repair` mends it.
    mended : str
        What `repair` does or did; empty if it is not mendable.
    """

    kind: str
    sensors: tuple[str, ...]
    size: float
    unit: str
    what: str
    consequence: str
    mendable: bool
    mended: str = ""

    def __str__(self) -> str:
        """Return the finding as a sentence."""
        listed = f": {noun_and_items('sensor', self.sensors)}" if self.sensors else ""
        return f"{self.what} ({self.consequence}){listed}"


@dataclass(frozen=True)
class Check:
    """A fault that is searched in recordings.

    find: Takes a recording, complete but for the first check, and yields its faults.
    unit, consequence, mended: See `Finding`.
    """

    find: Callable[[Recording], Iterator[Found]]
    unit: str
    consequence: str
    mended: str = ""


_ALIKE = "they look alike wherever they are"

CHECKS: Mapping[str, Check] = MappingProxyType(
    {
        "gaps": Check(
            find_gaps,
            "share",
            "contacts in the gaps are lost, so these sensors seem less similar to their neighbours",
            "these readings were estimated from the most similar sensors",
        ),
        "glitches": Check(
            find_glitches,
            "readings",
            "they outweigh all contacts of these sensors",
            "these readings were replaced by those beside them",
        ),
        "hum": Check(
            find_hum,
            "share of the standard deviation",
            _ALIKE,
            "a sine was fitted to each of them and subtracted",
        ),
        "one-period": Check(
            find_one_period,
            "share of the variance",
            "similarity depends on phase alone; there is nothing to map",
        ),
        "common-noise": Check(
            find_common_noise,
            "share of the standard deviation",
            _ALIKE,
            "the common signal was estimated in each frame and subtracted",
        ),
        "spikes": Check(
            find_spikes,
            "share of the frames",
            _ALIKE,
            "these frames were replaced by the mean of the frames beside them",
        ),
        "drift": Check(
            find_drift,
            "standard deviations",
            "sensors that drift alike look related, and contacts are hidden",
            "their level at rest was estimated over time and subtracted",
        ),
        "saturation": Check(
            find_clipped,
            "share of the frames",
            "heights of contacts are cut off; lengths that follow from heights are wrong",
        ),
        "inverted": Check(
            find_inverted,
            "share",
            "they look unrelated to their neighbours",
            "these sensors were mirrored at their rest value",
        ),
        "lags": Check(
            find_lags,
            "frames",
            "sensors of different groups seem less similar than they are",
        ),
        "leak": Check(
            find_leak,
            "share",
            "sensors that are adjacent in the order of the channels look like neighbours",
            "the leak was subtracted from each channel",
        ),
        "copies": Check(
            find_copied,
            "sensors",
            "sensors at one place distort the map around them; at most one of them is right",
        ),
        "changed": Check(
            find_change,
            "share",
            "wires were exchanged, or the body took another posture; map the frames before and "
            "after by themselves",
        ),
        "separate-regions": Check(
            find_regions,
            "sensors touched with both",
            "the relative position of the regions is unknown; touch the skin between them",
        ),
    }
)
"""Checks in the order in which they are made.

Each fault is mended before the next is searched, since one fault can hide another or look like it:
the order is opposite to that in which faults arise, from contact to file.
"""

_FINAL = ("one-period",)  # after which nothing else is searched
_BEFORE_COMPLETION = ("gaps",)  # these look at missing readings


def spoiling(findings: Sequence[Finding]) -> tuple[str, ...]:
    """List what spoils a map among the faults of its recording."""
    return tuple(
        f"{finding}" + ("; repair the recording" if finding.mendable else "")
        for finding in findings
    )


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
    findings = []
    scaled, unit = in_range(recording)
    with limited_blas(recording.n_sensors):
        current = scaled
        for kind, check in CHECKS.items():
            if kind not in _BEFORE_COMPLETION:
                current = current.complete("interpolate")
            found = list(check.find(current))
            findings += [
                Finding(
                    kind=one.kind or kind,
                    sensors=tuple(current.names[int(i)] for i in one.sensors),
                    size=float(one.size),
                    unit=check.unit,
                    what=one.what + ("" if one.height is None else f"{unit * one.height:.3g}"),
                    consequence=check.consequence,
                    mendable=one.mend is not None,
                    mended="" if one.mend is None else one.mended or check.mended,
                )
                for one in found
            ]
            if found and kind in _FINAL:
                break
            for one in found:
                current = current if one.mend is None else one.mend(current)
    if current is scaled:
        return Repair(recording, tuple(findings))
    with np.errstate(over="ignore"):  # of differences, which are twice as large
        readings = current.readings if unit == 1 else unit * current.readings
    return Repair(replace(current, readings=readings), tuple(findings))
