"""A second pass over all frames: Pearson r of some pairs of sensors, exactly."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.large.landmarks.options import loops
from anisomap.large.landmarks.sketch import Sketch
from anisomap.numerics.compiled.parallel import parallel_map
from anisomap.numerics.similarity.search import NO_SENSOR

PIECES = 64
"""Pieces that the pairs are shared out to."""


class SensorPairs(NamedTuple):
    """Pairs of sensors i < j, each once, in increasing order; and r of each."""

    firsts: NDArray[np.int64]
    seconds: NDArray[np.int64]
    r: NDArray[np.float64]

    def concatenate(self, others: SensorPairs) -> SensorPairs:
        """Put pairs and other pairs together."""
        return SensorPairs(
            np.concatenate([self.firsts, others.firsts]),
            np.concatenate([self.seconds, others.seconds]),
            np.concatenate([self.r, others.r]),
        )

    def select(self, which: NDArray[np.bool_]) -> SensorPairs:
        """Keep some pairs only."""
        return SensorPairs(self.firsts[which], self.seconds[which], self.r[which])


def pairs_of(
    found: NDArray[np.int64], sensors: ArrayLike | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """List the pairs of sensors with those found for them, each pair once.

    Parameters
    ----------
    found : ndarray of int, shape (n, c)
        See `most_similar`.
    sensors : array_like of int, shape (n,), optional
        For whom they were found; for sensors 0, 1, ... unless given.

    Returns
    -------
    firsts, seconds : ndarray of int, shape (P,)
        With ``firsts < seconds``, in increasing order.
    """
    whom = np.arange(len(found)) if sensors is None else np.asarray(sensors, dtype=np.int64)
    pairs = np.stack([np.repeat(whom, found.shape[1]), found.ravel()])
    pairs = np.sort(pairs[:, pairs[1] != NO_SENSOR], axis=0)
    base = int(pairs.max(initial=0)) + 1
    firsts, seconds = np.divmod(np.unique(pairs[0] * base + pairs[1]), base)
    return firsts, seconds


def correlations(
    chunks: Iterable[NDArray[Any]],
    known: Sketch,
    pairs: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> SensorPairs:
    """Work out Pearson r of some pairs of sensors.

    Parameters
    ----------
    chunks : iterable of ndarray, shape (t, N)
        The frames that were sketched.
    known : Sketch
        Moments of all frames.
    pairs : tuple of ndarray of int, shape (P,)
        See `pairs_of`.

    Returns
    -------
    SensorPairs
        Products are of float32 readings that were standardised in float64, summed in float64 over
        the chunks: r errs by some 1e-7. It is 0 where a sensor never varies.
    """
    totals = np.zeros(len(pairs[0]))
    scale = np.divide(1, known.deviation, out=np.zeros(len(known.mean)), where=known.varying)
    parts = np.linspace(0, len(totals), PIECES + 1).astype(int).tolist()
    add = loops().add_products
    with parallel_map(len(known.mean)) as spread_over:
        for chunk in chunks:
            still = (chunk == chunk[0]).all(axis=0)
            values = np.ascontiguousarray(chunk.T)
            series = ((values - known.mean[:, None]) * scale[:, None]).astype(np.float32)

            def take(
                piece: int,
                series: NDArray[np.float32] = series,
                still: NDArray[np.bool_] = still,
            ) -> None:
                add(series, still, pairs, totals, (parts[piece], parts[piece + 1]))

            spread_over(take, range(PIECES))
    return SensorPairs(*pairs, np.clip(totals / known.n_frames, -1, 1))
