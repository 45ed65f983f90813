"""Graphs of adjacent sensors, estimated from readings, and maps fitted to path lengths on them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import cdist

from anisomap.numerics.graph.dissimilarity import NUMERICAL_ZERO, partial_correlation
from anisomap.numerics.graph.metric import minimax_paths
from anisomap.numerics.neighbours import spanning_tree
from anisomap.numerics.precision import Floats, Reals
from anisomap.numerics.reliability.split_half import blended_correlation, split_blocks
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof

_MIN_SIMILARITY = 1e-3  # before -log S, chosen by hand: smaller values are indistinguishable from 0
_MIN_FRAMES = 6  # two differences between frames in each half, the fewest that correlate
_RIDGE = 0.1  # of the partial correlations; .03 to 1 give similar maps
_SLACK = 1.2  # by which a link may be weaker than the best path over one other; up to 1.5 as good
# Maximum separation of neighbours over the longest step of the best path between them, in readings
# and on a map, whose short distances are less reliable.
_MAX_STEP_RATIO, _MAX_MAP_STEP_RATIO = 1.3, 1.7
_MIN_SENSORS = 3  # three pairs, the fewest that correlate


def adjacency_graph(
    readings: ArrayLike,
    positions: ArrayLike | None = None,
    *,
    similarity: ArrayLike | None = None,
    changes: ArrayLike | None = None,
) -> NDArray[np.bool_]:
    """Link adjacent sensors; the graph is connected.

    readings (T, N), positions (N, k), similarity (N, N) -> (N, N). changes (N, N): Similarity of
    changes between frames, by default of the readings; those of ranks serve as well.

    With the partial correlations Q of S, sensors i and j are linked if ``Q_ij > 0`` and

    1. no third sensor is much more similar to both: ``1.2 Q_ij >= max_k min(Q_ik, Q_jk)``
       (a relative neighbourhood graph; Toussaint 1980, Pattern Recognition 12: 261-268);
    2. their separation is not much larger than the longest step of the best path between them,
       ``d_ij <= 1.3 m_ij`` with m from `minimax_paths`, for ``d = (-log S)^(1/2)``, for the same
       function of the changes between frames, and, with 1.7, for the distances on the map;

    or if they are linked in the maximum spanning tree of the link strengths.
    """
    values = np.asarray(readings)
    correlation = blended_correlation(values) if similarity is None else np.asarray(similarity)
    if changes is None:
        changes = blended_correlation(np.diff(values.astype(np.float64, copy=False), axis=0))
    adjacent = _within(_separation(correlation), _MAX_STEP_RATIO)
    adjacent &= _within(_separation(np.asarray(changes)), _MAX_STEP_RATIO)
    if positions is not None:
        points = np.asarray(positions, dtype=np.float64)
        adjacent &= _within(cdist(points, points), _MAX_MAP_STEP_RATIO)
    partial = partial_correlation(correlation, _RIDGE)
    adjacent &= partial > 0
    np.fill_diagonal(adjacent, val=False)
    direct = _without_detours(adjacent, partial)
    # Pairs with positive partial correlation precede all others, which are ordered by similarity.
    return np.asarray(direct | spanning_tree(-np.where(partial > 0, partial, correlation - 3)))


def unevenness(positions: ArrayLike, adjacency: ArrayLike) -> float:
    """Measure the spread of the distances between neighbours on a map. positions (N, k)."""
    return float(np.log(edge_distances(positions, adjacency)).std())


def edge_distances(positions: ArrayLike, adjacency: ArrayLike) -> Floats:
    """Return the map distances of links i < j in row-major order, clipped above 0."""
    mask = np.asarray(adjacency, dtype=bool)
    points = np.asarray(positions, dtype=np.float64)
    distances = cdist(points, points)
    smallest = max(NUMERICAL_ZERO * float(distances.max()), np.finfo(np.float64).tiny)
    return np.asarray(np.maximum(distances[np.triu(mask, 1)], smallest))


def split_half_agreement(readings: ArrayLike, positions: ArrayLike | None = None) -> float:
    """Correlate the neighbour graphs of the two halves of a recording. readings (T, N)."""
    values = np.asarray(readings)
    if len(values) < _MIN_FRAMES:
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


def _without_detours(adjacent: NDArray[np.bool_], partial: Reals) -> NDArray[np.bool_]:
    kept = np.zeros_like(adjacent)
    for i, row in enumerate(partial):
        others = np.flatnonzero(adjacent[i])
        detours = np.minimum(row, partial[others]).max(axis=1)
        kept[i, others] = _SLACK * row[others] >= detours
    return np.asarray(kept | kept.T)


_MIN_PATH = 0.3  # typical links; bounds the largest weight. Chosen by hand
_SCALE_ITERATIONS = 3  # alternations between positions and the scale of the guide; chosen by hand
_POWER = 6.0  # weight H^-p of a path of length H; 4 to 8 give similar maps
_GUIDE_WEIGHT = 0.003
_MIN_AGREEMENT = 0.5  # of halves, at which the graph replaces a rejected map
_STOPPING = SmacofOptions(1e-6, 500)

MAX_UNEVENNESS = 0.5
"""`unevenness` beyond which the distances of a map are rejected; .4 to .7 gave the same maps."""


def fit_path_lengths(
    lengths: ArrayLike, dimensions: int = 3, *, guide: ArrayLike | None = None
) -> Floats:
    """Fit positions to the short paths on a graph, optionally guided by a map.

    lengths (N, N), guide (N, k) -> (N, k).

    Minimises over positions and the scale g of the guide ::

        sum_{i<j} H_ij^-p (d_ij - H_ij)^2 + kappa (1 + g c_ij)^-2 (d_ij - g c_ij)^2
        kappa = .003 max(0, v^-2 - .5^-2),  p = 6,  v = unevenness of the guide

    with path lengths H and distances c on the guide. Long paths zigzag, so that their weight is
    negligible; an even guide is more accurate for long distances.
    """
    links = np.asarray(lengths, dtype=np.float64)
    paths = np.asarray(shortest_path(csr_matrix(links), directed=False))
    identity = np.eye(len(links))
    path_weights = (np.maximum(paths, _MIN_PATH) + identity) ** -_POWER
    kappa = 0.0
    if guide is not None:
        steps = edge_distances(guide, links > 0)
        spread = max(float(np.log(steps).std()), np.finfo(np.float64).eps)
        kappa = _GUIDE_WEIGHT * max(0.0, spread**-2 - MAX_UNEVENNESS**-2)
        dimensions = np.shape(guide)[1]
    if kappa == 0:
        start = smacof(paths, dimensions=dimensions, options=_STOPPING).positions
        return smacof(paths, weights=path_weights, start=start, options=_STOPPING).positions
    guide_distances = cdist(np.asarray(guide), np.asarray(guide))
    scale = float(np.exp(-np.log(steps).mean()))
    positions = scale * np.asarray(guide, dtype=np.float64)
    for _ in range(_SCALE_ITERATIONS):
        guide_weights = kappa * (1 + scale * guide_distances) ** -2.0
        weights = path_weights + guide_weights
        targets = (path_weights * paths + guide_weights * scale * guide_distances) / weights
        positions = smacof(targets, weights=weights, start=positions, options=_STOPPING).positions
        distances = cdist(positions, positions)
        scale = float(
            (guide_weights * distances * guide_distances).sum()
            / (guide_weights * guide_distances**2).sum()
        )
    return positions


def refine_by_even_spacing(
    readings: ArrayLike, positions: ArrayLike, *, similarity: ArrayLike | None = None
) -> Floats | None:
    """Refine a map under the declared prior that neighbours are evenly spaced.

    readings (T, N), positions (N, k), similarity (N, N) -> (N, k); None if the map is uneven and
    the halves of the recording disagree about which sensors are neighbours.
    """
    given = np.asarray(positions, dtype=np.float64)
    adjacency = adjacency_graph(readings, given, similarity=similarity)
    uneven = unevenness(given, adjacency) > MAX_UNEVENNESS
    if uneven and split_half_agreement(readings, given) < _MIN_AGREEMENT:
        return None
    fitted = fit_path_lengths(adjacency.astype(np.float64), guide=given)
    before, after = (np.log(edge_distances(x, adjacency)).mean() for x in (given, fitted))
    return np.asarray(np.exp(before - after) * fitted)
