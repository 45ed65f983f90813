"""Exact distances from surfaces made of triangles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.scene import Mesh

Points = NDArray[np.float64]

_AT_ONCE = 2_000_000  # pairs of a point and a triangle, which bounds the memory
_LONGEST = 2.5  # x what the edge of a typical triangle is: longer ones are cut
_PIECES = 50  # across the whole, at most


class TriangleSearch:
    """Finds the nearest of many triangles, exactly.

    Parameters
    ----------
    mesh : Mesh
        With at least one triangle.

    Notes
    -----
    A triangle lies in a ball about its middle. So none can be nearest whose middle is further
    than the nearest vertex and the largest such ball together. A few large triangles among small
    ones would make that a bad bound, so they are cut up.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._corners = _cut_up(mesh.vertices[mesh.faces])
        middles = self._corners.mean(axis=1)
        self._largest = float(np.linalg.norm(self._corners - middles[:, None], axis=2).max())
        self._middles, self._vertices = KDTree(middles), KDTree(self._corners.reshape(-1, 3))
        cross = np.cross(
            self._corners[:, 1] - self._corners[:, 0], self._corners[:, 2] - self._corners[:, 0]
        )
        # A triangle without area has no side, and leaves the sign to its neighbours.
        self._normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)

    def signed_distance(self, points: Points) -> Points:
        """Measure how far points are from the triangles.

        Parameters
        ----------
        points : ndarray of shape (n, 3)

        Returns
        -------
        ndarray of shape (n,)
            Negative on the inner side of triangles that are counter-clockwise from outside.

        Notes
        -----
        Where an edge or a corner is nearest, its triangles may disagree about the side; the one
        that the point stands above most steeply is right.
        """
        bound = np.asarray(self._vertices.query(points)[0]) + self._largest
        found = np.empty(len(points))
        counts = np.asarray(self._middles.query_ball_point(points, bound, return_length=True))
        blocks = np.cumsum(counts) // _AT_ONCE
        for block in np.unique(blocks):
            chosen = np.flatnonzero(blocks == block)
            found[chosen] = self._among(points[chosen], bound[chosen])
        return found

    def _among(self, points: Points, bound: NDArray[np.float64]) -> Points:
        candidates = self._middles.query_ball_point(points, bound)
        counts = np.array([len(near) for near in candidates])
        triangle = np.concatenate(candidates).astype(np.intp)
        whose = np.repeat(np.arange(len(points)), counts)
        away = points[whose] - nearest_on_triangles(points[whose], self._corners[triangle])
        squared = np.einsum("pd,pd->p", away, away)
        first = np.concatenate([[0], np.cumsum(counts)[:-1]])
        least = np.minimum.reduceat(squared, first)
        # A tie is a point that several triangles share, up to rounding.
        tied = squared <= least[whose] * (1 + 1e-9) + 1e-300
        above = np.where(tied, np.einsum("pd,pd->p", away, self._normals[triangle]), 0.0)
        highest, lowest = np.maximum.reduceat(above, first), np.minimum.reduceat(above, first)
        return np.asarray(np.where(highest >= -lowest, 1.0, -1.0) * np.sqrt(least))


def _cut_up(corners: Points) -> Points:
    """Halve triangles until their edges are of like length; corners of shape (n, 3, 3)."""
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    typical = np.sqrt(np.linalg.norm(doubled, axis=1).mean())
    extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    longest = max(_LONGEST * typical, extent / _PIECES)
    done = []
    while len(corners):
        lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
        fits = lengths.max(axis=1) <= longest
        done.append(corners[fits])
        corners, first = corners[~fits], lengths[~fits].argmax(axis=1)
        turned = np.take_along_axis(corners, (first[:, None] + np.arange(3))[..., None] % 3, axis=1)
        middle = turned[:, :1] / 2 + turned[:, 1:2] / 2
        a, b, c = np.split(turned, 3, axis=1)
        corners = np.concatenate([np.hstack([a, middle, c]), np.hstack([middle, b, c])])
    return np.concatenate(done)


def nearest_on_triangles(points: Points, corners: NDArray[np.float64]) -> Points:
    """Find the point of each triangle that is nearest to a point.

    Parameters
    ----------
    points : ndarray of shape (n, 3)
    corners : ndarray of shape (n, 3, 3)
        Of one triangle a point.

    Returns
    -------
    ndarray of shape (n, 3)
        The point's foot on the plane where that lies in the triangle, else the nearest point of
        the three edges.
    """
    origin, edge_one, edge_two = (
        corners[:, 0],
        corners[:, 1] - corners[:, 0],
        corners[:, 2] - corners[:, 0],
    )
    one_one, one_two, two_two = (
        _dot(edge_one, edge_one),
        _dot(edge_one, edge_two),
        _dot(edge_two, edge_two),
    )
    along_one, along_two = _dot(points - origin, edge_one), _dot(points - origin, edge_two)
    area = one_one * two_two - one_two**2
    flat = area <= 1e-24 * one_one * two_two
    safe = np.where(flat, 1.0, area)
    first = (two_two * along_one - one_two * along_two) / safe
    second = (one_one * along_two - one_two * along_one) / safe
    inside = ~flat & (first >= 0) & (second >= 0) & (first + second <= 1)
    foot = origin + first[:, None] * edge_one + second[:, None] * edge_two
    on_edges = np.stack(
        [_nearest_on_segments(points, corners[:, i], corners[:, (i + 1) % 3]) for i in range(3)]
    )
    away = np.einsum("epd,epd->ep", on_edges - points, on_edges - points)
    edge = np.take_along_axis(on_edges, away.argmin(axis=0)[None, :, None], axis=0)[0]
    return np.asarray(np.where(inside[:, None], foot, edge))


def _nearest_on_segments(points: Points, start: Points, end: Points) -> Points:
    direction = end - start
    length = np.maximum(_dot(direction, direction), 1e-300)
    share = np.clip(_dot(points - start, direction) / length, 0, 1)
    return np.asarray(start + share[:, None] * direction)


def _dot(a: Points, b: Points) -> NDArray[np.float64]:
    return np.asarray(np.einsum("nd,nd->n", a, b))
