"""How dense and how long a stimulation must be: what a recording covers as it grows.

For whoever is about to record in a laboratory: simulate a body like theirs and a stimulation like
theirs, and see when more of it stops helping.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation.scoring import score
from anisomap.methods import DEFAULT_METHOD, find_method
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.reconstruction import reconstruct
from anisomap.recording import Recording
from anisomap.simulation.bodies import Body
from anisomap.simulation.checks import check_count
from anisomap.simulation.scenarios import simulate_runs

LENGTHS = (62, 125, 250, 500, 1000, 2000)
"""Frames: up to as many as the paper's runs have."""

QUANTILES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Which quantiles over the sensors a curve tells of contacts: least, quartiles and most."""

_NEIGHBOURLY = 1.5  # x distance to the nearest: on a square lattice, diagonals are neighbours, too


@dataclass(frozen=True, eq=False)
class CoverageCurve:
    """What recordings cover, by their length; L lengths, S seeds.

    Attributes
    ----------
    n_frames : ndarray of int, shape (L,)
        Lengths, rising.
    rate_hz : float
        Frames a second.
    touched : ndarray of shape (L, S)
        Share of the sensors that were touched at all.
    contacts : ndarray of shape (L, S, 5)
        How often a sensor was touched anew; its `QUANTILES` over the sensors.
    n_pairs : int
        How many pairs of sensors are neighbours: no further apart along the skin than 1.5 times
        the distance from one of them to its nearest.
    pairs : ndarray of int, shape (L, S)
        How many of those were touched in the same frame at least once. Where they were not, their
        distance is anyone's guess.
    mantel_r : ndarray of shape (L, S)
        Of maps made from it, over those sensors that a map places. NaN where there is no map.
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
    """Simulate recordings, and tell what their beginnings cover.

    Parameters
    ----------
    body, scenario
        See `simulate`.
    n_frames : sequence of int
        Lengths. The longest is simulated, and stopped earlier for the others.
    seeds : iterable of int
    method : str, optional
        By which maps are made, in `dimensions`; with None, there are none.
    dimensions : int
    workers : int, optional
        Processes that simulate, see `simulate_runs`.
    **parameters
        Of the scenario, such as how dense the stimulation is.

    Returns
    -------
    CoverageCurve

    Raises
    ------
    InputError
        If there are no lengths or no seeds, or as `simulate` does.
    """
    for n in n_frames:
        check_count("n_frames", n)
    lengths = np.unique(np.array(n_frames, dtype=np.intp))
    chosen = list(seeds)
    if not (lengths.size and chosen):
        raise InputError("a coverage curve takes at least one length and one seed")
    if method is not None:
        find_method(method)
    recordings = simulate_runs(
        body, scenario, chosen, workers=workers, n_frames=int(lengths[-1]), **parameters
    )
    first = recordings[0]
    neighbours = neighbouring_pairs(first)
    touched = [estimate_rest(run.readings).active(run.readings) for run in recordings]
    cells = [(n, run, on[:n]) for n in lengths for run, on in zip(recordings, touched, strict=True)]
    shape = (len(lengths), len(chosen))
    return CoverageCurve(
        n_frames=_frozen(lengths),
        rate_hz=first.rate_hz or 1.0,
        touched=_frozen([on.any(axis=0).mean() for _, _, on in cells], shape),
        contacts=_frozen(
            [np.quantile(_contacts(on), QUANTILES) for _, _, on in cells], (*shape, -1)
        ),
        n_pairs=len(neighbours),
        pairs=_frozen([_together(on, neighbours) for _, _, on in cells], shape),
        mantel_r=_frozen([_mantel_r(run, n, method, dimensions) for n, run, _ in cells], shape),
    )


def neighbouring_pairs(recording: Recording) -> NDArray[np.intp]:
    """List the pairs of sensors that are neighbours on the skin.

    Parameters
    ----------
    recording : Recording
        With true positions.

    Returns
    -------
    ndarray of shape (P, 2)
        No further apart than 1.5 times the distance from one of them to its nearest; along the
        skin, if that is known.
    """
    apart = recording.surface_distances
    if apart is None:
        if recording.positions is None:
            raise InputError("without true positions, nobody knows which sensors are neighbours")
        apart = np.linalg.norm(recording.positions[:, None] - recording.positions, axis=2)
    others = apart + np.diag(np.full(len(apart), np.inf))
    nearest = others.min(axis=1)
    within = others <= _NEIGHBOURLY * np.maximum(nearest[:, None], nearest)
    return np.argwhere(np.triu(within & np.isfinite(others), k=1))


def _contacts(touched: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Count how often each sensor comes to be touched, shape (N,)."""
    before = np.vstack([np.zeros_like(touched[:1]), touched[:-1]])
    return np.asarray(np.count_nonzero(touched & ~before, axis=0))


def _together(touched: NDArray[np.bool_], pairs: NDArray[np.intp]) -> int:
    """Count pairs that were touched in the same frame."""
    counts = touched.astype(np.float32)
    return int(np.count_nonzero((counts.T @ counts)[tuple(pairs.T)]))


def _mantel_r(recording: Recording, n_frames: int, method: str | None, dimensions: int) -> float:
    """Score the map of a recording's beginning; NaN if it gives none."""
    if method is None or recording.positions is None:
        return float("nan")
    beginning = replace(recording, readings=recording.readings[:n_frames])
    with warnings.catch_warnings():
        # What a short recording lacks is what the curve shows.
        warnings.simplefilter("ignore", AnisomapWarning)
        try:
            found = reconstruct(beginning, method, dimensions)
            return score(found, recording.positions, permutations=0).mantel.r
        except InputError:
            return float("nan")


def _frozen(values: Any, shape: tuple[int, ...] | None = None) -> NDArray[Any]:
    array = np.array(values)
    array = array if shape is None else array.reshape(shape)
    array.setflags(write=False)
    return array
