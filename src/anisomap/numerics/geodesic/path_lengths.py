"""Maps fitted to path lengths on a neighbour graph, where correlations do not resolve distances.

A rolling body is touched along whole lines at once. Correlations hardly decrease along these
lines, so a map made from correlations is compressed in that direction; adjacency can still be
estimated.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import cdist

from anisomap.numerics.geodesic.adjacency import (
    adjacency_graph,
    edge_distances,
    split_half_agreement,
    unevenness,
)
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof

Matrix = NDArray[np.float64]

_MIN_PATH = 0.3  # typical links; bounds the largest weight. Chosen by hand
_SCALE_ITERATIONS = 3  # alternations between positions and the scale of the guide; chosen by hand


_POWER = 6.0  # weight H^-p of a path of length H; 4 to 8 give similar maps
_GUIDE_WEIGHT = 0.003
_MIN_AGREEMENT = 0.5  # of halves, at which the graph replaces a rejected map
_STOPPING = SmacofOptions(1e-6, 500)

MAX_UNEVENNESS = 0.5
"""`unevenness` beyond which the distances of a map are rejected; .4 to .7 gave the same maps."""


def fit_path_lengths(
    lengths: ArrayLike,
    dimensions: int = 3,
    *,
    guide: ArrayLike | None = None,
) -> Matrix:
    """Fit positions to the short paths on a graph, optionally guided by a map.

    lengths (N, N), guide (N, k) -> (N, k).

    Minimises over positions and the scale g of the guide ::

        sum_{i<j} H_ij^-p (d_ij - H_ij)^2 + kappa (1 + g c_ij)^-2 (d_ij - g c_ij)^2
        kappa = .003 max(0, v^-2 - .5^-2),  p = 6,  v = unevenness of the guide

    with path lengths H, distances c on the guide, and SMACOF (`smacof`) for the positions. Long
    paths zigzag and cross folds, so their weight is negligible; an even guide is more accurate for
    long distances, and the weight of an uneven one is 0.
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
) -> Matrix | None:
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
