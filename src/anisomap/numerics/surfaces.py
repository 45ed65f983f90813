"""Triangle meshes: normals, nearest points and random points of surfaces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components, minimum_spanning_tree
from scipy.spatial import KDTree

from anisomap.base.immutable import Immutable
from anisomap.errors import InputError


def frozen(values: ArrayLike) -> NDArray[np.float64]:
    """Copy numbers into a read-only array."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def frames_along(axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return rotation matrices that map z to unit vectors. axes (..., 3) -> (..., 3, 3)."""
    across = np.cross(np.eye(3)[np.abs(axes).argmin(axis=-1)], axes)
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    return np.stack([across, np.cross(axes, across), axes], axis=-1)


@dataclass(frozen=True, eq=False)
class Mesh(Immutable):
    """A triangle mesh.

    vertices (V, 3)
    faces: Vertices of each triangle, counter-clockwise as seen from outside.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.intp]

    def __post_init__(self) -> None:
        faces = np.array(self.faces, dtype=np.intp).reshape(-1, 3)
        self.set_fields(vertices=frozen(self.vertices), faces=faces)

    @property
    def corners(self) -> NDArray[np.float64]:
        """Vertices of each triangle, (n, 3, 3)."""
        return np.asarray(self.vertices[self.faces])


NEIGHBOURS = 8
"""Neighbours used for the tangent plane at a point; a point of a square lattice has 8."""

_MIN_ASPECT = 0.05  # width / length of a neighbourhood with a defined plane; chosen by hand


def estimate_normals(positions: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Estimate the normals of a surface at points on it, and where they are reliable.

    positions (N, 2 or 3) -> normals (N, 3), reliable (N,).

    Normals are unit vectors. In 2D, each is the z axis. In 3D, each is perpendicular to the plane
    fitted to a point and its `NEIGHBOURS` nearest points. Neighbouring normals are oriented
    consistently, and the outermost normal of each connected component points away from the centroid
    of the component (Hoppe et al. 1992, doi:10.1145/133994.134011). If the neighbours are collinear
    or fewer than 2, the normal points away from the centroid of all points.
    """
    points = np.asarray(positions, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or not np.isfinite(points).all():
        raise InputError(f"normals need finite points, (N, 2) or (N, 3), got {points.shape}")
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
    # scipy's sort of costs is unstable: ranks resolve equal costs, as on flat skins, by order.
    rank = np.empty(len(cost))
    rank[np.argsort(cost, kind="stable")] = np.arange(1, len(cost) + 1)
    ends = start.astype(np.int32), end.astype(np.int32)  # scipy 1.14 requires int32
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


Points = NDArray[np.float64]

_ROUNDING = 1e-9  # relative, far above the rounding errors of distances
_MAX_PAIRS = 2_000_000  # of a point and a triangle at once; limits memory
_MAX_EDGE = 2.5  # x square root of twice the mean area; triangles with longer edges are split
_MAX_SPLITS = 50  # edges are not split below this fraction of the extent of the mesh


class TriangleSearch:
    """Exact search for the nearest of one or more triangles.

    Each triangle lies in a ball about its centroid. A triangle whose centroid is further than the
    nearest vertex plus the largest radius cannot be the nearest. Large triangles are split.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._corners = _split_large(mesh.corners)
        centroids = self._corners.mean(axis=1)
        self._largest = float(np.linalg.norm(self._corners - centroids[:, None], axis=2).max())
        self._centroids, self._vertices = KDTree(centroids), KDTree(self._corners.reshape(-1, 3))
        cross = doubled_normals(self._corners)
        # A triangle without area has no normal; its neighbours determine the sign.
        self._normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)

    def signed_distance(self, points: Points) -> Points:
        """Compute the signed distance of points from the nearest triangle. points (n, 3) -> (n,).

        Among triangles that share a nearest edge or corner, the one with the largest distance along
        its normal determines the sign.
        """
        found = np.empty(len(points))
        for chosen, index, triangle, _, offset in self._candidates(points):
            squared = np.einsum("pd,pd->p", offset, offset)
            first = np.searchsorted(index, np.arange(len(chosen)))
            least = np.minimum.reduceat(squared, first)
            # Triangles with a common nearest point tie, up to rounding.
            tied = squared <= least[index] * (1 + _ROUNDING) + 1e-300
            above = np.where(tied, np.einsum("pd,pd->p", offset, self._normals[triangle]), 0.0)
            highest, lowest = np.maximum.reduceat(above, first), np.minimum.reduceat(above, first)
            found[chosen] = np.where(highest >= -lowest, 1.0, -1.0) * np.sqrt(least)
        return found

    def nearest(self, points: Points) -> tuple[Points, Points]:
        """Find the nearest point on the mesh, and the normal there.

        points (n, 3) -> nearest (n, 3), normals (n, 3).
        """
        found, normals = np.empty_like(points), np.empty_like(points)
        for chosen, index, triangle, feet, offset in self._candidates(points):
            # Sorted by point, then by distance: the first of each point is the nearest.
            order = np.lexsort((np.einsum("pd,pd->p", offset, offset), index))
            best = order[np.searchsorted(index[order], np.arange(len(chosen)))]
            found[chosen], normals[chosen] = feet[best], self._normals[triangle[best]]
        return found, normals

    def _candidates(
        self, points: Points
    ) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.intp], Points, Points]]:
        """Yield, for each block of points, candidate pairs of a point and its nearest triangle.

        Yields the rows of the block; for each pair, the index of the point in the block, the
        triangle, the nearest point on the triangle, and the offset from this nearest point.
        """
        # The margin, far above rounding errors, keeps at least one candidate for every point.
        bound = (np.asarray(self._vertices.query(points)[0]) + self._largest) * (1 + _ROUNDING)
        counts = np.asarray(self._centroids.query_ball_point(points, bound, return_length=True))
        blocks = np.cumsum(counts) // _MAX_PAIRS
        for block in np.unique(blocks):
            chosen = np.flatnonzero(blocks == block)
            near = self._centroids.query_ball_point(points[chosen], bound[chosen])
            triangle = np.concatenate(near).astype(np.intp)
            index = np.repeat(np.arange(len(chosen)), counts[chosen])
            here = points[chosen][index]
            feet = nearest_on_triangles(here, self._corners[triangle])
            yield chosen, index, triangle, feet, here - feet


def doubled_normals(corners: Points) -> Points:
    """Return normals of triangles, with lengths of twice the areas, (n, 3, 3) -> (n, 3)."""
    return np.asarray(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))


def areas_of(corners: Points) -> NDArray[np.float64]:
    """Return twice the areas of triangles, (n, 3, 3) -> (n,)."""
    return np.asarray(np.linalg.norm(doubled_normals(corners), axis=1))


def sample_triangles(
    corners: Points, count: int, rng: np.random.Generator
) -> tuple[Points, Points]:
    """Draw points uniformly from triangles, (n, 3, 3) -> (count, 3), and the unit normals there.

    Osada et al. (2002), doi:10.1145/571647.571648.
    """
    doubled = doubled_normals(corners)
    areas = np.linalg.norm(doubled, axis=1)
    chosen = rng.choice(len(areas), count, p=areas / areas.sum())
    root, along = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.column_stack([1 - root, root * (1 - along), root * along])
    points = np.einsum("nc,ncd->nd", weights, corners[chosen])
    return points, doubled[chosen] / areas[chosen, None]


def _split_large(corners: Points) -> Points:
    """Halve triangles with long edges; corners of shape (n, 3, 3)."""
    typical = np.sqrt(areas_of(corners).mean())
    extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    longest = max(_MAX_EDGE * typical, extent / _MAX_SPLITS)
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
    """Find, for each pair of a point and a triangle, the nearest point on the triangle.

    points (n, 3), corners (n, 3, 3) -> (n, 3).
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
    squared = np.einsum("epd,epd->ep", on_edges - points, on_edges - points)
    edge = np.take_along_axis(on_edges, squared.argmin(axis=0)[None, :, None], axis=0)[0]
    return np.asarray(np.where(inside[:, None], foot, edge))


def _nearest_on_segments(points: Points, start: Points, end: Points) -> Points:
    direction = end - start
    length = np.maximum(_dot(direction, direction), 1e-300)
    share = np.clip(_dot(points - start, direction) / length, 0, 1)
    return np.asarray(start + share[:, None] * direction)


def _dot(a: Points, b: Points) -> NDArray[np.float64]:
    return np.asarray(np.einsum("nd,nd->n", a, b))
