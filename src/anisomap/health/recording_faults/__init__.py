"""Faults of the read-out that concern several sensors, and courses that no map can be made of.

Each module finds one fault in a complete recording, or a few alike, says what was found, and mends
it where possible. Faults are searched in an excerpt of some thousand frames and some hundred
sensors; see `anisomap.numerics.signals`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from anisomap.recording import Recording


@dataclass(frozen=True, eq=False)
class Found:
    """One fault of a recording.

    sensors: Their indices.
    size, what: See `anisomap.health.Finding`.
    mend: Mends the fault in the recording; None if it cannot be mended.
    height: With which `what` ends, in units of the readings; none by default.
    mended: What `mend` does, if it differs from what the check says.
    kind: If it differs from the key of the check.
    """

    sensors: NDArray[np.intp] | Sequence[int]
    size: float
    what: str
    mend: Callable[[Recording], Recording] | None = None
    height: float | None = None
    mended: str = ""
    kind: str = ""


def in_readings(
    change: Callable[[NDArray[Any]], NDArray[Any]],
) -> Callable[[Recording], Recording]:
    """Return a repair that changes the readings alone, shape (T, N)."""
    return lambda recording: replace(recording, readings=change(recording.readings))


def linked_groups(
    rows: NDArray[np.float32], least: float, size: int
) -> Iterator[NDArray[np.bool_]]:
    """Mark each group of `size` rows or more, of norm 1, that correlations above `least` link."""
    _, group = connected_components(rows @ rows.T > least, directed=False)
    for number in np.flatnonzero(np.bincount(group) >= size):
        yield group == number
