"""Graphs of adjacent sensors, estimated from readings."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import cdist

from anisomap.errors import InputError
from anisomap.numerics.graph.dissimilarity import NUMERICAL_ZERO, partial_correlation
from anisomap.numerics.graph.metric import minimax_paths
from anisomap.numerics.neighbours import spanning_tree
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.split_half import blended_correlation, split_blocks

_MIN_SIMILARITY = 1e-3
"""Clipping of S before -log S, chosen by hand: smaller values are indistinguishable from 0."""

_MIN_FRAMES = 3  # two differences between frames, the fewest that correlate
_RIDGE = 0.1  # of the partial correlations; .03 to 1 give similar maps
_SLACK = 1.2  # by which a link may be weaker than the best path over one other; up to 1.5 as good
# Maximum separation of neighbours over the longest step of the best path between them, in readings
# and on a map, whose short distances are less reliable.
_MAX_STEP_RATIO, _MAX_MAP_STEP_RATIO = 1.3, 1.7
_N_NEAREST = 16  # neighbours, of `local_dimension`; 12 gave a smaller margin
_MIN_SENSORS = 3  # three pairs, the fewest that correlate


def adjacency_graph(
    readings: ArrayLike,
    positions: ArrayLike | None = None,
    *,
    similarity: ArrayLike | None = None,
    changes: ArrayLike | None = None,
) -> NDArray[np.bool_]:
    """Link adjacent sensors, with few links between sensors that are not adjacent.

    readings (T, N), positions (N, k), similarity (N, N), changes (N, N) -> (N, N), symmetric and
    connected. `changes` is the similarity of changes between frames, by default of the readings;
    those of ranks serve as well.

    With the partial correlations Q of S, sensors i and j are linked if ``Q_ij > 0`` and

    1. no third sensor is much more similar to both: ``1.2 Q_ij >= max_k min(Q_ik, Q_jk)``
       (a relative neighbourhood graph; Toussaint 1980, Pattern Recognition 12: 261-268);
    2. their separation is not much larger than the longest step of the best path between them,
       ``d_ij <= 1.3 m_ij`` with m from `minimax_paths`, for ``d = (-log S)^(1/2)``, for the same
       function of the changes between frames, and, with 1.7, for the distances on the map.

    The maximum spanning tree of the link strengths is always included. Each condition removes
    shortcuts that the others keep: a rolling body touches whole lines of sensors at once, so
    partial correlations alone cannot distinguish one step along a line from two.
    """
    values = np.asarray(readings)
    if values.ndim != 2 or len(values) < _MIN_FRAMES or values.shape[1] < 2:
        raise InputError(
            f"a neighbour graph needs at least {_MIN_FRAMES} frames of at least 2 sensors, "
            f"got readings of shape {values.shape}"
        )
    correlation = blended_correlation(values) if similarity is None else np.asarray(similarity)
    if changes is None:
        changes = blended_correlation(np.diff(values.astype(np.float64, copy=False), axis=0))
    adjacent = _within(_separation(correlation), _MAX_STEP_RATIO)
    adjacent &= _within(_separation(np.asarray(changes)), _MAX_STEP_RATIO)
    if positions is not None:
        points = _checked_positions(positions, values.shape[1])
        adjacent &= _within(cdist(points, points), _MAX_MAP_STEP_RATIO)
    partial = partial_correlation(correlation, _RIDGE)
    adjacent &= partial > 0
    np.fill_diagonal(adjacent, val=False)
    direct = _without_detours(adjacent, partial, _SLACK)
    # Pairs with positive partial correlation precede all others, which are ordered by similarity.
    return np.asarray(direct | spanning_tree(-np.where(partial > 0, partial, correlation - 3)))


def unevenness(positions: ArrayLike, adjacency: ArrayLike) -> float:
    """Measure the spread of the distances between neighbours on a map. positions (N, k)."""
    return float(np.log(edge_distances(positions, adjacency)).std())


def local_dimension(positions: ArrayLike) -> float:
    """Estimate the dimension of the set of sensors: about 1 on a curve, 2 on a surface.

    positions (N, k).

    Levina & Bickel 2004, Advances in Neural Information Processing Systems 17, eq. 8, with the mean
    taken before the reciprocal (MacKay & Ghahramani 2005).
    """
    points = np.asarray(positions, dtype=np.float64)
    if len(points) < 2 * _N_NEAREST:
        return float("nan")
    nearest = np.sort(cdist(points, points), axis=1)[:, 1 : _N_NEAREST + 1]
    nearest = nearest[nearest[:, 0] > 0]
    if len(nearest) < 2 * _N_NEAREST:
        return float("nan")
    mean_log = float(np.mean(np.log(nearest[:, -1:] / nearest[:, :-1])))
    return 1 / mean_log if mean_log > 0 else float("nan")


def edge_distances(positions: ArrayLike, adjacency: ArrayLike) -> NDArray[np.float64]:
    """Return the map distances of links i < j in row-major order, clipped above 0."""
    mask = np.asarray(adjacency, dtype=bool)
    points = _checked_positions(positions, len(mask))
    distances = cdist(points, points)
    smallest = max(NUMERICAL_ZERO * float(distances.max()), np.finfo(np.float64).tiny)
    return np.asarray(np.maximum(distances[np.triu(mask, 1)], smallest))


def split_half_agreement(readings: ArrayLike, positions: ArrayLike | None = None) -> float:
    """Correlate the neighbour graphs of the two halves of a recording. readings (T, N)."""
    values = np.asarray(readings)
    if len(values) < 2 * _MIN_FRAMES:
        return 0.0
    halves = [values[frames] for frames in split_blocks(len(values))]
    varying = np.all([(half != half[0]).any(axis=0) for half in halves], axis=0)
    n_compared = int(np.count_nonzero(varying))
    if n_compared < _MIN_SENSORS:
        return 0.0
    points = None if positions is None else np.asarray(positions)[varying]
    pairs = np.triu_indices(n_compared, 1)
    graphs = [adjacency_graph(half[:, varying], points) for half in halves]
    first, second = (shortest_path(graph, unweighted=True)[pairs] for graph in graphs)
    if np.ptp(first) == 0 or np.ptp(second) == 0:
        return 0.0
    return float(np.corrcoef(first, second)[0, 1])


def _separation(similarity: Reals) -> Reals:
    separation = np.sqrt(-np.log(np.clip(similarity, _MIN_SIMILARITY, 1.0)))
    np.fill_diagonal(separation, 0)
    return np.asarray(separation)


def _within(distances: Reals, max_ratio: float) -> NDArray[np.bool_]:
    return np.asarray(distances <= max_ratio * minimax_paths(distances))


def _without_detours(
    adjacent: NDArray[np.bool_], partial: Reals, slack: float
) -> NDArray[np.bool_]:
    kept = np.zeros_like(adjacent)
    for i, row in enumerate(partial):
        others = np.flatnonzero(adjacent[i])
        detours = np.minimum(row, partial[others]).max(axis=1)
        kept[i, others] = slack * row[others] >= detours
    return np.asarray(kept | kept.T)


def _checked_positions(positions: ArrayLike, n_sensors: int) -> NDArray[np.float64]:
    points = np.asarray(positions, dtype=np.float64)
    if points.ndim != 2 or len(points) != n_sensors:
        raise InputError(f"positions must have shape ({n_sensors}, k), got {points.shape}")
    return points
