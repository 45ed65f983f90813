"""What a source of a live session yields: frames, names of sensors, and notices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from threading import Event
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.sensor_map import SensorMap

WAIT_S = 0.1
"""Longest time in seconds for which a source waits before it looks whether it must stop."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Consecutive frames of one width.

    readings (t, N): One row per frame; NaN where a reading is missing.
    times (t,): Seconds of the clock of the source; by default the time of arrival is recorded.
    """

    readings: NDArray[np.float64]
    times: NDArray[np.float64] | None = None


@dataclass(frozen=True)
class Names:
    """Names of the sensors, which a source learns while it runs.

    names: One per sensor.
    """

    names: tuple[str, ...]


@dataclass(frozen=True)
class Notice:
    """An event that users should know of, such as a lost connection.

    text: One sentence.
    """

    text: str


Item: TypeAlias = Batch | Names | Notice


class Source(Protocol):
    """A source of frames.

    A source that loses nothing if it begins later, such as a replay, has an attribute ``can_wait``
    that is true: it begins when the processes that make maps have started.

    description: Origin, for the recording and the page.
    names: Names of the sensors, if they are known before the first frame; else empty.
    truth: True positions of the sensors, if the source knows them.
    """

    description: str
    names: tuple[str, ...]
    truth: SensorMap | None

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over what arrives, until the source ends or `stop` is set."""
        ...
