"""What happened in a session so far: notices, verdicts, and when frames arrived."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

MAX_CURVE = 500
"""Points of a curve over time; when there are more, every other one is left out."""

_STEP_S = 0.02  # between two entries of the arrivals
_RATE_S, _RATE_ENTRIES = 3.0, 200  # over which the rate is measured


_Point = TypeVar("_Point")


def thinned(curve: Sequence[_Point]) -> list[_Point]:
    """Return the points of a curve, every other one if there are `MAX_CURVE` or more."""
    return list(curve[::2] if len(curve) >= MAX_CURVE else curve)


@dataclass(frozen=True)
class Note:
    """A sentence for the user.

    Attributes
    ----------
    seconds : float
        Time since the start of the session.
    text : str
    """

    seconds: float
    text: str


@dataclass(frozen=True)
class Point:
    """A point of the curves over time.

    Attributes
    ----------
    seconds : float
        Time since the start of the session.
    n_frames : int
    expected_error, error_against_truth : float
        In spacings; NaN if unknown.
    level : str
    """

    seconds: float
    n_frames: int
    expected_error: float
    error_against_truth: float
    level: str


@dataclass
class Arrivals:
    """When frames arrived, to tell the age of a map from its number of frames."""

    counts: deque[tuple[int, float]] = field(default_factory=lambda: deque(maxlen=20_000))

    def add(self, n_frames: int, now: float) -> None:
        """Note that there are `n_frames` frames at a time."""
        if not self.counts or now - self.counts[-1][1] >= _STEP_S:
            self.counts.append((n_frames, now))
        else:
            self.counts[-1] = (n_frames, self.counts[-1][1])

    def rate(self, now: float) -> float:
        """Return the number of frames per second in the last seconds."""
        recent = [entry for entry in list(self.counts)[-_RATE_ENTRIES:] if now - entry[1] < _RATE_S]
        if len(recent) < 2 or recent[-1][1] <= recent[0][1]:
            return 0.0
        return (recent[-1][0] - recent[0][0]) / (recent[-1][1] - recent[0][1])

    def time_of(self, n_frames: int) -> float | None:
        """Return when the first frame arrived that is not among the first `n_frames`."""
        for count, moment in list(self.counts):
            if count > n_frames:
                return moment
        return None
