"""Maps fitted to path lengths on a neighbour graph, where correlations do not resolve distances.

A rolling body is touched along whole lines at once. Correlations hardly decrease along these
lines, so a map made from correlations is compressed in that direction; adjacency can still be
estimated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import cdist

from anisomap.numerics.geodesic.contact_heights import peak_lengths
from anisomap.numerics.geodesic.neighbours import (
    NeighbourGraph,
    edge_distances,
    neighbour_graph,
    split_half_agreement,
    unevenness,
)
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof

Matrix = NDArray[np.float64]

_MIN_PATH = 0.3  # typical links; bounds the largest weight. Chosen by hand
_EQUAL_LOG = 1e-9  # difference of log distances; a few hundred times the rounding error
_SCALE_ITERATIONS = 3  # alternations between positions and the scale of the guide; chosen by hand


_POWER = 6.0  # weight H^-p of a path of length H; 4 to 8 give similar maps
_GUIDE_WEIGHT = 0.003
_MIN_AGREEMENT = 0.5  # of halves, at which the graph replaces a rejected map
# Share of forced links: where the ends of a body are hardly touched, their sensors are linked
# arbitrarily. At most .04 on cylinders without sensors on their ends, at least .18 with them.
_MAX_FORCED_SHARE = 0.1
_MIN_MEASURED_SHARE = 0.5  # of the links, with a length by contact peaks
# `log_log_slope` of peak lengths over map distances: at most .2 on 50 rolling cylinders (.31 with
# 200 sensors), at least .5 on skins that touch themselves, for which uneven maps are correct.
_MAX_SLOPE = 0.35
_STOPPING = SmacofOptions(1e-6, 500)

MAX_UNEVENNESS = 0.5
"""`unevenness` beyond which the distances of a map are rejected; .4 to .7 gave the same maps."""


@dataclass(frozen=True, eq=False)
class GeodesicRefinement:
    """A map, and whether the refinement was applied to it.

    positions (N, k): The given positions if not `applied`.
    graph: Neighbours by the readings and the given map.
    unevenness: `unevenness` of the given map.
    """

    positions: Matrix
    applied: bool
    graph: NeighbourGraph
    unevenness: float


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
) -> GeodesicRefinement:
    """Refine a map under the declared prior that neighbours are evenly spaced.

    readings (T, N), positions (N, k), similarity (N, N).
    """
    given = np.asarray(positions, dtype=np.float64)
    graph = neighbour_graph(readings, given, similarity=similarity)
    uneven = unevenness(given, graph.adjacency)
    lengths = None
    if uneven <= MAX_UNEVENNESS or split_half_agreement(readings, given) >= _MIN_AGREEMENT:
        lengths = graph.adjacency.astype(np.float64)
    return _refined(given, graph, uneven, lengths)


def refine_by_contact_peaks(
    readings: ArrayLike,
    positions: ArrayLike,
    *,
    similarity: ArrayLike | None = None,
    changes: ArrayLike | None = None,
) -> GeodesicRefinement:
    """Refine an uneven map with link lengths estimated from contact peaks. changes (N, N)."""
    given = np.asarray(positions, dtype=np.float64)
    graph = neighbour_graph(readings, given, similarity=similarity, changes=changes)
    uneven = unevenness(given, graph.adjacency)
    lengths = None
    if (
        uneven > MAX_UNEVENNESS
        and graph.forced_share <= _MAX_FORCED_SHARE
        and split_half_agreement(readings, given) >= _MIN_AGREEMENT
    ):
        lengths = _lengths_by_peaks(readings, given, graph.adjacency)
    return _refined(given, graph, uneven, lengths)


def _lengths_by_peaks(
    readings: ArrayLike, given: Matrix, adjacency: NDArray[np.bool_]
) -> Matrix | None:
    """Return relative lengths of links; None if few are measured or they confirm the map."""
    lengths = peak_lengths(readings, adjacency)
    known = np.isfinite(lengths)
    least = max(1.0, _MIN_MEASURED_SHARE * np.count_nonzero(adjacency))
    if np.count_nonzero(known) < least or log_log_slope(given, lengths) > _MAX_SLOPE:
        return None
    relative = np.where(known, lengths / np.median(lengths[known]), 1.0)
    return np.where(adjacency, relative, 0.0)


def log_log_slope(positions: ArrayLike, lengths: ArrayLike) -> float:
    """Regress log lengths of links on the logarithms of their distances on a map.

    positions (N, k), lengths (N, N).
    """
    measured = np.asarray(lengths, dtype=np.float64)
    known = np.isfinite(measured)
    log_distances = np.log(edge_distances(positions, known))
    centred = log_distances - log_distances.mean()
    if not (np.abs(centred) > _EQUAL_LOG).any():
        return 0.0
    return float(centred @ np.log(measured[np.triu(known, 1)])) / float(centred @ centred)


def _refined(
    given: Matrix, graph: NeighbourGraph, uneven: float, lengths: Matrix | None
) -> GeodesicRefinement:
    """Fit a map to lengths of links, in the unit of the given one, if there are any."""
    if lengths is None:
        return GeodesicRefinement(given, False, graph, uneven)
    fitted = fit_path_lengths(lengths, guide=given)
    before, after = (np.log(edge_distances(x, lengths > 0)).mean() for x in (given, fitted))
    return GeodesicRefinement(np.exp(before - after) * fitted, True, graph, uneven)
