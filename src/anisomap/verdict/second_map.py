"""The second map of a verdict: sensors are placed by the numbers of steps between them.

Steps are counted on a graph of adjacent sensors. The map makes no assumption about contacts, but
assumes equal distances between neighbours. If distances differ, path lengths are used, which assume
that contacts are equally long in all directions. Two further measurements compare halves of the
recording with equal shares of the stimulation, and detect sensors that form pairs.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import shortest_path
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from anisomap.evaluation.scoring import median_spacing
from anisomap.method.evidence import Evidence
from anisomap.numerics.columns import centred_rows
from anisomap.numerics.graph.dissimilarity import partial_correlation
from anisomap.numerics.graph.metric import minimax_paths
from anisomap.numerics.graph.neighbour_graphs import local_path_lengths
from anisomap.numerics.neighbours import spanning_tree
from anisomap.numerics.precision import Reals
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.scaling.multidimensional_scaling import smacof, torgerson
from anisomap.numerics.signals import some_sensors

_MIN_SIMILARITY = 1e-3  # before -log S, chosen by hand: smaller values are indistinguishable from 0
_RIDGE = 0.1  # of the partial correlations; .03 to 1 give similar maps
_SLACK = 1.2  # factor by which a link may be weaker than a path over one sensor; up to 1.5 is equal
# Maximum separation of neighbours relative to the longest step of the best path between them, in
# readings, and on a map, where short distances are less reliable.
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


_PARTING = 1e-3  # weight of distances on the map; far above rounding errors, far below a step


MAX_VARIATION = 0.35
"""Maximum relative standard deviation of distances to nearest neighbours on a map of evenly spaced
sensors: .03 to .35 on 57 good maps of lattices and farthest-point samples (seeds 21001 to 21240),
.30 to .65 on 23 maps of random places with errors below a spacing.
"""


MAX_CROWDING, CROWD_RADIUS = 0.4, 1.7
"""Maximum relative standard deviation of numbers of sensors within a radius, in spacings, on a map
in 3 dimensions, where borders are short: at most .37 on 112 good maps of evenly spaced sensors, and
above it on 18 of 25 wrong maps with low expected errors (seeds 63001 to 63200, 66001 to 66400).
"""


def spacing_varies(positions: NDArray[np.float64]) -> tuple[bool, bool]:
    """Return whether a map, (n, k), is unevenly spaced, and whether its density varies."""
    tree = KDTree(positions)
    nearest = np.asarray(tree.query(positions, k=2)[0])[:, 1]
    radius = CROWD_RADIUS * float(np.median(nearest))
    near = tree.query_ball_point(positions, radius, return_length=True) - 1
    uneven = nearest.std() > MAX_VARIATION * nearest.mean()
    return bool(uneven), bool(near.std() > MAX_CROWDING * near.mean())


def differences_from_second_map(
    evidence: Evidence, positions: NDArray[np.float64], *, uneven: bool = False
) -> NDArray[np.float64]:
    """Return differences from the map of numbers of steps. positions (n, k) -> (n, k).

    uneven: Whether sensors are unevenly spaced: path lengths then replace the numbers of steps.
    The maps are aligned by the best similarity; differences are infinite if there is no such map.
    """
    correlation, changes = evidence.correlation, evidence.rank_changes
    if median_spacing(positions) == 0 or correlation is None or changes is None:
        return np.full(positions.shape, math.inf)
    if uneven:
        steps = local_path_lengths(correlation)
    else:
        graph = adjacency_graph(correlation, changes, positions)
        steps = shortest_path(csr_array(graph, dtype=np.float64), unweighted=True)
    # The start is classical scaling, since this map must not inherit a fold of the given map.
    # Sensors with equal numbers of steps to all others would coincide up to rounding.
    distances = cdist(positions, positions)
    parted = steps + _PARTING * (steps.sum() / distances.sum()) * distances
    k = positions.shape[1]
    found = smacof(steps, dimensions=k, start=torgerson(parted, k)).positions
    return np.asarray(fit_similarity(found, positions).apply(found) - positions)


_N_SPLITS = 4
_MAX_HALVED, _N_REGIONS = 100, 5  # sensors and regions; 4,950 pairs determine a correlation


def agreement_of_halves(evidence: Evidence, rng: np.random.Generator) -> float:
    """Correlate the similarities of halves of the frames; NaN without readings.

    A few strong frames can dominate all correlations. Resamples repeat these frames, and therefore
    agree. Two halves that divide these frames agree only if correlations are equal in both.

    Blocks of frames are ordered by energy, i.e. the sum of squared standardised readings, and each
    pair of successive blocks is divided between the halves. The mean similarity of each sensor is
    subtracted, since an amplitude, a contact or a drift common to all sensors is no evidence of
    places. The result is the mean over several splits. Of many sensors, five sensors and the
    sensors most similar to each are compared, since distant sensors have nothing in common.
    """
    if evidence.readings is None or evidence.scores is None:
        return math.nan
    n_sensors = len(evidence.similarity)
    chosen = np.ones(n_sensors, dtype=bool)
    if n_sensors > _MAX_HALVED:
        similarity = evidence.similarity[some_sensors(n_sensors, _N_REGIONS)]
        nearest = np.argsort(-similarity, axis=1, kind="stable")[:, : _MAX_HALVED // _N_REGIONS]
        chosen = np.isin(np.arange(n_sensors), nearest)
    edges = evidence.edges
    weights = _equal_halves(_energies(evidence.readings[:, chosen], edges), rng)
    halves = [_own(one) for one in evidence.scores.select(chosen).resampled(edges, weights)]
    return float(np.mean([_cosine(*halves[i : i + 2]) for i in range(0, len(halves), 2)]))


def _energies(readings: NDArray[np.generic], edges: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the energy of each block of frames, (B,). readings (T, n), edges (B + 1,)."""
    squares = np.square(centred_rows(readings))
    sums = np.add.reduceat(squares, edges[:-1], axis=1, dtype=np.float64)
    return np.asarray(
        (sums / np.maximum(sums.sum(axis=1), np.finfo(float).tiny)[:, None]).sum(axis=0)
    )


def _equal_halves(energies: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    """Return weights of the blocks in both halves of each split, (2 splits, B)."""
    order = np.argsort(-energies, kind="stable")
    which = rng.integers(2, size=(_N_SPLITS, -(-len(order) // 2), 1))  # the half of the stronger
    first = (which == [0, 1]).reshape(_N_SPLITS, -1)[:, : len(order)]
    weights = np.empty((_N_SPLITS, 2, len(order)))
    weights[:, 0, order], weights[:, 1, order] = first, ~first
    return weights.reshape(2 * _N_SPLITS, -1)


def _own(similarity: Reals) -> NDArray[np.float64]:
    """Return similarities minus the means of both sensors, (n, n); 0 on the diagonal."""
    found = np.array(similarity, dtype=np.float64)
    n_sensors = len(found)
    np.fill_diagonal(found, 0)
    sums = found.sum(axis=1)
    mean = float(sums.sum()) / (n_sensors * (n_sensors - 1))
    beyond = (sums - (n_sensors - 1) * mean) / (n_sensors - 2)
    found -= mean + beyond[:, None] + beyond
    np.fill_diagonal(found, 0)
    return found


def _cosine(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    sizes = float(np.linalg.norm(one)) * float(np.linalg.norm(other))
    return float(np.vdot(one, other)) / sizes if sizes > 0 else 0.0


_MIN_PAIRED = 8
_MIN_GAP, _MIN_MUTUAL = 0.25, 0.7
_GREATEST_R = 0.999  # greater correlations are not distinguished


def sensors_pair_off(similarity: ArrayLike) -> bool:
    """Return whether most sensors form pairs of far greater similarity than to other sensors.

    similarity (N, N): Correlations.

    The limits are a median difference of .25 in Fisher's z between the two most similar sensors,
    and 70 % of sensors that are mutually most similar. Sensors of a skin have several neighbours at
    nearly equal distances. If a body touches itself at mirrored places, the readings place each
    sensor beside its mirror image: of 19 such recordings, 8 exceed both limits, and none of 128
    others with good maps. Without sensors at the mirrored places, this cannot be detected.
    """
    found = np.array(similarity, dtype=np.float64)
    if len(found) < _MIN_PAIRED:
        return False
    np.fill_diagonal(found, -1)
    nearest = found.argmax(axis=1)
    mutual = float(np.mean(nearest[nearest] == np.arange(len(found))))
    second, first = np.sort(found, axis=1)[:, -2:].T
    gap = np.diff(np.arctanh(np.clip([second, first], -_GREATEST_R, _GREATEST_R)), axis=0)
    return mutual > _MIN_MUTUAL and float(np.median(gap)) > _MIN_GAP
