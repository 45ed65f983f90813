"""The second map of a verdict: sensors are placed by the numbers of steps between them.

The steps are on a graph of adjacent sensors. They assume nothing of contacts, but that neighbours
are equally far apart.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import cdist

from anisomap.evaluation.scoring import median_spacing
from anisomap.method.evidence import Evidence
from anisomap.numerics.graph.dissimilarity import partial_correlation
from anisomap.numerics.graph.metric import minimax_paths
from anisomap.numerics.neighbours import spanning_tree
from anisomap.numerics.precision import Reals
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.scaling.multidimensional_scaling import smacof, torgerson

_MIN_SIMILARITY = 1e-3  # before -log S, chosen by hand: smaller values are indistinguishable from 0
_RIDGE = 0.1  # of the partial correlations; .03 to 1 give similar maps
_SLACK = 1.2  # by which a link may be weaker than the best path over one other; up to 1.5 as good
# Maximum separation of neighbours over the longest step of the best path between them, in readings
# and on a map, whose short distances are less reliable.
_MAX_STEP_RATIO, _MAX_MAP_STEP_RATIO = 1.3, 1.7


def adjacency_graph(
    correlation: Reals, changes: Reals, positions: ArrayLike | None = None
) -> NDArray[np.bool_]:
    """Link adjacent sensors; the graph is connected.

    correlation (N, N), positions (N, k) -> (N, N). changes (N, N): Correlation of the changes of
    the readings, or of their ranks, between frames.

    With the partial correlations Q of S, sensors i and j are linked if ``Q_ij > 0`` and

    1. no third sensor is much more similar to both: ``1.2 Q_ij >= max_k min(Q_ik, Q_jk)``
       (a relative neighbourhood graph; Toussaint 1980, Pattern Recognition 12: 261-268);
    2. their separation is not much larger than the longest step of the best path between them,
       ``d_ij <= 1.3 m_ij`` with m from `minimax_paths`, for ``d = (-log S)^(1/2)``, for the same
       function of the changes between frames, and, with 1.7, for the distances on the map;

    or if they are linked in the maximum spanning tree of the link strengths.
    """
    adjacent = _within(_separation(correlation), _MAX_STEP_RATIO)
    adjacent &= _within(_separation(changes), _MAX_STEP_RATIO)
    if positions is not None:
        points = np.asarray(positions, dtype=np.float64)
        adjacent &= _within(cdist(points, points), _MAX_MAP_STEP_RATIO)
    partial = partial_correlation(correlation, _RIDGE)
    adjacent &= partial > 0
    np.fill_diagonal(adjacent, val=False)
    direct = _without_detours(adjacent, partial)
    # Pairs with positive partial correlation precede all others, which are ordered by similarity.
    return np.asarray(direct | spanning_tree(-np.where(partial > 0, partial, correlation - 3)))


def _separation(similarity: Reals) -> Reals:
    separation = np.sqrt(-np.log(np.clip(similarity, _MIN_SIMILARITY, 1.0)))
    np.fill_diagonal(separation, 0)
    return np.asarray(separation)


def _within(distances: Reals, max_ratio: float) -> NDArray[np.bool_]:
    return np.asarray(distances <= max_ratio * minimax_paths(distances))


def _without_detours(adjacent: NDArray[np.bool_], partial: Reals) -> NDArray[np.bool_]:
    kept = np.zeros_like(adjacent)
    for i, row in enumerate(partial):
        others = np.flatnonzero(adjacent[i])
        detours = np.minimum(row, partial[others]).max(axis=1)
        kept[i, others] = _SLACK * row[others] >= detours
    return np.asarray(kept | kept.T)


_PARTING = 1e-3  # share of the distances on the map; far above rounding, far below a step


def differences_from_steps(
    evidence: Evidence, positions: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compare a map with that of the numbers of steps between sensors. positions (n, k) -> (n, k).

    After the best similarity transform; infinite if there is no such map.
    """
    correlation, changes = evidence.correlation, evidence.rank_changes
    if median_spacing(positions) == 0 or correlation is None or changes is None:
        return np.full(positions.shape, math.inf)
    graph = adjacency_graph(correlation, changes, positions)
    steps = shortest_path(graph.astype(np.float64), unweighted=True)
    # Classical scaling as start: this map must not inherit a fold of the given one. Sensors with
    # equal numbers of steps to all others would coincide there, and rounding would part them.
    distances = cdist(positions, positions)
    parted = steps + _PARTING * (steps.sum() / distances.sum()) * distances
    k = positions.shape[1]
    found = smacof(steps, dimensions=k, start=torgerson(parted, k)).positions
    return np.asarray(fit_similarity(found, positions).apply(found) - positions)
