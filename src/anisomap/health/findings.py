"""Findings about a recording as a whole, and their repair."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.health.activity import frames_in_contact
from anisomap.health.contact_counts import count_runs
from anisomap.numerics.columns import columns
from anisomap.numerics.recording_faults.common_mode import never_at_rest
from anisomap.recording import Recording
from anisomap.wording import noun_and_items

_MAX_FRAMES = 8192  # in which activity is compared


@dataclass(frozen=True)
class Finding:
    """A fault of the read-out or of the stimulation that spoils maps.

    Attributes
    ----------
    kind : str
        A key of `CHECKS`.
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


@dataclass(frozen=True, eq=False)
class Subject:
    """A complete recording that is examined, with statistics that several checks use."""

    recording: Recording

    @property
    def readings(self) -> NDArray[np.floating]:
        """Readings of the recording, shape (T, N)."""
        return self.recording.readings

    @cached_property
    def active(self) -> NDArray[np.bool_]:
        """Whether sensors are in contact, shape (t, N): in all frames, or in evenly spaced ones."""
        part = self.readings[:: -(-len(self.readings) // _MAX_FRAMES)]
        active = np.empty(part.shape[::-1], dtype=bool)
        for column, frames in zip(columns(part), active, strict=True):
            frames[:] = frames_in_contact(column)
        return active.T

    @cached_property
    def never_at_rest(self) -> NDArray[np.intp]:
        """Sensors that no value occurs often in."""
        return never_at_rest(self.readings)

    def contacts(self, sensors: NDArray[np.intp]) -> NDArray[np.intp]:
        """Count the contacts of some sensors: runs of frames beyond rest, shape (n,)."""
        found = (
            count_runs(frames_in_contact(column)) for column in columns(self.readings[:, sensors])
        )
        return np.fromiter(found, dtype=np.intp, count=sensors.size)


@dataclass(frozen=True)
class Check:
    """A fault that is searched in recordings.

    Attributes
    ----------
    find : callable
        Takes a `Subject`, and returns evidence of the fault, or None.
    describe : callable
        Takes the recording and the evidence, and returns the findings.
    mend : callable, optional
        Takes the recording and the evidence, and returns a mended recording.
    """

    find: Callable[[Subject], Any]
    describe: Callable[[Recording, Any], tuple[Finding, ...]]
    mend: Callable[[Recording, Any], Recording] | None = None
