"""Summary of a recording, and reasons why a map of it may be unreliable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from anisomap.health.sensors import MIN_CONTACTS, SensorHealth, assess
from anisomap.recording import Recording
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
