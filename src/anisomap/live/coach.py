"""Where to touch next, in words and as marks on the map."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.health import SensorHealth
from anisomap.health.touch_coverage import (
    ENOUGH_CONTACTS,
    Place,
    needed_evidence,
    neighbouring_sensors,
    next_places,
)
from anisomap.numerics.signals import count_contacts, count_joint_contacts
from anisomap.recording import Recording
from anisomap.sensor_map import is_faulty
from anisomap.wording import join_items

MAX_PLACES = 3
"""Number of places that are marked: what a person can follow while touching."""

_MAX_NAMED = 5


@dataclass(frozen=True, eq=False)
class Advice:
    """Advice to the person who touches the skin.

    places: Where contacts are lacking, the most urgent first.
    untouched: Sensors that were never touched.
    share_done: Share of the evidence that is there, in [0, 1].
    text: One sentence.
    """

    places: tuple[Place, ...] = ()
    untouched: tuple[int, ...] = ()
    share_done: float = 0.0
    text: str = "touch the skin"

    @property
    def next_sensors(self) -> tuple[int, ...]:
        """Sensors to touch next, for a simulated hand; none for anywhere."""
        return self.untouched or (self.places[0].sensors if self.places else ())

    @property
    def enough(self) -> bool:
        """Whether more contacts would gain little."""
        return not (self.places or self.untouched) and self.share_done > 0


def confirmed_faults(health: Iterable[SensorHealth]) -> tuple[SensorHealth, ...]:
    """Return the sensors that are faulty, without those that were hardly touched so far."""
    return tuple(
        sensor
        for sensor in health
        if is_faulty(sensor.status)
        and (sensor.status == "stuck" or sensor.contacts >= ENOUGH_CONTACTS)
    )


def advise(
    positions: NDArray[np.float64],
    contacts: NDArray[np.intp],
    recording: Recording,
    names: Sequence[str],
    drop: Collection[int] = (),
) -> Advice:
    """Advise where to touch next. positions (N, k), contacts (N,) in all frames.

    recording: A sample of the frames. Joint contacts are counted in it, and grow as its contacts
        fall short of those in all frames.
    """
    wanted = np.ones(len(names), dtype=bool)
    wanted[list(drop)] = False
    placed = np.isfinite(positions).all(axis=1)
    untouched = tuple(np.flatnonzero(wanted & (contacts == 0)).tolist())
    if not placed.any():
        return Advice(untouched=untouched)
    pairs, active = neighbouring_sensors(positions), recording.signals.active
    share = count_contacts(active).sum() / max(contacts.sum(), 1)
    together = count_joint_contacts(active, pairs) / min(max(share, 1e-9), 1)
    need = needed_evidence(contacts, pairs, together)
    places = next_places(positions, np.where(wanted & placed, need, 0), n_places=MAX_PLACES)
    done = 1 - float(need[wanted].mean()) if wanted.any() else 0.0
    return Advice(places, untouched, done, _in_words(places, untouched, names))


def _in_words(places: Sequence[Place], untouched: Sequence[int], names: Sequence[str]) -> str:
    parts = [f"touch {' and '.join(p.in_words(names) for p in places[:2])}"] if places else []
    if untouched:
        listed = join_items([names[i] for i in untouched], _MAX_NAMED)
        plural = "s" if len(untouched) > 1 else ""
        parts.append(f"{len(untouched)} sensor{plural} never touched: {listed}")
    if parts:
        return "; ".join(parts)
    return (
        f"enough touches: sensors had about {ENOUGH_CONTACTS} contacts or more, "
        "alone and together with their neighbours"
    )
