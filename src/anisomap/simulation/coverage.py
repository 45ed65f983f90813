"""Coverage of the sensors by a stimulation, as a function of its length.

To plan a recording, simulate a similar body and stimulation, and find the length at which coverage
and map quality level off.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.base.immutable import Immutable
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation.scoring import score
from anisomap.health.touch_coverage import NEIGHBOUR_RADIUS
from anisomap.method.named import find_method
from anisomap.method.reconstruction import reconstruct
from anisomap.numerics.ranges import COUNT
from anisomap.numerics.signals import count_contacts, count_joint_contacts
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.recording import Recording
from anisomap.simulation.body import Body
from anisomap.simulation.scenarios import simulate_runs

LENGTHS = (62, 125, 250, 500, 1000, 2000)
"""Default lengths in frames, up to that of the paper's runs."""

QUANTILES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Quantiles of the contact counts over the sensors: minimum, quartiles and maximum."""


@dataclass(frozen=True, eq=False)
class CoverageCurve(Immutable):
    """Coverage by recording length, for L lengths and S seeds.

    Attributes
    ----------
    n_frames : ndarray of int, shape (L,)
        Lengths, increasing.
    rate_hz : float
        Frames per second.
    touched : ndarray of shape (L, S)
        Share of the sensors that were touched at least once.
    contacts : ndarray of shape (L, S, 5)
        Number of separate contacts of a sensor: `QUANTILES` over the sensors.
    n_pairs : int
        Number of neighbouring pairs of sensors, see `neighbouring_pairs`.
    pairs : ndarray of int, shape (L, S)
        Number of neighbouring pairs that were touched in the same frame at least once. For the
        others, the recording holds no direct evidence of their distance.
    mantel_r : ndarray of shape (L, S)
        Mantel r of the reconstructed maps, over the sensors that a map places. NaN without a map.
    """

    n_frames: NDArray[np.intp]
    rate_hz: float
    touched: NDArray[np.float64]
    contacts: NDArray[np.float64]
    n_pairs: int
    pairs: NDArray[np.intp]
    mantel_r: NDArray[np.float64]

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Lengths in seconds, shape (L,)."""
        return np.asarray(self.n_frames / self.rate_hz)


def coverage_curve(
    body: str | Body = "sphere",
    scenario: str = "rubbing",
    n_frames: Sequence[int] = LENGTHS,
    seeds: Iterable[int] = (1, 2, 3),
    *,
    method: str | None = DEFAULT_METHOD,
    dimensions: int = 3,
    workers: int | None = 1,
    **parameters: Any,
) -> CoverageCurve:
    """Simulate recordings and measure coverage at several lengths.

    Parameters
    ----------
    body, scenario
        See `simulate`.
    n_frames : sequence of int
        Lengths. The longest recording is simulated once per seed and truncated to the others.
    seeds : iterable of int
    method : str, optional
        Method of the maps; None for no maps.
    dimensions : int
        Dimensions of the maps.
    workers : int, optional
        Number of processes, see `simulate_runs`.
    **parameters
        Options of the scenario.

    Returns
    -------
    CoverageCurve

    Raises
    ------
    InputError
        If there are no lengths or no seeds, or as `simulate` does.
    """
    for n in n_frames:
        COUNT.check("n_frames", n)
    lengths = np.unique(np.array(n_frames, dtype=np.intp))
    chosen = list(seeds)
    if not (lengths.size and chosen):
        raise InputError("a coverage curve needs at least one length and one seed")
    if method is not None:
        find_method(method)
    recordings = simulate_runs(
        body, scenario, chosen, workers=workers, n_frames=int(lengths[-1]), **parameters
    )
    neighbours = neighbouring_pairs(recordings[0])
    shape = len(lengths), len(recordings)
    touched, mantel_r, pairs = np.empty(shape), np.empty(shape), np.empty(shape, dtype=np.intp)
    contacts = np.empty((*shape, len(QUANTILES)))
    for j, run in enumerate(recordings):
        whole = estimate_rest(run.readings).active(run.readings)
        for i, n in enumerate(lengths):
            active = whole[:n]
            touched[i, j] = active.any(axis=0).mean()
            contacts[i, j] = np.quantile(count_contacts(active), QUANTILES)
            pairs[i, j] = np.count_nonzero(count_joint_contacts(active, neighbours))
            mantel_r[i, j] = _mantel_r(run, n, method, dimensions)
    rate_hz = recordings[0].rate_hz or 1.0
    return CoverageCurve(lengths, rate_hz, touched, contacts, len(neighbours), pairs, mantel_r)


def neighbouring_pairs(recording: Recording) -> NDArray[np.intp]:
    """List the pairs of sensors that are neighbours on the skin."""
    distances = recording.surface_distances
    if distances is None:
        if recording.positions is None:
            raise InputError("neighbouring pairs need a recording with true positions")
        distances = np.linalg.norm(recording.positions[:, None] - recording.positions, axis=2)
    others = distances + np.diag(np.full(len(distances), np.inf))
    nearest = others.min(axis=1)
    within = others <= NEIGHBOUR_RADIUS * np.maximum(nearest[:, None], nearest)
    return np.argwhere(np.triu(within & np.isfinite(others), k=1))


def _mantel_r(recording: Recording, n_frames: int, method: str | None, dimensions: int) -> float:
    """Score the map of the first frames of a recording; NaN without a map."""
    if method is None or recording.positions is None:
        return float("nan")
    beginning = replace(recording, readings=recording.readings[:n_frames])
    with warnings.catch_warnings(), suppress(InputError):
        # Short recordings give warnings about what the curve measures.
        warnings.simplefilter("ignore", AnisomapWarning)
        found = reconstruct(beginning, method, dimensions)
        return score(found, recording.positions, permutations=0).mantel.r
    return float("nan")
