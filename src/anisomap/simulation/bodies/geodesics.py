"""Distances along the surface of a body."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from anisomap.simulation.bodies.body import Body, nearest_neighbours
from anisomap.simulation.geometry.solids import Points
from anisomap.simulation.geometry.spreading import sample_surface

_STEPPING_STONES = 6000
_JOINED = 100  # neighbours; with fewer, paths zigzag by some per cent
_SAG = 0.15  # of a hop: how far its middle may be off the surface before it is a short cut
_FACING = -0.5  # cosine between normals


def surface_distances(body: Body, rng: np.random.Generator | int = 0) -> NDArray[np.float64] | None:
    """Measure distances between sensors along the surface (geodesic distances).

    Parameters
    ----------
    body : Body
    rng : numpy.random.Generator or int
        Draws the stepping stones.

    Returns
    -------
    ndarray of shape (N, N), or None
        None if what lies between the sensors is not known (`body_from_points`). Symmetric; inf
        between parts that do not touch. Where the body has no closed form: shortest paths over
        thousands of points drawn from the surface, each joined to those around it unless the
        straight line between them leaves the surface. Within 4 % of the truth on spheres,
        cylinders and plates, and mostly within 1 %.
    """
    if not body.is_whole:
        return None
    if body.geodesic is not None:
        return body.geodesic(body.positions)
    stones, normals = sample_surface(body.solids, _STEPPING_STONES, np.random.default_rng(rng))
    points, outward = np.vstack([body.positions, stones]), np.vstack([body.normals, normals])
    lengths, neighbours = nearest_neighbours(points, _JOINED)
    hops = np.column_stack([np.repeat(np.arange(len(points)), _JOINED), neighbours.ravel()])
    chord = np.maximum(lengths.ravel(), 1e-12 * body.reach)  # a stored 0 is no edge
    turn = _along(outward, hops, np.diff(points[hops], axis=1)[:, 0])
    # An arc is longer than its chord by the square of the angle it turns, over 24.
    arc = chord * (1 + (turn / chord) ** 2 / 24)
    stays = _stays_on_surface(points, outward, hops, chord)
    graph = coo_array((arc[stays], tuple(hops[stays].T)), shape=(len(points), len(points)))
    found = dijkstra(graph.tocsr(), directed=False, indices=np.arange(body.n_sensors))
    between = found[:, : body.n_sensors]
    return np.asarray(np.minimum(between, between.T))


def _along(outward: Points, hops: NDArray[np.intp], directions: Points) -> NDArray[np.float64]:
    """Tell by how much the normals at the ends of hops differ along directions, shape (H,)."""
    return np.asarray(np.einsum("hd,hd->h", np.diff(outward[hops], axis=1)[:, 0], directions))


def _stays_on_surface(
    points: Points, outward: Points, hops: NDArray[np.intp], chord: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Tell which hops run along the surface, and not through the air or a thin plate."""
    start, end = hops.T
    # Over an edge of 90 degrees is fine; from one face of a thin plate to the other is not.
    alike = np.einsum("hd,hd->h", outward[start], outward[end]) > _FACING
    middle = (points[start] + points[end]) / 2
    away, stone = map(np.asarray, KDTree(points).query(middle))
    depth = np.abs(np.einsum("hd,hd->h", middle - points[stone], outward[stone]))
    gap = 3 * float(np.median(nearest_neighbours(points, 1)[0]))
    return np.asarray(alike & (depth <= _SAG * chord) & (away <= _SAG * chord + gap))
