"""Detection and repair of faults of a recording as a whole.

To add a fault, write a function that yields `Found`, one line in `CHECKS`, and texts in
`anisomap.health.findings`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from numpy.typing import ArrayLike

from anisomap.health.findings import Finding
from anisomap.health.recording_faults import Found
from anisomap.health.recording_faults.common_signals import find_common_noise, find_hum
from anisomap.health.recording_faults.copies import find_copied
from anisomap.health.recording_faults.gaps import find_frozen, find_gaps
from anisomap.health.recording_faults.leaks import find_leak
from anisomap.health.recording_faults.spikes import find_spikes
from anisomap.health.recording_faults.steps import find_steps
from anisomap.health.recording_faults.stimulation import find_clipped, find_regions
from anisomap.health.recording_faults.wiring import find_change, find_inverted
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.recording import Recording, join_runs

CHECKS: Mapping[str, Callable[[Recording], Iterator[Found]]] = MappingProxyType(
    {
        "gaps": find_gaps,
        "frozen": find_frozen,
        "hum": find_hum,
        "common-noise": find_common_noise,
        "spikes": find_spikes,
        "steps": find_steps,
        "saturation": find_clipped,
        "inverted": find_inverted,
        "leak": find_leak,
        "copies": find_copied,
        "changed": find_change,
        "separate-regions": find_regions,
    }
)
"""Checks in the order in which they are run. All but the first require complete recordings.

Each mendable fault is mended before the next check, since a fault can hide or resemble another one.
The order is the reverse of the order in which faults arise, from contact to file.
"""

# With a leak, an untouched sensor contains readings of the preceding channel, perhaps in a part of
# the recording only: 5 of 40 skins with a leak seemed to have changed, and none without it. Noise
# of all sensors jumps in single frames, as spikes do.
_HIDES = {"changed": "leak", "spikes": "common-noise"}
_BEFORE_COMPLETION = ("gaps",)  # checks of missing readings


@dataclass(frozen=True, eq=False)
class Repair:
    """A repaired recording.

    Attributes
    ----------
    recording : Recording
        With all mendable faults mended.
    findings : tuple of Finding
        All faults found, whether mendable or not.
    """

    recording: Recording
    findings: tuple[Finding, ...]

    @property
    def done(self) -> tuple[str, ...]:
        """One sentence about the repair of each mended fault."""
        return tuple(
            f"{finding.what}: {finding.mended}" for finding in self.findings if finding.mendable
        )


def repair(recording: Recording | ArrayLike | Sequence[Recording]) -> Repair:
    """Find the faults of a recording, and mend the mendable ones.

    Parameters
    ----------
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        Columns in the order in which channels are read, since leaks depend on it. If any of several
        recordings lacks sensors, each recording is mended separately.

    Returns
    -------
    Repair
        If nothing was mended, it contains the given recording. Otherwise, copies of sensors and
        frames that repeat the preceding frame are removed.

    Raises
    ------
    InputError
        If the recordings do not match: see `anisomap.join_runs`.

    Notes
    -----
    Copies, inverted sensors, hum, noise of boards, gaps and frozen frames are mended. Gaps are
    filled from similar sensors if these predict known readings better than interpolation. Leaks,
    steps, limited ranges, spikes and noise of all sensors are only reported, since subtracting
    estimates of them impaired more maps than it improved.

    Examples
    --------
    A skin of 60 sensors, one of which is wired twice:

    >>> import numpy as np
    >>> places = np.random.default_rng(0).uniform(0, 5, (60, 2))
    >>> touches = np.random.default_rng(1).uniform(0, 5, (2000, 1, 2))
    >>> readings = np.maximum(0, 1.5 - np.linalg.norm(touches - places, axis=2))
    >>> readings[:, 7] = readings[:, 31]
    >>> found = repair(readings)
    >>> found.recording.n_sensors
    58
    >>> [(finding.kind, finding.sensors) for finding in found.findings]
    [('copies', ('s7', 's31'))]
    """
    found = [_examined(part) for part in join_runs(recording).parts]
    if len(found) == 1:
        return found[0]
    findings = tuple(finding for one in found for finding in one.findings)
    return Repair(join_runs([one.recording for one in found]), findings)


def find_faults(recording: Recording | ArrayLike | Sequence[Recording]) -> tuple[Finding, ...]:
    """Find the faults of a recording that impair its map.

    Parameters
    ----------
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        If any of several recordings lacks sensors, each recording is examined separately.

    Returns
    -------
    tuple of Finding
        In the order of `CHECKS`; empty if there are none.

    Raises
    ------
    InputError
        If the recordings do not match: see `anisomap.join_runs`.
    """
    found: dict[tuple[str, tuple[str, ...]], Finding] = {}
    for part in join_runs(recording).parts:
        for finding in _examined(part).findings:
            found.setdefault((finding.kind, finding.sensors), finding)
    return tuple(found.values())


def _examined(recording: Recording) -> Repair:
    findings = list[Finding]()
    with limited_blas(recording.n_sensors):
        current = recording
        for kind, find in CHECKS.items():
            if any(one.kind == _HIDES.get(kind) for one in findings):
                continue
            if kind not in _BEFORE_COMPLETION:
                current = current.complete("interpolate")
            found = list(find(current))
            findings += [
                Finding(
                    kind=one.kind or kind,
                    sensors=tuple(current.names[int(i)] for i in one.sensors),
                    size=float(one.size),
                    values=one.values,
                    mendable=one.mend is not None,
                )
                for one in found
            ]
            for one in found:
                current = current if one.mend is None else one.mend(current)
    mended = any(finding.mendable for finding in findings)
    return Repair(current if mended else recording, tuple(findings))
