"""Maps from the heights of contacts, for contacts that are long in one direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import shortest_path
from scipy.spatial.distance import cdist

from anisomap.numerics.geodesic.contact_heights import HeightSimilarity
from anisomap.numerics.graph.metric import minimax_paths
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof

Matrix = NDArray[np.float64]

_SIMILARITY_RANGE = (0.02, 0.97)  # before -log S; beyond, lengths are noise. Chosen by hand
_INDIRECT = 0.1  # share of S in the strength of links, as in `direct_dissimilarity`
_NOISE_FACTOR = 0.5  # of the stretch of links by the sampling variance of S; chosen by hand
_MIN_STRENGTH = 1e-3  # of links; keeps lengths finite
_GUIDE_QUANTILE = 0.05  # of path lengths over guide distances; a robust minimum. Chosen by hand
_LOCAL_SIMILARITY = 0.2  # above which lengths are fitted directly; chosen by hand
_MAX_SHORTCUT = 1.3  # distance on the map over length, beyond which a pair is taken for a shortcut
_BOUND_WEIGHT = 1.0  # of lower bounds relative to lengths; .5 and 2 gave the same maps
_ROUNDS = 3  # in which shortcuts are chosen again; chosen by hand
_WEAK_QUANTILE = 0.02  # of the links' similarities; a robust minimum. Chosen by hand
_TINY = 1e-9  # distance, in units of the lengths
# Of a link to the longest step of the best path between its sensors: with 1.1, maps lack links;
# with 1.3, some have links across the body.
_MAX_STEP_RATIO = 1.2
_STOPPING = SmacofOptions(1e-6, 500)


@dataclass(frozen=True, eq=False)
class HeightMap:
    """A map from the heights of contacts.

    positions (N, k): Centred; in units of the distance at which the similarity of heights is 1 / e.
    links: Neighbours.
    """

    positions: Matrix
    links: NDArray[np.bool_]


def fit_height_map(heights: HeightSimilarity, guide: ArrayLike) -> HeightMap:
    """Fit positions to lengths from the heights of contacts.

    guide (N, k).

    The similarity S of the heights on smooth random ground is about ``exp(-(d / l)^2)`` at a
    distance d, in all directions, so ``L = (-log S)^(1/2)`` is a length. It holds for short
    distances only: the two ends of a body that rests on its middle rise together. Therefore

    1. two sensors are linked if ``M_ij <= 1.2 m_ij`` with
       ``M = (S (Q + S / 10))^(-1/4)``, the partial correlations Q and the longest steps m of the
       best paths (`minimax_paths`);
    2. the path lengths H over the links, at least g c with the distances c on the guide and a
       scale g (the lower 5 % of H / c among distant pairs), are scaled by SMACOF;
    3. the positions minimise ``sum w_ij (d_ij / L_ij - 1)^2 + sum max(0, 1 - d_ij / b_ij)^2``
       over pairs with S > 0.2 that are at most 1.3 L apart, with the lower bounds b = g c, for
       other pairs with S < 0.2 at least the length at S = 0.2.
    """
    reference = np.asarray(guide, dtype=np.float64)
    similarity = heights.similarity
    diagonal = np.eye(len(similarity), dtype=bool)
    lengths = _lengths(similarity)
    links = _links(heights)
    clipped = np.clip(similarity, *_SIMILARITY_RANGE)
    stretched = lengths * (1 + _NOISE_FACTOR / heights.n_contacts / clipped**2)
    paths = np.asarray(shortest_path(csr_matrix(np.where(links, stretched, 0.0)), directed=False))
    bounds = cdist(reference, reference)
    distant = bounds > np.median(bounds)
    bounds *= float(np.quantile(paths[distant] / bounds[distant], _GUIDE_QUANTILE))
    targets = np.maximum(paths, bounds)
    np.fill_diagonal(targets, 0.0)
    dimensions = reference.shape[1]
    positions = smacof(targets, dimensions=dimensions, options=_STOPPING).positions
    typical = float(np.median(lengths[links]))
    positions = positions * (typical / np.median(cdist(positions, positions)[links]))
    farthest = float(np.sqrt(-np.log(_LOCAL_SIMILARITY)))
    local = (similarity > _LOCAL_SIMILARITY) & ~diagonal
    lower = np.where(local | diagonal, bounds, np.maximum(bounds, farthest))
    for _ in range(_ROUNDS):
        near = local & ((cdist(positions, positions) < _MAX_SHORTCUT * lengths) | links)
        weights = np.where(near, typical / np.maximum(lengths, _TINY), 0.0)
        positions = _relax(positions, lengths, weights, np.where(near, 0.0, lower))
    positions = positions - positions.mean(axis=0)
    return HeightMap(positions, links)


def weakest_link(heights: HeightSimilarity, links: ArrayLike) -> float:
    """Return the similarity of heights over the weakest links of a graph (2 % quantile).

    Heights do not resolve lengths at which they are hardly similar: all long gaps look alike.
    """
    mask = np.asarray(links, dtype=bool)
    return float(np.quantile(heights.similarity[mask], _WEAK_QUANTILE))


def linear_share(positions: ArrayLike, of: ArrayLike) -> float:
    """Return the share of the variance of a map that a linear image of another map explains.

    positions (N, k), of (N, m).
    """
    source, target = (np.asarray(x, dtype=np.float64) for x in (positions, of))
    source, target = source - source.mean(axis=0), target - target.mean(axis=0)
    residual = target - source @ np.linalg.lstsq(source, target, rcond=None)[0]
    total = float((target**2).sum())
    return 1 - float((residual**2).sum()) / total if total > 0 else 0.0


def _lengths(similarity: Matrix) -> Matrix:
    lengths = np.sqrt(-np.log(np.clip(similarity, *_SIMILARITY_RANGE)))
    np.fill_diagonal(lengths, 0.0)
    return np.asarray(lengths)


def _links(heights: HeightSimilarity) -> NDArray[np.bool_]:
    positive = np.clip(heights.similarity, _MIN_STRENGTH, 1.0)
    mixed = np.clip(heights.partial + _INDIRECT * heights.similarity, _MIN_STRENGTH, 1.0)
    lengths = (positive * mixed) ** -0.25
    np.fill_diagonal(lengths, 0.0)
    links = lengths <= _MAX_STEP_RATIO * minimax_paths(lengths) * (1 + _TINY)
    np.fill_diagonal(links, val=False)
    return np.asarray(links | links.T)


def _relax(positions: Matrix, lengths: Matrix, weights: Matrix, lower: Matrix) -> Matrix:
    """Minimise the errors of lengths and the violations of lower bounds."""
    shape = positions.shape
    per_length, per_bound = 1 / np.maximum(lengths, _TINY), 1 / np.maximum(lower, _TINY)
    for one in (per_length, per_bound):
        np.fill_diagonal(one, 1.0)
    # New matrices would take longer to allocate than to compute.
    distances, errors, violations, weighted = np.empty((4, *lengths.shape))

    def value_and_gradient(parameters: Matrix) -> tuple[float, Matrix]:
        points = parameters.reshape(shape)
        cdist(points, points, out=distances)
        np.maximum(distances, _TINY, out=distances)
        np.fill_diagonal(distances, 1.0)  # neither an error nor a violation
        np.multiply(distances, per_length, out=errors)
        np.subtract(errors, 1.0, out=errors)
        np.multiply(distances, per_bound, out=violations)
        np.subtract(1.0, violations, out=violations)
        np.maximum(violations, 0.0, out=violations)
        np.multiply(weights, errors, out=weighted)
        value = np.vdot(weighted, errors) + _BOUND_WEIGHT * np.vdot(violations, violations)
        np.multiply(weighted, per_length, out=weighted)
        np.multiply(violations, per_bound, out=violations)
        np.multiply(violations, _BOUND_WEIGHT, out=violations)
        slope = np.subtract(weighted, violations, out=weighted)
        np.divide(slope, distances, out=slope)
        gradient = 4 * (slope.sum(axis=1)[:, None] * points - slope @ points)
        return float(value), gradient.ravel()

    found = minimize(
        value_and_gradient, positions.ravel(), jac=True, method="L-BFGS-B",
        options={"maxiter": 500},
    )  # fmt: skip
    return np.asarray(found.x.reshape(shape))
