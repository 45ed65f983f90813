"""Faults of the read-out that concern several sensors, and courses that no map can be made of.

Each module finds one fault in a complete recording, or a few alike, and mends it where it knows the
inverse. Faults are searched in an excerpt of some thousand frames and some hundred
sensors; see `anisomap.numerics.signals`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.neighbours import linked_labels
from anisomap.numerics.signals import some_sensors, unit_rows
from anisomap.recording import Recording


@dataclass(frozen=True, eq=False)
class Found:
    """One fault of a recording.

    sensors: Their indices.
    size, values: See `anisomap.health.Finding`.
    mend: Mends the fault in the recording; None if it cannot be mended.
    kind: If it differs from the key of the check.
    """

    sensors: NDArray[np.intp] | Sequence[int]
    size: float
    values: Mapping[str, Any] = field(default_factory=dict)
    mend: Callable[[Recording], Recording] | None = None
    kind: str = ""


def with_readings(
    change: Callable[[NDArray[Any]], NDArray[Any]],
) -> Callable[[Recording], Recording]:
    """Return a repair that changes the readings alone, shape (T, N)."""
    return lambda recording: replace(recording, readings=change(recording.readings))


def halves_of(n_frames: int) -> tuple[slice, slice]:
    """Return the frames of both halves of a recording."""
    return slice(n_frames // 2), slice(n_frames // 2, None)


def agree_more(before: NDArray[Any], after: NDArray[Any], group: NDArray[np.intp]) -> bool:
    """Return whether a group of sensors resembles other sensors more after a mend.

    before, after (T, N): Readings, which do not differ in other sensors.

    Others have no part in a fault of the group, but in the contacts that might be taken for one.
    The sensor with which each is compared in either half is chosen in the other half.
    """
    others = np.setdiff1d(np.arange(before.shape[1]), group)
    others = others[some_sensors(others.size)]
    one, other = halves_of(len(before))
    for here, there in ((one, other), (other, one)):
        r = unit_rows(after[there][:, group]) @ unit_rows(after[there][:, others]).T
        partners = unit_rows(after[here][:, others[r.argmax(axis=1)]])
        rows = (unit_rows(readings[here][:, group]) for readings in (before, after))
        was, now = (np.einsum("nt,nt->n", one, partners).mean() for one in rows)
        if not now > was:
            return False
    return True


# Patterns of contact that a surface needs: place in two dimensions, and height.
_MIN_PATTERNS = 3
_N_NEAR = 32  # sensors whose patterns are counted: more may be touched at other places; by hand
_MIN_ALONE = 3  # frames in which a sensor is touched and another rests; fewer may be noise
_MIN_TURNING = 1 / 3  # share of the frames
_N_SHIFTED = 19  # shifts, of which the largest is exceeded by chance with probability 1 / 20


def has_contacts(recording: Recording, members: NDArray[np.intp]) -> bool:
    """Return whether a group of sensors is in contacts of several kinds.

    Else what they share may be the contact that touches all of them.

    recording: From which noise or spikes that they share are removed.

    Patterns of contact of the member with most contacts and the sensors most similar to it are
    counted by parallel analysis (Horn 1965, Psychometrika 30: 179-185, doi:10.1007/BF02289447): the
    eigenvalues of their correlations, down to the first one that chance explains. Chance is what
    the same readings give if each sensor is shifted in time, by its own number of frames. Sensors
    that are similar but not in the group must also be touched at several places, unless most of
    them always vary.
    """
    signals = recording.signals
    rows = signals.excerpt_rows
    most = members[signals.contacts[members].argmax()]
    nearest = np.argsort(-np.abs(rows @ rows[most]), kind="stable")
    near = rows[nearest[:_N_NEAR]]
    eigenvalues = np.linalg.eigvalsh(near @ near.T)[::-1]
    by_chance = np.zeros(len(near))
    for shifts in np.random.default_rng(0).integers(near.shape[1], size=(_N_SHIFTED, len(near))):
        shifted = np.stack([np.roll(row, n) for row, n in zip(near, shifts, strict=True)])
        by_chance = np.maximum(by_chance, np.linalg.eigvalsh(shifted @ shifted.T)[::-1])
    if len(near) < _MIN_PATTERNS or not (eigenvalues > by_chance)[:_MIN_PATTERNS].all():
        return False
    outside = nearest[~np.isin(nearest, members)][:_N_NEAR]
    touched, active = signals.touched[:, outside], signals.active[:, outside]
    always = np.count_nonzero(touched.all(axis=0))
    if outside.size < _MIN_PATTERNS or 2 * always > outside.size:
        return True
    return _at_several_places(touched, active)


def _at_several_places(touched: NDArray[np.bool_], active: NDArray[np.bool_]) -> bool:
    """Return whether each of three sensors is touched while each of the others rests.

    touched, active (T, n): Clearly beyond rest, and beyond rest at all.

    Contacts at one place reach the same sensors first, whatever their force.
    """
    alone = touched.T.astype(np.float32) @ ~active
    apart = np.minimum(alone, alone.T) >= _MIN_ALONE
    return bool((apart & (apart.astype(np.float32) @ apart > 0)).any())


def turns_like_noise(course: NDArray[np.floating]) -> bool:
    """Return whether a signal, (T,), has half as many turning points as white noise, or more.

    Two thirds of the frames of white noise are turning points (Bienayme 1874); contacts that are
    sampled well have few of them.
    """
    rises = np.diff(course) > 0
    return bool(np.mean(rises[1:] != rises[:-1]) >= _MIN_TURNING)


def linked_groups(
    rows: NDArray[np.float32], least: float, size: int
) -> Iterator[NDArray[np.bool_]]:
    """Mark each group of `size` rows or more, of norm 1, that correlations above `least` link."""
    group = linked_labels(rows @ rows.T > least)
    for number in np.flatnonzero(np.bincount(group) >= size):
        yield group == number
