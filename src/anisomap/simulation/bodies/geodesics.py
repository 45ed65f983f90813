"""Geodesic distances along the surface of a body."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from anisomap.simulation.bodies.body import Body, nearest_neighbours
from anisomap.simulation.geometry.solids import Points
from anisomap.simulation.geometry.spreading import sample_surface

_SEED = 0
_N_SAMPLES = 6000
_N_NEIGHBOURS = 100  # with fewer, zigzag paths are a few per cent longer
_MAX_SAG = 0.15  # x chord: largest distance of the middle of an edge from the surface
_MIN_FACING = -0.5  # cosine between the normals at the ends of an edge

# Cached, since runs of one body with many seeds share its distances.
_computed: WeakKeyDictionary[Body, NDArray[np.float64]] = WeakKeyDictionary()


def surface_distances(body: Body) -> NDArray[np.float64] | None:
    """Compute geodesic distances between the sensors of a body.

    Parameters
    ----------
    body : Body

    Returns
    -------
    ndarray of shape (N, N), or None
        None if the surface between the sensors is unknown (`body_from_points`). Symmetric; inf
        between disconnected parts. Exact where the body has a closed form. Otherwise, lengths of
        shortest paths on a graph of surface points, joined to their neighbours unless the straight
        line leaves the surface; within 4 % of the truth on spheres, cylinders and plates, and
        mostly within 1 %. Reproducible.
    """
    if not body.is_whole:
        return None
    if body.geodesic is not None:
        return body.geodesic(body.positions)
    if body not in _computed:
        _computed[body] = _shortest_paths(body)
        _computed[body].setflags(write=False)
    return _computed[body]


def _shortest_paths(body: Body) -> NDArray[np.float64]:
    """Compute shortest paths over points of the surface, shape (N, N)."""
    drawn, drawn_normals = sample_surface(body.solids, _N_SAMPLES, np.random.default_rng(_SEED))
    points, normals = np.vstack([body.positions, drawn]), np.vstack([body.normals, drawn_normals])
    lengths, neighbours = nearest_neighbours(points, _N_NEIGHBOURS)
    edges = np.column_stack([np.repeat(np.arange(len(points)), _N_NEIGHBOURS), neighbours.ravel()])
    chord = np.maximum(lengths.ravel(), 1e-12 * body.reach)  # scipy reads a stored 0 as no edge
    directions = np.diff(points[edges], axis=1)[:, 0]
    turn = np.einsum("hd,hd->h", np.diff(normals[edges], axis=1)[:, 0], directions)
    # An arc that turns by an angle a is longer than its chord by the factor 1 + a^2 / 24.
    arc = chord * (1 + (turn / chord) ** 2 / 24)
    valid = _on_surface(points, normals, edges, chord)
    ends = edges[valid].T.astype(np.int32)  # scipy 1.14 takes no others
    graph = coo_array((arc[valid], tuple(ends)), shape=(len(points), len(points)))
    found = dijkstra(graph.tocsr(), directed=False, indices=np.arange(body.n_sensors))
    between = found[:, : body.n_sensors]
    return np.asarray(np.minimum(between, between.T))


def _on_surface(
    points: Points, normals: Points, edges: NDArray[np.intp], chord: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Mark edges that follow the surface, not those through air or across a thin plate."""
    start, end = edges.T
    # Accepts an edge around a corner of 90 degrees, but not to the other face of a thin plate.
    similar = np.einsum("hd,hd->h", normals[start], normals[end]) > _MIN_FACING
    middle = (points[start] + points[end]) / 2
    distance, nearest = map(np.asarray, KDTree(points).query(middle))
    sag = np.abs(np.einsum("hd,hd->h", middle - points[nearest], normals[nearest]))
    gap = 3 * float(np.median(nearest_neighbours(points, 1)[0]))
    return np.asarray(similar & (sag <= _MAX_SAG * chord) & (distance <= _MAX_SAG * chord + gap))
