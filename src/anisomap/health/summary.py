"""Summary of a recording, and reasons why a map of it may be unreliable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from anisomap.base.immutable import Value
from anisomap.base.wording import join_items, number, percent
from anisomap.health.sensors import MIN_CONTACTS, STATUSES, SensorHealth, assess, exceeded_by_chance
from anisomap.numerics.signals import some_sensors
from anisomap.recording import Recording
from anisomap.sensor_map import FEW_CONTACTS, SILENT, is_faulty

MIN_FRAMES = 500
"""Minimum number of frames; about half of the shortest run in the paper (1,054)."""


_CLEAR_R = 0.6  # median of the highest correlations that excludes chance; chosen by hand
_N_SHIFTED = 64  # sensors that tell whether most are correlated by chance alone
_FEWER, _FEW = 16, 1 / 8  # of these, and the share that is correlated so with probability .002
_FAULTY = tuple(status for status in STATUSES if is_faulty(status) and status != "stuck")
_MEANINGS: dict[str, tuple[str, ...]] = {
    "sensors that never varied (dead, or never touched)": (SILENT,),
    f"sensors with fewer than {MIN_CONTACTS} contacts, too few for reliable positions (touch them "
    "again)": (FEW_CONTACTS,),
    "stuck sensors, which carry no information": ("stuck",),
    "faulty sensors, whose positions are unreliable": _FAULTY,
}
"""Meanings of all statuses except "ok"."""


@dataclass(frozen=True, eq=False)
class RecordingSummary(Value):
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

    @property
    def facts(self) -> dict[str, str]:
        """Texts of the summary, for commands and reports."""
        duration = "" if self.duration is None else f", {number(self.duration)} s"
        return {
            "frames": f"{self.n_frames}{duration}",
            "rate": "unknown" if self.rate_hz is None else number(self.rate_hz, unit="Hz"),
            "sensors": f"{self.n_sensors}, "
            + (f"{self.n_constant} constant" if self.n_constant else "all active"),
            "readings": f"{number(self.minimum)} to {number(self.maximum)}, "
            f"{percent(self.share_of_zeros)} zeros, {self.missing} missing",
            "distinct values": f"{self.distinct_values} per sensor (median)",
        }


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


def _unrelated(recording: Recording, health: Sequence[SensorHealth]) -> list[str]:
    """Return a warning if most sensors correlate with no other sensor more than by chance."""
    best = np.array([sensor.best_match for sensor in health])
    varying = recording.indices([s.name for s in health if np.isfinite(s.best_match)])
    best = best[np.isfinite(best)]
    if not best.size or np.median(best) >= _CLEAR_R:
        return []
    readings = replace(recording, starts=()).complete("interpolate").readings[:, varying]
    some = some_sensors(best.size, _N_SHIFTED)
    for part, most in ((some[:: max(1, some.size // _FEWER)], _FEW), (some, 0.5)):
        share = np.count_nonzero(exceeded_by_chance(readings, part, best)) / part.size
        if share <= most:
            return []
    return [
        f"do not trust a map of this recording: {share:.0%} of the sensors have no significant "
        f"correlation with another; record {'more contacts' if recording.touched else 'longer'}"
    ]


def weaknesses(recording: Recording, health: Sequence[SensorHealth]) -> tuple[str, ...]:
    """List reasons why a map of a recording may be unreliable."""
    found = []
    if recording.n_frames < MIN_FRAMES:
        found.append(
            f"only {recording.n_frames} frames: statistics are unreliable; record "
            f"{MIN_FRAMES} or more"
        )
    n_told = sum(is_faulty(sensor.status) for sensor in health)
    caution = "do not trust a map of this recording: " if 2 * n_told > len(health) else ""
    found += _unrelated(recording, health)
    for meaning, statuses in _MEANINGS.items():
        names = [sensor.name for sensor in health if sensor.status in statuses]
        if names and (recording.touched or statuses != (FEW_CONTACTS,)):
            before = caution if all(map(is_faulty, statuses)) else ""
            found.append(f"{before}{meaning}: {len(names)} of {len(health)} ({join_items(names)})")
    return tuple(found)
