"""What is in a recording as a whole, and why a map of it may be weak."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anisomap.health.assessment import FEWEST_CONTACTS, SensorHealth, assess
from anisomap.recording import Recording
from anisomap.wording import join_items

FEWEST_FRAMES = 500
"""The paper's shortest run has 1,054 frames; below half of that its correlations are unsteady."""


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
        "look faulty and may distort the whole map (leave them out: --drop)": (
            "saturating",
            "intermittent",
            "noisy",
        ),
        "are related to no other sensor beyond chance, so their place is a guess": ("isolated",),
    }
    for what, statuses in groups.items():
        names = [sensor.name for sensor in health if sensor.status in statuses]
        if names:
            verdict = "do not trust a map of this: " if 2 * len(names) > len(health) else ""
            listed = join_items(names)
            found.append(f"{verdict}{len(names)} of {len(health)} sensors {what}: {listed}")
    rare = [s.name for s in health if 0 < s.contacts < FEWEST_CONTACTS and s.status == "ok"]
    if rare:
        found.append(
            f"{len(rare)} of {len(health)} sensors were touched fewer than {FEWEST_CONTACTS} "
            f"times: {join_items(rare)}"
        )
    return tuple(found)
