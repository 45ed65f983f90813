"""Names of sensors that give their channels: ``taxel97``, and ``b0.t3.k11`` of an iCub's port."""

from __future__ import annotations

import re
import string
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_MIN_MATCHED = 0.9  # share of the sensors on either side
_MAX_DIGITS = 9  # longer numbers are serial numbers, not positions on a cable


def trailing_numbers(names: Sequence[str]) -> tuple[int | None, ...]:
    """Return the number at the end of each name, or None: 97 of ``taxel97``."""
    ends = [name[len(name.rstrip(string.digits)) :] for name in names]
    return tuple(int(end) if 0 < len(end) <= _MAX_DIGITS else None for end in ends)


_CHANNEL = re.compile(r"b(\d{1,4})\.t(\d{1,2})\.k(\d{1,2})")
_TRIANGLES, _PADS = 16, 12  # of a board, of a triangle

PADS = np.array(
    [
        (6.533, 0.0), (9.8, -5.66), (3.267, -5.66), (0.0, 0.0), (-3.267, -5.66), (-9.8, -5.66),
        (-6.51, -3.75), (-6.533, 0.0), (-3.267, 5.66), (0.0, 11.317), (0.0, 7.507), (3.267, 5.66),
    ]
)  # fmt: skip
"""Positions of the pads of a triangle, in channel order, in mm from the centre of the triangle."""

PADS.setflags(write=False)
TACTILE = tuple(pad for pad in range(_PADS) if pad not in (6, 10))
"""Pads of a triangle that are tactile sensors; the other two measure temperature."""


def channel_name(index: int) -> str:
    """Return the name of a value of an iCub port: board, triangle and pad (``b0.t3.k11``)."""
    triangle, pad = divmod(index, _PADS)
    return f"b{triangle // _TRIANGLES}.t{triangle % _TRIANGLES}.k{pad}"


def channel_numbers(names: Sequence[str]) -> tuple[int | None, ...]:
    """Return the channels of names of the form of `channel_name`; else trailing numbers."""
    found = [_CHANNEL.fullmatch(name) for name in names]
    parts = [tuple(map(int, match.groups())) for match in found if match]
    if len(parts) < len(names):
        return trailing_numbers(names)
    return tuple((b * _TRIANGLES + t) * _PADS + k for b, t, k in parts)


def channels_of(names: Sequence[str]) -> NDArray[np.intp] | None:
    """Return the `channel_numbers`; None unless all names have one, and these are different."""
    known = [number for number in channel_numbers(names) if number is not None]
    return np.array(known, np.intp) if len(set(known)) == len(names) == len(known) else None


def match_by_number(names: Sequence[str], among: Sequence[str]) -> NDArray[np.intp] | None:
    """Match names of the form of `channel_name` with names numbered from a different start.

    Returns indices in `among`, -1 for missing names; None unless a constant difference of the
    numbers matches nearly all names of both.
    """
    own, others = channels_of(names), channels_of(among)
    if own is None or others is None or not any(map(_CHANNEL.fullmatch, (names[0], among[0]))):
        return None
    starts, counts = np.unique(np.subtract.outer(others, own), return_counts=True)
    best = starts[counts == counts.max()].tolist()
    # All values of a port are numbered as in the names, whether present or not.
    start = 0 if 0 in best else int(best[0])
    enough = counts.max() >= _MIN_MATCHED * min(len(own), len(others))
    if not enough or (start and len(best) > 1):
        return None
    place = {int(number): i for i, number in enumerate(others)}
    return np.array([place.get(int(n) + start, -1) for n in own], dtype=np.intp)
