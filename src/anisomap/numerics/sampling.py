"""An even sample of a recording of unknown length, in bounded memory."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

_GROWTH = 0.25  # of the memory, when it is full
_ROWS_AT_ONCE = 4096  # moved forward together


class EvenSample:
    """Every k-th frame of the frames added; k doubles when the sample exceeds its limit.

    The memory grows in place, so adding frames never requires twice the memory.

    n_frames: Number of frames added.
    every: k, a power of 2.
    """

    def __init__(self, max_readings: float = math.inf) -> None:
        self._max_readings = max_readings
        self._rows: NDArray[Any] = np.empty((0, 0), np.float32)
        self._n_rows = 0
        self.n_frames, self.every = 0, 1

    @property
    def next_kept(self) -> slice:
        """Slice of the next frames to keep, unless k doubles."""
        return slice(-self.n_frames % self.every, None, self.every)

    def add(self, frames: NDArray[Any]) -> None:
        """Add the next frames, shape (t, N)."""
        kept = frames[self.next_kept]
        self.n_frames += len(frames)
        needed = self._n_rows + len(kept)
        if not self._rows.shape[1]:
            self._rows = np.empty((0, frames.shape[1]), np.float32)
        if not np.can_cast(kept.dtype, self._rows.dtype):
            self._rows = self._rows.astype(np.float64, copy=False)
        if needed > len(self._rows):
            self._resize(max(needed, int(len(self._rows) * (1 + _GROWTH))))
        self._rows[self._n_rows : needed] = kept
        self._n_rows = needed
        while self._n_rows > 1 and self._n_rows * frames.shape[1] > self._max_readings:
            self._halve()

    @property
    def readings(self) -> NDArray[Any]:
        """A copy of the frames that are held, shape (n, N)."""
        return self._rows[: self._n_rows].copy()

    def take(self) -> NDArray[Any]:
        """Return the frames held, shape (n, N), without a copy; no frame may be added later."""
        self._resize(self._n_rows)
        self._rows.setflags(write=False)
        return self._rows

    def _halve(self) -> None:
        self.every *= 2
        n_kept = (self._n_rows + 1) // 2
        for begin in range(0, n_kept, _ROWS_AT_ONCE):
            end = min(begin + _ROWS_AT_ONCE, n_kept)
            self._rows[begin:end] = self._rows[2 * begin : 2 * end : 2]
        self._n_rows = n_kept

    def _resize(self, n_rows: int) -> None:
        # realloc moves pages instead of copying; no other reference to the array exists yet.
        self._rows.resize((n_rows, self._rows.shape[1]), refcheck=False)


MAX_FRAMES = 16384
"""Maximum number of frames in a sample of a growing recording."""

_MAX_READINGS, _MIN_FRAMES = 1 << 23, 256  # limit of 32 MiB: fewer frames of many sensors


def sample_of(n_sensors: int) -> EvenSample:
    """Return an empty sample of the frames of a recording that grows."""
    n_frames = max(_MIN_FRAMES, min(MAX_FRAMES, _MAX_READINGS // n_sensors))
    return EvenSample(n_frames * n_sensors)
