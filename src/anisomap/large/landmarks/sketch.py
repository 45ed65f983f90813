"""Random projections and moments of the readings of each sensor, in one pass over all frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from anisomap.errors import InputError


@dataclass(frozen=True, eq=False)
class Sketch:
    """Summary of T frames of N sensors.

    Attributes
    ----------
    n_frames : int
    mean, deviation : ndarray of shape (N,)
        Exact moments of the readings; the deviation is that of the population.
    varying : ndarray of bool, shape (N,)
        Whether each sensor ever varies.
    contacts : ndarray of int, shape (N,)
        Number of excursions from the first reading, on the side with more of them.
    active_frames : ndarray of int, shape (N,)
        Number of frames on that side, or of all others if these are fewer.
    projections : ndarray of float32, shape (N, s)
        Sketches: the expected inner product of two rows, over random signs, is r. 0 for constant
        sensors.
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

    Parameters
    ----------
    chunks : iterable of ndarray, shape (t, N)
        Finite readings in temporal order.
    size : int
        Length s of a sketch.
    rng : numpy.random.Generator
        Generator of a component and a sign for every frame.

    Returns
    -------
    Sketch

    Raises
    ------
    InputError
        If there are no frames.

    Notes
    -----
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
