"""Statistics of a skin that are accumulated while it is touched, in memory of constant size."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.similarity.accumulators import Moments
from anisomap.numerics.similarity.rest import Rest, estimate_rest

SAMPLE_FRAMES = 4096
"""Number of frames from which the rest of the sensors is estimated, spread over the session."""

_SAMPLE_READINGS = 1 << 22  # of many sensors, fewer frames: 16 MiB
_MIN_SAMPLE = 256
_PART_FRAMES = 128  # added at once, so that no frame leaves the sample before it is counted
_REESTIMATED = 1.5  # growth of the number of frames after which the rest is estimated again


class TouchStatistics:
    """Moments of the readings, and numbers of contacts of sensors and of pairs of sensors.

    A missing reading counts as the last one that the sensor sent.

    Parameters
    ----------
    n_sensors : int

    Attributes
    ----------
    n_frames : int
        Number of frames so far.
    contacts : ndarray of int, shape (N,)
        Number of separate contacts of each sensor.
    together : ndarray of float32, shape (N, N)
        Number of separate contacts of both sensors at the same time.
    lowest, highest : ndarray of shape (N,)
        Range of the readings; infinite before the first.
    """

    def __init__(self, n_sensors: int) -> None:
        self.n_frames = 0
        self.lowest = np.full(n_sensors, np.inf)
        self.highest = np.full(n_sensors, -np.inf)
        self.contacts = np.zeros(n_sensors, dtype=np.intp)
        self.together = np.zeros((n_sensors, n_sensors), dtype=np.float32)
        self._origin = np.zeros(n_sensors)
        self._last = np.full(n_sensors, np.nan)
        self._sum = np.zeros(n_sensors)
        self._products = np.zeros((n_sensors, n_sensors))
        max_sample = max(_MIN_SAMPLE, min(SAMPLE_FRAMES, _SAMPLE_READINGS // n_sensors))
        self._sampled = np.empty((max_sample, n_sensors), dtype=np.float32)
        self._n_sampled = 0
        self._stride = 1
        self._rest: Rest | None = None
        self._rest_frames = 0
        self._was_active = np.zeros(n_sensors, dtype=bool)

    @property
    def n_sensors(self) -> int:
        """Number of sensors, N."""
        return len(self.contacts)

    @property
    def rest(self) -> Rest:
        """Rest of the sensors, estimated from a sample of all frames so far.

        It is estimated anew when the number of frames has grown by half, and all contacts are then
        counted again while the sample holds all frames.
        """
        if self._rest is None:
            self._rest = estimate_rest(self._sample)
        return self._rest

    def add(self, readings: NDArray[np.float64]) -> None:
        """Add frames.

        Parameters
        ----------
        readings : ndarray of shape (t, N)
        """
        for at in range(0, len(readings), _PART_FRAMES):
            self._add(self._without_gaps(readings[at : at + _PART_FRAMES]))

    def _add(self, readings: NDArray[np.float64]) -> None:
        if not self.n_frames:
            self._origin = readings[0].copy()
        np.minimum(self.lowest, readings.min(axis=0), out=self.lowest)
        np.maximum(self.highest, readings.max(axis=0), out=self.highest)
        # Products about a reading at rest: sums about zero would lose small deviations.
        deviations = readings - self._origin
        self._sum += deviations.sum(axis=0)
        self._products += deviations.T @ deviations
        self._keep_sample(readings)
        self.n_frames += len(readings)
        if self._rest is not None:
            self._count(readings)
        if self.n_frames >= _REESTIMATED * self._rest_frames:
            self.estimate()

    def moments(self) -> Moments:
        """Return the moments of all frames so far, at least one."""
        mean = self._sum / self.n_frames
        comoment = self._products - np.outer(mean, self._sum)
        constant = self.highest <= self.lowest
        comoment[constant] = 0
        comoment[:, constant] = 0
        diagonal = np.diag(comoment).copy()
        np.fill_diagonal(comoment, np.maximum(diagonal, 0))
        return Moments(self.n_frames, self._origin + mean, comoment)

    def _without_gaps(self, readings: NDArray[np.float64]) -> NDArray[np.float64]:
        known = np.isfinite(readings)
        if not known.all() or not np.isfinite(self._last).all():
            with_last = np.vstack([np.nan_to_num(self._last, nan=0.0), readings])
            known = np.vstack([np.ones(self.n_sensors, dtype=bool), known])
            if not self.n_frames:  # a sensor whose first readings are missing starts with its first
                first = np.argmax(known[1:], axis=0)
                start = readings[first, np.arange(self.n_sensors)]
                with_last[0] = np.nan_to_num(start, nan=0.0, posinf=0.0, neginf=0.0)
            source = np.where(known, np.arange(len(known))[:, None], 0)
            np.maximum.accumulate(source, axis=0, out=source)
            readings = np.take_along_axis(with_last, source, axis=0)[1:]
        self._last = readings[-1]
        return readings

    @property
    def _sample(self) -> NDArray[np.float32]:
        """Every `_stride`-th frame so far."""
        return self._sampled[: self._n_sampled]

    def _keep_sample(self, readings: NDArray[np.float64]) -> None:
        for i in range(-self.n_frames % self._stride, len(readings), self._stride):
            if self._n_sampled == len(self._sampled):
                self._n_sampled = (self._n_sampled + 1) // 2
                self._sampled[: self._n_sampled] = self._sampled[::2].copy()
                self._stride *= 2
            if (self.n_frames + i) % self._stride == 0:
                self._sampled[self._n_sampled] = readings[i]
                self._n_sampled += 1

    def estimate(self) -> None:
        """Estimate the rest now, and count contacts again if the sample holds all frames."""
        self._rest, self._rest_frames = estimate_rest(self._sample), self.n_frames
        if self._stride == 1:
            self.contacts[:] = 0
            self.together[:] = 0
            self._was_active[:] = False
            self._count(self._sample)

    def _count(self, readings: NDArray[np.generic]) -> None:
        active = self.rest.active(readings)
        lasting = active & np.vstack([self._was_active, active[:-1]])
        self.contacts += np.count_nonzero(active & ~lasting, axis=0)
        self._was_active = active[-1].copy()
        # A contact of two sensors begins in frames in which both are active, less those in which
        # both were so before.
        for frames, sign in ((active, 1), (lasting, -1)):
            some = frames[frames.any(axis=1)].astype(np.float32)
            if len(some):
                self.together += sign * (some.T @ some)
