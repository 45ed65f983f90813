"""Pearson r of selected pairs of sensors, in one pass over all frames."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.large.landmarks.options import loops
from anisomap.large.landmarks.sketch import Sketch
from anisomap.numerics.compiled.parallel import parallel_map
from anisomap.numerics.similarity.search import NO_SENSOR

N_TASKS = 64
"""Number of parallel tasks; more than the usual number of cores, for an even load."""


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
    """List the pairs of sensors and their candidates, each pair once.

    Parameters
    ----------
    found : ndarray of int, shape (n, c)
        See `most_similar`.
    sensors : array_like of int, shape (n,), optional
        Sensor of each row of `found`; 0, 1, ... by default.

    Returns
    -------
    firsts, seconds : ndarray of int, shape (P,)
        With ``firsts < seconds``, in increasing order.
    """
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
    """Compute Pearson r of pairs of sensors.

    Parameters
    ----------
    chunks : iterable of ndarray, shape (t, N)
        The frames from which the sketch was computed.
    sketch : Sketch
        Moments of all frames.
    pairs : tuple of ndarray of int, shape (P,)
        See `pairs_of`.

    Returns
    -------
    SensorPairs
        Readings are standardised in float64, multiplied in float32 and summed in float64 over the
        chunks; the rounding error of r is about 1e-7. r is 0 where a sensor never varies.
    """
    totals = np.zeros(len(pairs[0]))
    scale = np.divide(1, sketch.deviation, out=np.zeros(len(sketch.mean)), where=sketch.varying)
    bounds = np.linspace(0, len(totals), N_TASKS + 1).astype(int).tolist()
    add = loops().add_products
    with parallel_map(len(sketch.mean)) as map_tasks:
        for chunk in chunks:
            still = (chunk == chunk[0]).all(axis=0)
            values = np.ascontiguousarray(chunk.T)
            series = ((values - sketch.mean[:, None]) * scale[:, None]).astype(np.float32)

            def add_task(
                task: int,
                series: NDArray[np.float32] = series,
                still: NDArray[np.bool_] = still,
            ) -> None:
                add(series, still, pairs, totals, (bounds[task], bounds[task + 1]))

            map_tasks(add_task, range(N_TASKS))
    return SensorPairs(*pairs, np.clip(totals / sketch.n_frames, -1, 1))
