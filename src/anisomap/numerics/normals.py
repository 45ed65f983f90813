"""Surface normals estimated from points."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import KDTree

from anisomap.errors import InputError

NEIGHBOURS = 8
"""Neighbours used for the tangent plane at a point; a point of a square lattice has 8."""

_MIN_ASPECT = 0.05  # width / length of a neighbourhood with a defined plane; chosen by hand


def estimate_normals(positions: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Estimate the normals of a surface at points on it.

    Parameters
    ----------
    positions : array_like of shape (N, 2) or (N, 3)

    Returns
    -------
    normals : ndarray of shape (N, 3)
        Unit vectors. In 2D the z axis. In 3D perpendicular to the plane fitted to each point and
        its `NEIGHBOURS` nearest points. Neighbouring normals are oriented consistently, and the
        outermost normal of each connected component points away from the component's centroid
        (Hoppe et al. 1992, doi:10.1145/133994.134011).
    reliable : ndarray of bool, shape (N,)
        False where the neighbours are collinear or fewer than 2, so that no plane is defined. The
        normal then points away from the centroid of all points.

    Raises
    ------
    InputError
        If the points are not finite, or not 2D or 3D.
    """
    points = np.asarray(positions, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or not np.isfinite(points).all():
        raise InputError(
            f"positions have shape {points.shape}; normals need finite points, (N, 2) or (N, 3)"
        )
    n_points = len(points)
    if points.shape[1] == 2:
        return np.tile([0.0, 0.0, 1.0], (n_points, 1)), np.ones(n_points, dtype=bool)
    # Normals do not depend on scale; without scaling, products of large coordinates overflow.
    points = points / (np.abs(points).max(initial=0.0) or 1.0)
    outward = points - points.mean(axis=0)
    if n_points < 3:
        return _unit(outward), np.zeros(n_points, dtype=bool)
    count = min(NEIGHBOURS, n_points - 1)
    nearest = np.asarray(KDTree(points).query(points, k=count + 1)[1])
    patches = points[nearest] - points[nearest].mean(axis=1, keepdims=True)
    _, widths, axes = np.linalg.svd(patches, full_matrices=False)
    normals = axes[:, -1] if axes.shape[1] == 3 else np.cross(axes[:, 0], axes[:, 1])
    reliable = widths[:, 1] > _MIN_ASPECT * np.maximum(widths[:, 0], 1e-300)
    normals = np.where(reliable[:, None], normals, _unit(outward))
    return _orient(normals, nearest, outward), reliable


def _orient(
    normals: NDArray[np.float64], nearest: NDArray[np.intp], outward: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Flip normals for consistency along a minimum spanning tree of ``1 - |n_i n_j|``."""
    n_points, count = nearest.shape
    start, end = np.repeat(np.arange(n_points), count), nearest.ravel()
    cost = 1 - np.abs(np.einsum("ed,ed->e", normals[start], normals[end]))
    # scipy sorts costs with an unstable sort: of equal ones, as on flat skins, the first are taken.
    rank = np.empty(len(cost))
    rank[np.argsort(cost, kind="stable")] = np.arange(1, len(cost) + 1)
    ends = start.astype(np.int32), end.astype(np.int32)  # scipy 1.14 takes no others
    tree = minimum_spanning_tree(coo_array((rank, ends), shape=(n_points, n_points)).tocsr())
    oriented = normals.copy()
    labels = connected_components(tree, directed=False)[1]
    for label in range(labels.max() + 1):
        members = np.flatnonzero(labels == label)
        away = outward[members] - outward[members].mean(axis=0)
        root = int(members[np.argmax(np.einsum("nd,nd->n", away, away))])
        direction = away[members == root][0]
        if not direction.any():
            direction = outward[root]
        oriented[root] *= 1.0 if oriented[root] @ direction >= 0 else -1.0
        order, parent = breadth_first_order(tree, root, directed=False)
        for i in order[1:]:
            if oriented[i] @ oriented[parent[i]] < 0:
                oriented[i] *= -1
    return oriented


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normalise vectors; zero vectors become the z axis."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    upright = np.tile([0.0, 0.0, 1.0], (len(vectors), 1))
    return np.where(lengths > 0, vectors / np.maximum(lengths, 1e-300), upright)
