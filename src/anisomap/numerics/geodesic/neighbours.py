"""Who is whose neighbour on a skin, told from readings and not from a map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import minimum_spanning_tree, shortest_path
from scipy.spatial.distance import cdist

from anisomap.errors import InputError
from anisomap.numerics.graph.dissimilarity import NUMERICAL_ZERO, partial_correlation
from anisomap.numerics.graph.metric import minimax_paths
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.blending import blended_correlation
from anisomap.numerics.reliability.split_half import split_blocks

_LEAST_SIMILARITY = 1e-3
"""Less is as good as nothing: it must not make one unrelated pair farther apart than another."""

_FEWEST_FRAMES = 3
_FEWEST_COMPARED = 3  # sensors


@dataclass(frozen=True)
class NeighbourOptions:
    """When two sensors count as neighbours; chosen on simulated skins, once for all.

    Parameters
    ----------
    ridge : float
        Of the partial correlations, above 0; 0.03 to 1 are about as good.
    slack : float
        How much weaker than the best detour over one sensor a direct link may be, at least 1; up
        to 1.5 is about as good.
    reach : float
        How much farther apart than the longest step of the best detour two neighbours may be in
        the readings, at least 1.
    reach_on_map : float
        The same on the map, which is less sure of short distances.
    """

    ridge: float = 0.1
    slack: float = 1.2
    reach: float = 1.3
    reach_on_map: float = 1.7

    def __post_init__(self) -> None:
        if not (np.isfinite(self.ridge) and self.ridge > 0):
            raise InputError(f"ridge is {self.ridge}; it must be above 0")
        for name in ("slack", "reach", "reach_on_map"):
            if not (value := getattr(self, name)) >= 1:
                raise InputError(f"{name} is {value}; it must be at least 1")


@dataclass(frozen=True, eq=False)
class Links:
    """Who is whose neighbour, and how far that can be believed.

    Attributes
    ----------
    joined : ndarray of bool, shape (N, N)
        As `direct_neighbours` gives it.
    forced : float
        Share of the links that are there only so that all sensors are connected.
    """

    joined: NDArray[np.bool_]
    forced: float


def direct_neighbours(
    readings: ArrayLike,
    positions: ArrayLike | None = None,
    *,
    similarity: ArrayLike | None = None,
    options: NeighbourOptions | None = None,
) -> NDArray[np.bool_]:
    """Join sensors that lie next to each other, with hardly a shortcut.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings in the order of time, T >= 3, N >= 2.
    positions : array_like of shape (N, k), optional
        A map, to look out for shortcuts on.
    similarity : array_like of shape (N, N), optional
        `blended_correlation` of the readings, if it is at hand.
    options : NeighbourOptions, optional

    Returns
    -------
    ndarray of bool, shape (N, N)
        Symmetric, False on the diagonal, connected. It does not depend on units or zeros of the
        sensors.

    Raises
    ------
    InputError
        If there are too few frames, or shapes disagree.

    Notes
    -----
    With the partial correlations Q of S, sensors i and j are joined if ``Q_ij > 0`` and

    1. no third sensor is nearer to both by much: ``slack Q_ij >= max_k min(Q_ik, Q_jk)``
       (a relative neighbourhood graph; Toussaint 1980, Pattern Recognition 12: 261-268);
    2. they are not much farther apart than the longest step of the best path between them,
       ``d_ij <= reach m_ij`` with m from `minimax_paths`, for ``d = (-log S)^(1/2)``, the same of
       the changes from frame to frame, and distances on the map.

    The tree that holds the strongest links is always in. Each condition closes shortcuts that the
    others leave open: whole lines of a body that rolls are touched at once, so that partial
    correlations alone cannot tell two steps along a line from one.
    """
    return find_links(readings, positions, similarity=similarity, options=options).joined


def find_links(
    readings: ArrayLike,
    positions: ArrayLike | None = None,
    *,
    similarity: ArrayLike | None = None,
    options: NeighbourOptions | None = None,
) -> Links:
    """Join neighbours as `direct_neighbours` does, and tell how many links had to be forced.

    Parameters
    ----------
    readings, positions, similarity, options
        As for `direct_neighbours`.

    Returns
    -------
    Links
    """
    chosen = options or NeighbourOptions()
    values = np.asarray(readings)
    if values.ndim != 2 or len(values) < _FEWEST_FRAMES or values.shape[1] < 2:
        raise InputError(
            f"readings of shape {values.shape} tell of no neighbours; give at least "
            f"{_FEWEST_FRAMES} frames of at least 2 sensors"
        )
    alike = blended_correlation(values) if similarity is None else np.asarray(similarity)
    changes = blended_correlation(np.diff(values.astype(np.float64, copy=False), axis=0))
    joined = _within(_separation(alike), chosen.reach)
    joined &= _within(_separation(changes), chosen.reach)
    if positions is not None:
        places = _checked_places(positions, values.shape[1])
        joined &= _within(cdist(places, places), chosen.reach_on_map)
    partial = partial_correlation(alike, chosen.ridge)
    joined &= partial > 0
    np.fill_diagonal(joined, val=False)
    direct = _without_detours(joined, partial, chosen.slack)
    connected = direct | _strongest_tree(partial, alike)
    forced = 1 - float(np.count_nonzero(direct) / np.count_nonzero(connected))
    return Links(connected, forced)


def unevenness(positions: ArrayLike, joined: ArrayLike) -> float:
    """Tell how unequal the distances are that a map draws between neighbours.

    Parameters
    ----------
    positions : array_like of shape (N, k)
    joined : array_like of bool, shape (N, N)
        Who is whose neighbour; symmetric, at least one pair.

    Returns
    -------
    float
        Standard deviation of the logarithms of the distances: 0 if all are equal, log 2 if half
        of them are four times as long as the others. It does not depend on the map's unit.
    """
    return float(np.log(edge_distances(positions, joined)).std())


def edge_distances(positions: ArrayLike, joined: ArrayLike) -> NDArray[np.float64]:
    """Give the distances on a map between neighbours, i < j, row by row; always above 0."""
    mask = np.asarray(joined, dtype=bool)
    places = _checked_places(positions, len(mask))
    distances = cdist(places, places)
    nearest = max(NUMERICAL_ZERO * float(distances.max()), np.finfo(np.float64).tiny)
    return np.asarray(np.maximum(distances[np.triu(mask, 1)], nearest))


def agreement(
    readings: ArrayLike,
    positions: ArrayLike | None = None,
    *,
    options: NeighbourOptions | None = None,
) -> float:
    """Tell whether both halves of a recording find the same neighbours.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings in the order of time.
    positions : array_like of shape (N, k), optional
        As for `direct_neighbours`.
    options : NeighbourOptions, optional

    Returns
    -------
    float
        Correlation over pairs of how many steps apart sensors are on the graphs of the two halves
        (`split_blocks`), of those sensors that vary in both; in [-1, 1]. 0 if these are too few.
    """
    values = np.asarray(readings)
    if len(values) < 2 * _FEWEST_FRAMES:
        return 0.0
    halves = [values[frames] for frames in split_blocks(len(values))]
    varying = np.all([(half != half[0]).any(axis=0) for half in halves], axis=0)
    n_compared = int(np.count_nonzero(varying))
    if n_compared < _FEWEST_COMPARED:
        return 0.0
    places = None if positions is None else np.asarray(positions)[varying]
    pairs = np.triu_indices(n_compared, 1)
    graphs = [direct_neighbours(half[:, varying], places, options=options) for half in halves]
    first, second = (shortest_path(joined, unweighted=True)[pairs] for joined in graphs)
    if np.ptp(first) == 0 or np.ptp(second) == 0:
        return 0.0
    return float(np.corrcoef(first, second)[0, 1])


def _separation(similarity: Reals) -> Reals:
    separation = np.sqrt(-np.log(np.clip(similarity, _LEAST_SIMILARITY, 1.0)))
    np.fill_diagonal(separation, 0)
    return np.asarray(separation)


def _within(distances: Reals, reach: float) -> NDArray[np.bool_]:
    return np.asarray(distances <= reach * minimax_paths(distances))


def _without_detours(joined: NDArray[np.bool_], partial: Reals, slack: float) -> NDArray[np.bool_]:
    kept = np.zeros_like(joined)
    for i, row in enumerate(partial):
        others = np.flatnonzero(joined[i])
        detours = np.minimum(row, partial[others]).max(axis=1)
        kept[i, others] = slack * row[others] >= detours
    return np.asarray(kept | kept.T)


def _strongest_tree(partial: Reals, similarity: Reals) -> NDArray[np.bool_]:
    # All links that are direct before any that is not, and those by similarity.
    length = np.where(partial > 0, 1 / np.maximum(partial, 1e-9), 1e9 * (2 - similarity))
    np.fill_diagonal(length, 0)
    tree = minimum_spanning_tree(length).toarray() > 0
    return np.asarray(tree | tree.T)


def _checked_places(positions: ArrayLike, n_sensors: int) -> NDArray[np.float64]:
    places = np.asarray(positions, dtype=np.float64)
    if places.ndim != 2 or len(places) != n_sensors:
        raise InputError(f"the map has shape {places.shape}; it must be ({n_sensors}, k)")
    return places
