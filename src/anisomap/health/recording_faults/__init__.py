"""Faults of the read-out of several sensors, and stimulation from which no map can be made.

Each module finds one fault, or a few similar ones, in a complete recording. Faults with a known
inverse are mended. Faults are searched for in an excerpt of a few thousand frames and a few hundred
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

    sensors: Indices of the affected sensors.
    size, values: See `anisomap.health.Finding`.
    mend: Mends the fault in the recording; None if it cannot be mended.
    kind: Kind of the fault if it differs from the key of the check.
    """

    sensors: NDArray[np.intp] | Sequence[int]
    size: float
    values: Mapping[str, Any] = field(default_factory=dict)
    mend: Callable[[Recording], Recording] | None = None
    kind: str = ""


def with_readings(
    change: Callable[[NDArray[Any]], NDArray[Any]],
) -> Callable[[Recording], Recording]:
    """Return a repair that changes only the readings, shape (T, N)."""
    return lambda recording: replace(recording, readings=change(recording.readings))


def halves_of(n_frames: int) -> tuple[slice, slice]:
    """Return the frames of both halves of a recording."""
    return slice(n_frames // 2), slice(n_frames // 2, None)


def agree_more(before: NDArray[Any], after: NDArray[Any], group: NDArray[np.intp]) -> bool:
    """Return whether a group of sensors resembles other sensors more after a repair.

    before, after (T, N): Readings, which differ only in the group.

    Other sensors do not share a fault of the group, but they share contacts that resemble a fault.
    The sensor with which each is compared in one half of the frames is chosen in the other half.
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


# Minimum number of patterns of contact on a surface: position in two dimensions, and height.
_MIN_PATTERNS = 3
_N_NEAR = 32  # sensors whose patterns are counted; further ones have other contacts; by hand
_MIN_ALONE = 3  # frames in which a sensor is touched and another rests; fewer may be noise
_MIN_TURNING = 1 / 3  # share of the frames
_N_SHIFTED = 19  # shifts, of which the largest is exceeded by chance with probability 1 / 20


def has_contacts(recording: Recording, members: NDArray[np.intp]) -> bool:
    """Return whether a group of sensors has contacts of several kinds.

    Otherwise, their common signal may be a contact that touches all of them.

    recording: Recording without the common noise or spikes of the group.

    Patterns of contact of the member with most contacts and the sensors most similar to it are
    counted by parallel analysis (Horn 1965, Psychometrika 30: 179-185, doi:10.1007/BF02289447). The
    number of patterns is the number of leading eigenvalues of the correlations that exceed chance,
    which is estimated by shifting each sensor in time by a different number of frames. Similar
    sensors outside the group must also be touched at several places, unless most always vary.
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
    """Return whether each of three sensors is touched while each of the other two rests.

    touched, active (T, n): Clearly beyond rest, and beyond rest.

    Contacts at one place reach the same sensors first, independently of force.
    """
    alone = touched.T.astype(np.float32) @ ~active
    apart = np.minimum(alone, alone.T) >= _MIN_ALONE
    return bool((apart & (apart.astype(np.float32) @ apart > 0)).any())


def turns_like_noise(course: NDArray[np.floating]) -> bool:
    """Return whether a signal, (T,), has at least half as many turning points as white noise.

    Two thirds of the frames of white noise are turning points (Bienayme 1874). Well-sampled
    contacts have few turning points.
    """
    rises = np.diff(course) > 0
    return bool(np.mean(rises[1:] != rises[:-1]) >= _MIN_TURNING)


def linked_groups(
    rows: NDArray[np.float32], least: float, size: int
) -> Iterator[NDArray[np.bool_]]:
    """Mark each group of at least `size` rows, of norm 1, linked by correlations above `least`."""
    group = linked_labels(rows @ rows.T > least)
    for number in np.flatnonzero(np.bincount(group) >= size):
        yield group == number
