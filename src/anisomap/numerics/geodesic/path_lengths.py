"""Maps fitted to path lengths on a neighbour graph, where correlations do not resolve distances.

A rolling body is touched along whole lines at once. Correlations hardly decrease along these
lines, so a map made from correlations is compressed in that direction; adjacency can still be
estimated.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import cdist

from anisomap.errors import InputError
from anisomap.numerics.geodesic.contact_heights import peak_lengths
from anisomap.numerics.geodesic.neighbours import (
    NeighbourOptions,
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


@dataclass(frozen=True)
class GeodesicOptions:
    """Parameters of the geodesic refinement, tuned on simulated skins.

    power: Exponent p, at least 0, of the weight ``H^-p`` of a path of length H; 4 to 8 give similar
        maps.
    guide_weight: Weight of the guide map, at least 0.
    max_unevenness: `unevenness`, above 0, beyond which the distances of a map are rejected; 0.4 to
        0.7 gave the same maps on the tested skins.
    min_agreement: Minimum `split_half_agreement` at which the graph replaces a rejected map.
    max_forced_share: Maximum share of forced links at which contact peaks are used: where the ends
        of a body are hardly touched, their sensors are linked arbitrarily. The share was at most
        0.04 on cylinders without sensors on their ends, and at least 0.18 with sensors there.
    min_measured_share: Minimum share of the links for which contact peaks must give a length.
    max_slope: Maximum `log_log_slope` of peak lengths over map distances at which an uneven map is
        rejected. The slope was at most 0.2 on 50 rolling cylinders (0.31 with 200 sensors), and at
        least 0.5 on skins that touch themselves, for which uneven maps are correct.
    smacof: Stopping criteria of the scaling.
    """

    neighbours: NeighbourOptions = field(default_factory=NeighbourOptions)
    power: float = 6.0
    guide_weight: float = 0.003
    max_unevenness: float = 0.5
    min_agreement: float = 0.5
    max_forced_share: float = 0.1
    min_measured_share: float = 0.5
    max_slope: float = 0.35
    smacof: SmacofOptions = field(default_factory=lambda: SmacofOptions(1e-6, 500))

    def __post_init__(self) -> None:
        for name in ("power", "guide_weight"):
            if not (np.isfinite(value := getattr(self, name)) and value >= 0):
                raise InputError(f"{name} must be at least 0, got {value}")
        if not self.max_unevenness > 0:
            raise InputError(f"max_unevenness must be above 0, got {self.max_unevenness}")


@dataclass(frozen=True, eq=False)
class GeodesicRefinement:
    """A map, and whether the refinement was applied to it.

    positions (N, k): The given positions if not `applied`.
    unevenness: `unevenness` of the given map.
    """

    positions: Matrix
    applied: bool
    unevenness: float


def fit_path_lengths(
    lengths: ArrayLike,
    dimensions: int = 3,
    *,
    guide: ArrayLike | None = None,
    options: GeodesicOptions | None = None,
) -> Matrix:
    """Fit positions to the short paths on a graph, optionally guided by a map.

    lengths (N, N), guide (N, k) -> (N, k).

    Minimises over positions and the scale g of the guide ::

        sum_{i<j} H_ij^-p (d_ij - H_ij)^2 + kappa (1 + g c_ij)^-2 (d_ij - g c_ij)^2
        kappa = guide_weight max(0, v^-2 - max_unevenness^-2),  v = unevenness of the guide

    with path lengths H, distances c on the guide, and SMACOF (`smacof`) for the positions. Long
    paths zigzag and cross folds, so their weight is negligible; an even guide is more accurate for
    long distances, and the weight of an uneven one is 0.
    """
    chosen = options or GeodesicOptions()
    links = np.asarray(lengths, dtype=np.float64)
    paths = np.asarray(shortest_path(csr_matrix(links), directed=False))
    identity = np.eye(len(links))
    path_weights = (np.maximum(paths, _MIN_PATH) + identity) ** -chosen.power
    kappa = 0.0
    if guide is not None:
        steps = edge_distances(guide, links > 0)
        spread = max(float(np.log(steps).std()), np.finfo(np.float64).eps)
        kappa = chosen.guide_weight * max(0.0, spread**-2 - chosen.max_unevenness**-2)
        dimensions = np.shape(guide)[1]
    if kappa == 0:
        start = smacof(paths, dimensions=dimensions, options=chosen.smacof).positions
        return smacof(paths, weights=path_weights, start=start, options=chosen.smacof).positions
    guide_distances = cdist(np.asarray(guide), np.asarray(guide))
    scale = float(np.exp(-np.log(steps).mean()))
    positions = scale * np.asarray(guide, dtype=np.float64)
    for _ in range(_SCALE_ITERATIONS):
        guide_weights = kappa * (1 + scale * guide_distances) ** -2.0
        weights = path_weights + guide_weights
        targets = (path_weights * paths + guide_weights * scale * guide_distances) / weights
        positions = smacof(
            targets, weights=weights, start=positions, options=chosen.smacof
        ).positions
        distances = cdist(positions, positions)
        scale = float(
            (guide_weights * distances * guide_distances).sum()
            / (guide_weights * guide_distances**2).sum()
        )
    return positions


def refine_by_even_spacing(
    readings: ArrayLike,
    positions: ArrayLike,
    *,
    similarity: ArrayLike | None = None,
    options: GeodesicOptions | None = None,
) -> GeodesicRefinement:
    """Refine a map under the declared prior that neighbours are evenly spaced.

    readings (T, N), positions (N, k), similarity (N, N).
    """
    chosen = options or GeodesicOptions()
    given = np.asarray(positions, dtype=np.float64)
    graph = neighbour_graph(readings, given, similarity=similarity, options=chosen.neighbours)
    uneven = unevenness(given, graph.adjacency)
    if uneven > chosen.max_unevenness and not _halves_agree(readings, given, chosen):
        return GeodesicRefinement(given, False, uneven)
    return _refined(graph.adjacency.astype(np.float64), given, uneven, chosen)


def refine_by_contact_peaks(
    readings: ArrayLike,
    positions: ArrayLike,
    *,
    similarity: ArrayLike | None = None,
    changes: ArrayLike | None = None,
    options: GeodesicOptions | None = None,
) -> GeodesicRefinement:
    """Refine an uneven map with link lengths estimated from contact peaks. changes (N, N)."""
    chosen = options or GeodesicOptions()
    given = np.asarray(positions, dtype=np.float64)
    graph = neighbour_graph(
        readings, given, similarity=similarity, changes=changes, options=chosen.neighbours
    )
    adjacency, uneven = graph.adjacency, unevenness(given, graph.adjacency)
    if (
        uneven <= chosen.max_unevenness
        or graph.forced_share > chosen.max_forced_share
        or not _halves_agree(readings, given, chosen)
    ):
        return GeodesicRefinement(given, False, uneven)
    lengths = peak_lengths(readings, adjacency)
    known = np.isfinite(lengths)
    if (
        np.count_nonzero(known) < max(1.0, chosen.min_measured_share * np.count_nonzero(adjacency))
        or log_log_slope(given, lengths) > chosen.max_slope
    ):
        return GeodesicRefinement(given, False, uneven)
    relative = np.where(known, lengths / np.median(lengths[known]), 1.0)
    return _refined(np.where(adjacency, relative, 0.0), given, uneven, chosen)


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


def _halves_agree(readings: ArrayLike, positions: Matrix, options: GeodesicOptions) -> bool:
    agreement = split_half_agreement(readings, positions, options=options.neighbours)
    return agreement >= options.min_agreement


def _refined(
    lengths: Matrix, given: Matrix, uneven: float, options: GeodesicOptions
) -> GeodesicRefinement:
    fitted = fit_path_lengths(lengths, guide=given, options=options)
    before, after = (np.log(edge_distances(x, lengths > 0)).mean() for x in (given, fitted))
    return GeodesicRefinement(np.exp(before - after) * fitted, True, uneven)
