"""Sketches of the readings of all sensors, and Pearson r of selected pairs; one pass each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array

from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import parallel_map
from anisomap.numerics.graph.neighbour_graphs import NO_SENSOR

N_TASKS = 64
"""Number of parallel tasks; more than the usual number of cores, for an even load."""


@dataclass(frozen=True)
class ApproximateOptions:
    """Accuracy of an approximate map, and its random seed.

    The defaults were chosen on simulated skins; ``docs/explanation/large-recordings.md``
    gives the accuracy.

    Parameters
    ----------
    n_neighbours : int
        Number of sensors with the highest r that each sensor is linked to, at least 3.
    n_candidates : int
        Number of sensors for which r with each sensor is computed, at least `n_neighbours`.
    sketch_size : int
        Length of the random projection of a sensor's readings, at least 16. The standard error of r
        between two sketches is about ``sketch_size ** -0.5``.
    n_landmarks : int
        Number of sensors from which shortest paths to all others are computed, at least 8. In
        connected components that are not larger, all sensors are landmarks.
    seed : int
        Seed of the projection and of the choice of landmarks, at least 0.

    Raises
    ------
    InputError
        If a value is too small.
    """

    n_neighbours: int = 20
    n_candidates: int = 48
    sketch_size: int = 512
    n_landmarks: int = 1000
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in {
            "n_neighbours": 3,
            "n_candidates": self.n_neighbours,
            "sketch_size": 16,
            "n_landmarks": 8,
            "seed": 0,
        }.items():
            if getattr(self, name) < least:
                raise InputError(f"{name} must be at least {least}, got {getattr(self, name)}")


def loops() -> Any:
    """Import the compiled loops of this package on first use."""
    return import_module("anisomap.large.landmark_kernels")


@dataclass(frozen=True, eq=False)
class Sketch:
    """Summary of T frames of N sensors.

    mean, deviation (N,): Exact moments of the readings; the deviation is that of the population.
    varying: Whether each sensor ever varies.
    contacts: Number of excursions from the first reading, on the side with more of them.
    active_frames: Number of frames on that side, or of all others if these are fewer.
    projections: Sketches: the expected inner product of two rows, over random signs, is r. 0 for
        constant sensors.
    """

    n_frames: int
    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]
    varying: NDArray[np.bool_]
    contacts: NDArray[np.int64]
    active_frames: NDArray[np.int64]
    projections: NDArray[np.float32]


def compute_sketch(chunks: Iterable[NDArray[Any]], size: int, rng: np.random.Generator) -> Sketch:
    """Sketch the standardised readings of every sensor.

    Each frame is added, with a random sign, to one of the s components: the count sketch of
    Charikar, Chen & Farach-Colton (2004), Theoretical Computer Science 312: 3-15. Inner products of
    sketches are unbiased, with a variance of at most ``(1 + r^2) / s`` (Weinberger et al. 2009,
    arXiv:0902.2206).
    """
    found: _RunningSketch | None = None
    # Separate streams, so that the result does not depend on how frames are divided into chunks.
    draw_component, draw_sign = rng.spawn(2)
    for chunk in chunks:
        if found is None:
            found = _RunningSketch(chunk[0], size)
        components = draw_component.integers(size, size=len(chunk))
        found.add(chunk, components, np.where(draw_sign.random(len(chunk)) < 0.5, -1.0, 1.0))
    if found is None:
        raise InputError("the recording has no frames")
    return found.finished()


class _RunningSketch:
    """Sums over the frames so far of readings relative to the first, which is mostly at rest."""

    def __init__(self, first: NDArray[Any], size: int) -> None:
        n_sensors = len(first)
        self.n_frames = 0
        self.first = first.astype(np.float64)
        self.sums, self.squares = np.zeros((2, n_sensors))
        self.varying = np.zeros(n_sensors, dtype=bool)
        # Rows: above and below the first reading.
        self.beyond, self.crossings = np.zeros((2, 2, n_sensors), dtype=np.int64)
        self.was_beyond = np.zeros((2, n_sensors), dtype=bool)
        self.weights = np.zeros(size)  # sketch of a constant reading of 1
        self.projections = np.zeros((size, n_sensors), dtype=np.float32)

    def add(
        self, chunk: NDArray[Any], components: NDArray[np.int64], signs: NDArray[np.float64]
    ) -> None:
        values = chunk - self.first
        self.n_frames += len(chunk)
        self.sums += values.sum(axis=0)
        self.squares += np.einsum("ti,ti->i", values, values)
        self.varying |= values.any(axis=0)
        for side, beyond in enumerate((values > 0, values < 0)):
            self.beyond[side] += np.count_nonzero(beyond, axis=0)
            self.crossings[side] += beyond[0] & ~self.was_beyond[side]
            self.crossings[side] += np.count_nonzero(beyond[1:] & ~beyond[:-1], axis=0)
            self.was_beyond[side] = beyond[-1]
        used, rows = np.unique(components, return_inverse=True)
        projection = csr_array(
            (signs.astype(np.float32), (rows, np.arange(len(chunk)))),
            shape=(len(used), len(chunk)),
        )
        self.projections[used] += projection @ values.astype(np.float32)
        self.weights += np.bincount(components, signs, minlength=len(self.weights))

    def finished(self) -> Sketch:
        shift = self.sums / self.n_frames
        deviation = np.sqrt(np.maximum(self.squares / self.n_frames - shift**2, 0))
        varying = self.varying & (deviation > 0)
        scale = np.divide(
            self.n_frames**-0.5, deviation, out=np.zeros_like(deviation), where=varying
        )
        below = self.crossings[1] > self.crossings[0]
        active = np.where(below, self.beyond[1], self.beyond[0])
        rows = np.ascontiguousarray(self.projections.T)
        rows -= np.outer(shift, self.weights).astype(np.float32)
        rows *= scale[:, None].astype(np.float32)
        return Sketch(
            n_frames=self.n_frames,
            mean=self.first + shift,
            deviation=deviation,
            varying=varying,
            contacts=self.crossings.max(axis=0),
            active_frames=np.minimum(active, self.n_frames - active),
            projections=rows,
        )


class SensorPairs(NamedTuple):
    """Pairs of sensors i < j, each once, in increasing order, and r of each."""

    firsts: NDArray[np.int64]
    seconds: NDArray[np.int64]
    r: NDArray[np.float64]

    def concatenate(self, others: SensorPairs) -> SensorPairs:
        """Append other pairs."""
        return SensorPairs(
            np.concatenate([self.firsts, others.firsts]),
            np.concatenate([self.seconds, others.seconds]),
            np.concatenate([self.r, others.r]),
        )

    def select(self, mask: NDArray[np.bool_]) -> SensorPairs:
        """Return the pairs where a mask is true."""
        return SensorPairs(self.firsts[mask], self.seconds[mask], self.r[mask])


def pairs_of(
    found: NDArray[np.int64], sensors: ArrayLike | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """List the pairs of sensors and their candidates, each pair once."""
    owners = np.arange(len(found)) if sensors is None else np.asarray(sensors, dtype=np.int64)
    pairs = np.stack([np.repeat(owners, found.shape[1]), found.ravel()])
    pairs = np.sort(pairs[:, pairs[1] != NO_SENSOR], axis=0)
    base = int(pairs.max(initial=0)) + 1
    firsts, seconds = np.divmod(np.unique(pairs[0] * base + pairs[1]), base)
    return firsts, seconds


def correlations(
    chunks: Iterable[NDArray[Any]],
    sketch: Sketch,
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> SensorPairs:
    """Compute Pearson r of pairs of sensors."""
    totals = np.zeros(len(pairs[0]))
    scale = np.divide(1, sketch.deviation, out=np.zeros(len(sketch.mean)), where=sketch.varying)
    bounds = np.linspace(0, len(totals), N_TASKS + 1).astype(int).tolist()
    add = loops().add_products
    with parallel_map(len(sketch.mean)) as map_tasks:
        for chunk in chunks:
            still = (chunk == chunk[0]).all(axis=0)
            values = np.ascontiguousarray(chunk.T)
            series = ((values - sketch.mean[:, None]) * scale[:, None]).astype(np.float32)

            map_tasks(partial(add, series, still, pairs, totals), pairwise(bounds))
    return SensorPairs(*pairs, np.clip(totals / sketch.n_frames, -1, 1))
