"""Axes of arrays, of which one is time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

XYZ = "xyz"
MIN_TAXELS = 4
"""Taxels with three axes that there must be at least."""


@dataclass(frozen=True)
class Frames:
    """How an array holds frames.

    time: Its axis of time, the first or the last.
    shape: Shape of a frame.
    names: Of the readings of a frame, in order; empty if a frame is a list.
    """

    time: int
    shape: tuple[int, ...]
    names: tuple[str, ...]

    @property
    def n_sensors(self) -> int:
        """Number of readings in a frame."""
        return math.prod(self.shape)

    @property
    def said(self) -> str:
        """What to say about an array of more than two axes."""
        size = " x ".join(map(str, self.shape))
        return f"the {'first' if self.time == 0 else 'last'} axis is time, and a frame is {size}"


def frames_of(shape: Sequence[int]) -> Frames | None:
    """Return how an array of some shape holds frames: the longest axis is time; None if unclear.

    Arrays of two axes are frames x sensors. Frames of rows and columns have cells named by both; a
    last axis of 3 is x, y and z.
    """
    if len(shape) == 2:
        return Frames(0, (shape[1],), ())
    if len(shape) < 2 or not min(shape) or max(shape) not in (shape[0], shape[-1]):
        return None
    time = 0 if shape[0] == max(shape) else len(shape) - 1
    frame = tuple(shape[1:] if time == 0 else shape[:-1])
    return Frames(time, frame, names_of_frame(frame))


def names_of_frame(shape: Sequence[int]) -> tuple[str, ...]:
    """Name the readings of a frame by their indices: ``r2c0``, or ``2.0.1`` of more axes."""
    *cells, last = shape
    if last == len(XYZ) and math.prod(cells) >= MIN_TAXELS:
        inner = names_of_frame(cells) or tuple(f"taxel{i}" for i in range(cells[0]))
        return tuple(f"{name}_{axis}" for name in inner for axis in XYZ)
    if len(shape) < 2:
        return ()
    if len(shape) == 2:
        return tuple(f"r{row}c{column}" for row in range(shape[0]) for column in range(shape[1]))
    inner = names_of_frame(shape[1:])
    return tuple(f"{i}.{name}" for i in range(shape[0]) for name in inner)
