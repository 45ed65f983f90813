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
from anisomap.live.maps.coach import Advice, advise
from anisomap.live.maps.statistics import TouchStatistics
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.similarity.rest import Rest
from anisomap.reconstruction import reconstruct_from

QUICK_METHOD = "r-anisomap"
"""The method of the quick map; it needs nothing but Pearson's r."""

MAX_SENSORS = 4000
"""Above this number of sensors there is no map before the end of the session: r-ANISOMAP would take
more than ten seconds."""


@dataclass(frozen=True, eq=False)
class QuickMap:
    """A map of the frames so far, and the statistics that belong to it.

    Attributes
    ----------
    positions : ndarray of shape (N, k)
        Centred, with an RMS radius of 1, turned onto the map before; NaN for sensors without one.
    n_frames : int
        Number of frames in the map.
    seconds : float
        Time that the map took to compute.
    contacts : ndarray of int, shape (N,)
        Number of separate contacts of each sensor.
    pairs : ndarray of int, shape (P, 2)
        Neighbours, which the page joins by lines.
    advice : Advice
        Where to touch next.
    rest : Rest
    highest_depth : ndarray of shape (N,)
        Largest excess over rest so far.
    names : tuple of str
        Names of the sensors.
    left_out : tuple of int
        Sensors that were dropped, and channels that are no sensors.
    reason : str
        Why there is no map; empty if there is one.
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

    Parameters
    ----------
    names : sequence of str
    dimensions : int
        Number of coordinates; may change between maps.
    drop : set of int
        Sensors to leave out.
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
        else:
            try:
                positions = self._positions(statistics)
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

    def _positions(self, statistics: TouchStatistics) -> NDArray[np.float64]:
        moments = statistics.moments()
        correlation = moments.correlation()
        varying = moments.varying()
        left_out = sorted(self.drop | set(np.flatnonzero(~varying).tolist()))
        start = None
        if self._before is not None and self._before.shape[1] != self.dimensions:
            self._before = None  # the number of dimensions has changed
        if self._before is not None:
            start = warm_start(self._before, correlation)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", AnisomapWarning)
            made = reconstruct_from(
                similarity=correlation,
                method=QUICK_METHOD,
                dimensions=self.dimensions,
                names=self.names,
                drop=left_out,
                start=start,
                statistic="pearson",
            )
        self._before = turned_onto(made.positions, self._before)
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

    Parameters
    ----------
    before : ndarray of shape (N, k)
        Positions of the last map; NaN for sensors without one.
    similarity : ndarray of shape (N, N)

    Returns
    -------
    ndarray of shape (N, k)
        A sensor without a position starts beside the most similar sensor that has one.
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

    Parameters
    ----------
    positions : ndarray of shape (N, k)
        NaN for sensors without a position.
    before : ndarray of shape (N, k), optional
        By default the map is turned to its principal axes, the longest first.

    Returns
    -------
    ndarray of shape (N, k)
        Centred, with an RMS radius of 1.
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
