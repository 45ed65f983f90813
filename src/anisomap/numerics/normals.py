"""Which way is out of a surface of which only points are known."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import KDTree

from anisomap.errors import InputError

NEIGHBOURS = 8
"""Points around each, through which a plane is laid: those of a square lattice."""

_STRAIGHT = 0.05  # width of a patch over its length, below which it has no plane
_ALIKE = 1e-3  # cost of turning by nothing, so that a graph keeps its edges


def estimate_normals(positions: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Estimate the normals of a surface at points on it.

    Parameters
    ----------
    positions : array_like of shape (N, 2) or (N, 3)

    Returns
    -------
    normals : ndarray of shape (N, 3)
        Unit vectors. Of points in a plane, z. In space, across the plane through each point's
        `NEIGHBOURS`; neighbours look to the same side, and the outermost of each connected piece
        looks away from its middle (Hoppe et al. 1992, doi:10.1145/133994.134011).
    reliable : ndarray of bool, shape (N,)
        False where the neighbours lie in a line, or are too few, so that there is no plane: there,
        the normal points away from the middle of all.

    Raises
    ------
    InputError
        If the points are neither in the plane nor in space, or not finite.
    """
    points = np.asarray(positions, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or not np.isfinite(points).all():
        raise InputError(
            f"positions have shape {points.shape}; normals need finite points, (N, 2) or (N, 3)"
        )
    n_points = len(points)
    if points.shape[1] == 2:
        return np.tile([0.0, 0.0, 1.0], (n_points, 1)), np.ones(n_points, dtype=bool)
    # Directions do not depend on size, and products of large numbers would be infinite.
    points = points / (np.abs(points).max(initial=0.0) or 1.0)
    outward = points - points.mean(axis=0)
    if n_points < 3:
        return _unit(outward), np.zeros(n_points, dtype=bool)
    count = min(NEIGHBOURS, n_points - 1)
    around = np.asarray(KDTree(points).query(points, k=count + 1)[1])
    patches = points[around] - points[around].mean(axis=1, keepdims=True)
    _, widths, axes = np.linalg.svd(patches, full_matrices=False)
    normals = axes[:, -1] if axes.shape[1] == 3 else np.cross(axes[:, 0], axes[:, 1])
    reliable = widths[:, 1] > _STRAIGHT * np.maximum(widths[:, 0], 1e-300)
    normals = np.where(reliable[:, None], normals, _unit(outward))
    return _turned_alike(normals, around, outward), reliable


def _turned_alike(
    normals: NDArray[np.float64], around: NDArray[np.intp], outward: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Turn normals so that neighbours agree, going first where they agree most."""
    n_points, count = around.shape
    start, end = np.repeat(np.arange(n_points), count), around.ravel()
    cost = 1 + _ALIKE - np.abs(np.einsum("ed,ed->e", normals[start], normals[end]))
    graph = coo_array((cost, (start, end)), shape=(n_points, n_points)).tocsr()
    tree = minimum_spanning_tree(graph)
    turned = normals.copy()
    pieces = connected_components(tree, directed=False)[1]
    for piece in range(pieces.max() + 1):
        members = np.flatnonzero(pieces == piece)
        away = outward[members] - outward[members].mean(axis=0)
        first = int(members[np.argmax(np.einsum("nd,nd->n", away, away))])
        looks = away[members == first][0]
        if not looks.any():
            looks = outward[first]
        turned[first] *= 1.0 if turned[first] @ looks >= 0 else -1.0
        order, before = breadth_first_order(tree, first, directed=False)
        for i in order[1:]:
            if turned[i] @ turned[before[i]] < 0:
                turned[i] *= -1
    return turned


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    upright = np.tile([0.0, 0.0, 1.0], (len(vectors), 1))
    return np.where(lengths > 0, vectors / np.maximum(lengths, 1e-300), upright)
