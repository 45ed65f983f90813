"""The quick map of a live session: r-ANISOMAP from accumulated correlations, warm-started.

It takes milliseconds for tens of sensors and a third of a second for a thousand, so that it can
follow the session. The default method takes ten times as long; it makes the checked map.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from anisomap.drawing.view import MAX_JOINED, neighbour_pairs
from anisomap.errors import AnisomapWarning, InputError
from anisomap.large.chunks import Excerpt
from anisomap.live.coach import Advice, advise
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.similarity.correlation import Moments
from anisomap.numerics.similarity.rest import Rest, estimate_rest
from anisomap.reconstruction import reconstruct_from

QUICK_METHOD = "r-anisomap"
"""The method of the quick map; it needs nothing but Pearson's r."""

MAX_SENSORS = 4000
"""Above this number of sensors there is no map before the end of the session: r-ANISOMAP would take
more than ten seconds."""

SAMPLE_FRAMES = 4096
"""Number of frames from which the rest of the sensors is estimated, spread over the session."""

_SAMPLE_READINGS = 1 << 22  # of many sensors, fewer frames: 16 MiB
_MIN_SAMPLE = 256
_PART_FRAMES = 128  # added at once, so that no frame leaves the sample before it is counted
_REESTIMATED = 1.5  # growth of the number of frames after which the rest is estimated again


class TouchStatistics:
    """Moments of the readings, and numbers of contacts of sensors and of pairs of sensors.

    A missing reading counts as the last one that the sensor sent.

    n_frames: Number of frames so far.
    contacts: Number of separate contacts of each sensor.
    together: Number of separate contacts of both sensors at the same time.
    lowest, highest (N,): Range of the readings; infinite before the first.
    """

    def __init__(self, n_sensors: int) -> None:
        self.n_frames = 0
        self.lowest = np.full(n_sensors, np.inf)
        self.highest = np.full(n_sensors, -np.inf)
        self.contacts = np.zeros(n_sensors, dtype=np.intp)
        self.together = np.zeros((n_sensors, n_sensors), dtype=np.float32)
        self.moments: Moments | None = None
        self._last = np.full(n_sensors, np.nan)
        n_sampled = max(_MIN_SAMPLE, min(SAMPLE_FRAMES, _SAMPLE_READINGS // n_sensors))
        self._sample = Excerpt(n_sampled * n_sensors, segment=1)
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
            self._rest = estimate_rest(self._sample.readings)
        return self._rest

    def add(self, readings: NDArray[np.float64]) -> None:
        """Add frames. readings (t, N)."""
        for at in range(0, len(readings), _PART_FRAMES):
            self._add(self._without_gaps(readings[at : at + _PART_FRAMES]))

    def _add(self, readings: NDArray[np.float64]) -> None:
        np.minimum(self.lowest, readings.min(axis=0), out=self.lowest)
        np.maximum(self.highest, readings.max(axis=0), out=self.highest)
        moments = Moments.of(readings)
        self.moments = moments if self.moments is None else self.moments.merged(moments)
        self._sample.add(readings.astype(np.float32))
        self.n_frames += len(readings)
        if self._rest is not None:
            self._count(readings)
        if self.n_frames >= _REESTIMATED * self._rest_frames:
            self.estimate()

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

    def estimate(self) -> None:
        """Estimate the rest now, and count contacts again if the sample holds all frames."""
        readings = self._sample.readings
        self._rest, self._rest_frames = estimate_rest(readings), self.n_frames
        if self._sample.whole:
            self.contacts[:] = 0
            self.together[:] = 0
            self._was_active[:] = False
            self._count(readings)

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


@dataclass(frozen=True, eq=False)
class QuickMap:
    """A map of the frames so far, and the statistics that belong to it.

    positions (N, k): Centred, with an RMS radius of 1, turned onto the map before; NaN for sensors
        without one.
    n_frames: Number of frames in the map.
    seconds: Time that the map took to compute.
    contacts: Number of separate contacts of each sensor.
    pairs: Neighbours, which the page joins by lines.
    advice: Where to touch next.
    highest_depth (N,): Largest excess over rest so far.
    names: Names of the sensors.
    left_out: Sensors that were dropped, and channels that are no sensors.
    reason: Why there is no map; empty if there is one.
    """

    positions: NDArray[np.float64]
    n_frames: int
    seconds: float
    contacts: NDArray[np.intp]
    pairs: NDArray[np.intp]
    advice: Advice
    rest: Rest
    highest_depth: NDArray[np.float64]
    names: tuple[str, ...]
    left_out: tuple[int, ...]
    reason: str = ""


@dataclass
class QuickMapper:
    """Makes one map after another, each from the one before.

    dimensions: Number of coordinates; may change between maps.
    drop: Sensors to leave out.
    """

    names: Sequence[str]
    dimensions: int
    drop: set[int] = field(default_factory=set)
    _before: NDArray[np.float64] | None = None

    def make(self, statistics: TouchStatistics) -> QuickMap:
        """Make a map of all frames so far, of which there must be at least one."""
        begun = time.monotonic()
        rest, reason = statistics.rest, ""
        positions = np.full((statistics.n_sensors, self.dimensions), np.nan)
        if statistics.n_sensors > MAX_SENSORS:
            reason = f"a map of more than {MAX_SENSORS} sensors is made at the end of the session"
        elif statistics.moments is not None:
            try:
                positions = self._positions(statistics.moments)
            except InputError as error:
                reason = str(error)
        side_of_contact = np.where(rest.side > 0, statistics.highest, statistics.lowest)
        return QuickMap(
            positions=positions,
            n_frames=statistics.n_frames,
            seconds=time.monotonic() - begun,
            contacts=statistics.contacts.copy(),
            pairs=neighbour_lines(positions),
            advice=advise(
                positions, statistics.contacts, statistics.together, self.names, self.drop
            ),
            rest=rest,
            highest_depth=rest.depth(side_of_contact[None])[0],
            names=tuple(self.names),
            left_out=tuple(sorted(self.drop)),
            reason=reason,
        )

    def _positions(self, moments: Moments) -> NDArray[np.float64]:
        correlation, before = moments.correlation(), self._before
        if before is not None and before.shape[1] != self.dimensions:
            before = None  # the number of dimensions has changed
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AnisomapWarning)
            made = reconstruct_from(
                similarity=correlation,
                method=QUICK_METHOD,
                dimensions=self.dimensions,
                names=self.names,
                drop=sorted(self.drop | set(np.flatnonzero(~moments.varying()).tolist())),
                start=None if before is None else warm_start(before, correlation),
                statistic="pearson",
            )
        self._before = turned_onto(made.positions, before)
        return self._before


def neighbour_lines(positions: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return pairs of neighbours to join by lines; none above `MAX_JOINED` sensors."""
    placed = np.flatnonzero(np.isfinite(positions).all(axis=1))
    if not 2 < placed.size <= MAX_JOINED:
        return np.empty((0, 2), dtype=np.intp)
    return np.asarray(placed[neighbour_pairs(positions[placed])])


def warm_start(
    before: NDArray[np.float64], similarity: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Return a start for the scaling: known positions, and guesses for the other sensors.

    before (N, k), similarity (N, N) -> (N, k).
    """
    start = before.copy()
    placed = np.isfinite(before).all(axis=1)
    fresh = np.flatnonzero(~placed)
    if fresh.size:
        best = np.flatnonzero(placed)[np.argmax(similarity[np.ix_(fresh, placed)], axis=1)]
        # Coincident points have no direction in which to part; the offsets are below a spacing.
        offsets = np.random.default_rng(0).normal(0, 1e-2, (fresh.size, before.shape[1]))
        start[fresh] = before[best] + offsets
    return start


def turned_onto(
    positions: NDArray[np.float64], before: NDArray[np.float64] | None
) -> NDArray[np.float64]:
    """Turn a map onto the map before, with the handedness of that map.

    positions (N, k), before (N, k) -> (N, k).
    """
    placed = np.isfinite(positions).all(axis=1)
    centred = positions - positions[placed].mean(axis=0)
    radius = np.sqrt(np.mean(np.sum(centred[placed] ** 2, axis=1)))
    centred /= radius if radius > 0 else 1.0
    if before is None:
        axes = np.linalg.svd(centred[placed], full_matrices=False)[2]
        return np.asarray(centred @ axes.T)
    shared = placed & np.isfinite(before).all(axis=1)
    if np.count_nonzero(shared) <= positions.shape[1]:
        return np.asarray(centred)
    fit = fit_similarity(centred[shared], before[shared], scaling=False)
    return np.asarray(centred @ fit.rotation.T)
