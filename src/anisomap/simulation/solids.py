"""Solids with exact signed distances, and random and evenly spread points on their surface.

Solids are primitives in closed form and closed triangle meshes. Distances are negative inside.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.surfaces import (
    Mesh,
    TriangleSearch,
    areas_of,
    frames_along,
    frozen,
    sample_triangles,
)

Points: TypeAlias = NDArray[np.float64]
Chosen: TypeAlias = Callable[[Points], NDArray[np.bool_]]
"""Function of points (n, 3) that returns whether sensors may be placed at each (n,)."""

MAX_LENGTH = 1e10
"""Maximum of coordinates and sizes: products of three neither overflow nor lose precision."""

_CIRCLE_VERTICES = 48
_COARSE_VERTICES = 16
_GRADIENT_STEP = 1e-5  # x reach
_N_PROJECTIONS = 4
_CANDIDATES_PER_SENSOR = 100  # with more, the spacing is hardly more even
_MAX_ROUNDS = 50  # of rejection sampling
_ROUNDING = 1e-9  # x reach


@dataclass(frozen=True, eq=False)
class Solid:
    """A solid, made by `ball`, `capsule`, `cylinder`, `box` or `mesh`.

    kind: Type of geom in MuJoCo: ``"sphere"``, ``"capsule"``, ``"cylinder"``, ``"box"`` or
        ``"mesh"``.
    size: Size as in MuJoCo: (radius,); (radius, half length of the axis); or half edges.
    centre (3,)
    rotation (3, 3): Columns are the local x, y and z axes; capsules and cylinders lie along z.
    shape: Triangles of a mesh, in local coordinates.
    """

    kind: str
    size: tuple[float, ...]
    centre: Points = field(default_factory=lambda: frozen(np.zeros(3)))
    rotation: Points = field(default_factory=lambda: frozen(np.eye(3)))
    shape: Mesh | None = None

    def __post_init__(self) -> None:
        lengths = np.abs([*self.size, *np.ravel(self.centre)])
        if not (lengths <= MAX_LENGTH).all():
            raise InputError(f"a {self.kind} must be within {MAX_LENGTH:g}, got {lengths.max():g}")

    def distance(self, points: ArrayLike) -> Points:
        """Compute the exact signed distance of points from the surface. points (n, 3) -> (n,)."""
        local = (np.asarray(points, dtype=np.float64) - self.centre) @ self.rotation
        if self.kind == "mesh":
            return self._search.signed_distance(local)
        return _DISTANCES[self.kind](local, self.size)

    def scaled(self, factor: float) -> Solid:
        """Scale the solid by `factor` about the origin."""
        shape = self.shape and Mesh(factor * self.shape.vertices, self.shape.faces)
        size = tuple(factor * length for length in self.size)
        return replace(self, size=size, centre=frozen(factor * self.centre), shape=shape)

    @cached_property
    def outline(self) -> Mesh:
        """Surface as triangles, which approximate round solids."""
        local = self.shape or _tessellated(self.kind, self.size)
        return Mesh(local.vertices @ self.rotation.T + self.centre, local.faces)

    @property
    def is_flat(self) -> bool:
        """Whether `outline` is exact."""
        return self.kind in ("box", "mesh")

    @property
    def reach(self) -> float:
        """Radius of the bounding ball about the origin."""
        if self.kind == "sphere":
            return float(np.linalg.norm(self.centre)) + self.size[0]
        if self.kind == "capsule":
            half_axis = self.size[1] * self.rotation[:, 2]
            ends = np.linalg.norm([self.centre - half_axis, self.centre + half_axis], axis=1)
            return float(ends.max()) + self.size[0]
        return float(np.linalg.norm(self.outline.vertices, axis=1).max())

    def outside_ball(self, points: Points) -> Points:
        """Compute the distance of points from the bounding ball, a lower bound of `distance`."""
        centre, radius = self._ball
        return np.asarray(np.linalg.norm(points - centre, axis=1) - radius)

    @cached_property
    def _ball(self) -> tuple[Points, float]:
        if self.shape is None:
            return self.centre, sum(self.size)
        vertices = self.outline.vertices
        centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        return centre, float(np.linalg.norm(vertices - centre, axis=1).max())

    @cached_property
    def _search(self) -> TriangleSearch:
        return TriangleSearch(self.outline if self.shape is None else self.shape)


def ball(radius: float, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Solid:
    """Make a ball."""
    return Solid("sphere", (float(radius),), frozen(centre))


def coarse_ball() -> Mesh:
    """Make a mesh of a unit ball with few triangles, for drawing many balls."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, _COARSE_VERTICES // 2 + 1)
    return revolved(np.column_stack([np.cos(angle), np.sin(angle)]), _COARSE_VERTICES)


def capsule(radius: float, start: ArrayLike, end: ArrayLike) -> Solid:
    """Make a capsule: all points within `radius` of the segment from `start` to `end`."""
    first, last = frozen(start), frozen(end)
    length = float(np.linalg.norm(last - first))
    rotation = frozen(frames_along((last - first) / length))
    return Solid("capsule", (float(radius), length / 2), frozen((first + last) / 2), rotation)


def cylinder(radius: float, half_length: float) -> Solid:
    """Make a cylinder along the z axis, centred at the origin."""
    return Solid("cylinder", (float(radius), float(half_length)))


def box(half_edges: Sequence[float], centre: ArrayLike = (0.0, 0.0, 0.0)) -> Solid:
    """Make a box aligned with the axes."""
    x, y, z = half_edges
    return Solid("box", (float(x), float(y), float(z)), frozen(centre))


def mesh(surface: Mesh) -> Solid:
    """Make a solid from a closed mesh whose triangles are oriented outwards."""
    return Solid("mesh", (), shape=surface)


def union_distance(solids: Sequence[Solid], points: ArrayLike) -> Points:
    """Compute the signed distance of points from a union of solids. Returns (n,)."""
    points = np.asarray(points, dtype=np.float64)
    found = np.full(len(points), np.inf)
    # Meshes are last: their search is slow, and most are then known to be too far away.
    for solid in sorted(solids, key=lambda solid: solid.kind == "mesh"):
        near = solid.kind != "mesh" or solid.outside_ball(points) < found
        if np.all(near):
            np.minimum(found, solid.distance(points), out=found)
        else:
            found[near] = np.minimum(found[near], solid.distance(points[near]))
    return found


def surface_normals(solids: Sequence[Solid], points: ArrayLike) -> Points:
    """Compute the normalised gradient of the distance: the outward normal on the surface.

    points (n, 3) -> (n, 3).
    """
    points = np.asarray(points, dtype=np.float64)
    step = _GRADIENT_STEP * max(solid.reach for solid in solids)
    shifted = np.stack([points + s * axis for axis in np.eye(3) for s in (step, -step)])
    distances = union_distance(solids, shifted.reshape(-1, 3)).reshape(3, 2, -1)
    gradient = (distances[:, 0] - distances[:, 1]).T
    # The gradient can vanish on the medial axis, where any direction is valid.
    gradient[~gradient.any(axis=1)] = [0, 0, 1]
    return np.asarray(gradient / np.linalg.norm(gradient, axis=1, keepdims=True))


def project(solids: Sequence[Solid], points: ArrayLike) -> Points:
    """Project points along the normals onto the surface, shape (n, 3)."""
    moved = np.array(points, dtype=np.float64)
    for _ in range(_N_PROJECTIONS):
        moved -= union_distance(solids, moved)[:, None] * surface_normals(solids, moved)
    return moved


def _capsule_distance(points: Points, size: tuple[float, ...]) -> Points:
    along = np.clip(points[:, 2], -sum(size[1:]), sum(size[1:]))  # 0 for a ball
    axis = np.column_stack([np.zeros((len(points), 2)), along])
    return np.asarray(np.linalg.norm(points - axis, axis=1) - size[0])


def _cylinder_distance(points: Points, size: tuple[float, ...]) -> Points:
    beyond = np.column_stack(
        [np.linalg.norm(points[:, :2], axis=1) - size[0], np.abs(points[:, 2]) - size[1]]
    )
    return _from_slabs(beyond)


def _from_slabs(beyond: Points) -> Points:
    """Combine the distances beyond faces that meet at right angles, shape (n, faces)."""
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
    return np.asarray(outside + np.minimum(beyond.max(axis=1), 0))


_DISTANCES: dict[str, Callable[[Points, tuple[float, ...]], Points]] = {
    "sphere": _capsule_distance,
    "capsule": _capsule_distance,
    "cylinder": _cylinder_distance,
    "box": lambda points, size: _from_slabs(np.abs(points) - size),
}


def _tessellated(kind: str, size: tuple[float, ...]) -> Mesh:
    if kind == "box":
        corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, 8).T
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
        return Mesh(corners * np.array(size), np.array(faces))
    return revolved(_profile(kind, size))


def _profile(kind: str, size: tuple[float, ...]) -> Points:
    """Return the outline (radius, height) of a solid of revolution, from the lower pole up."""
    radius = size[0]
    if kind == "cylinder":
        return np.array([(0, -size[1]), (radius, -size[1]), (radius, size[1]), (0, size[1])])
    quarter = np.linspace(-np.pi / 2, 0, _CIRCLE_VERTICES // 4 + 1)
    lower = radius * np.column_stack([np.cos(quarter), np.sin(quarter)])
    half_axis = size[1] if kind == "capsule" else 0.0
    upper = lower[::-1] * [1, -1]
    # The equator of a ball belongs to both halves; a capsule has two equators.
    return np.vstack([lower - [0, half_axis], (upper if half_axis else upper[1:]) + [0, half_axis]])


def revolved(profile: ArrayLike, n_around: int = _CIRCLE_VERTICES) -> Mesh:
    """Revolve an outline (radius, height) about the z axis into a closed mesh. profile (P, 2).

    The outline runs from the lower pole to the upper one.
    """
    outline = np.asarray(profile, dtype=np.float64)
    radius, height = np.hsplit(outline[1:-1], 2)
    angle = 2 * np.pi * np.arange(n_around) / n_around
    circles = np.broadcast_arrays(radius * np.cos(angle), radius * np.sin(angle), height)
    vertices = np.stack(circles, axis=-1).reshape(-1, 3)
    index = np.arange(len(vertices)).reshape(-1, n_around)
    low, high = index[:-1], index[1:]
    after_low, after_high = (np.roll(circle, -1, axis=1) for circle in (low, high))
    faces = [
        np.stack([low, after_low, after_high], axis=-1).reshape(-1, 3),
        np.stack([low, after_high, high], axis=-1).reshape(-1, 3),
    ]
    south, north = (np.full(n_around, len(vertices) + pole) for pole in (0, 1))
    first = np.stack([south, np.roll(index[0], -1), index[0]], axis=1)
    last = np.stack([north, index[-1], np.roll(index[-1], -1)], axis=1)
    poles = [[0, 0, outline[0, 1]], [0, 0, outline[-1, 1]]]
    return Mesh(np.vstack([vertices, poles]), np.vstack([first, *faces, last]))


def sample_surface(
    solids: Sequence[Solid], n_points: int, rng: np.random.Generator
) -> tuple[Points, Points]:
    """Draw points uniformly from the surface of a union of solids. Returns (n_points, 3)."""
    areas = np.array([areas_of(solid.outline.corners).sum() for solid in solids])
    depth = _ROUNDING * max(solid.reach for solid in solids)
    found: list[tuple[Points, Points]] = []
    n_found = 0
    for _ in range(_MAX_ROUNDS):
        counts = rng.multinomial(n_points, areas / areas.sum())
        drawn = [
            _sample_solid(solid, int(count), rng)
            for solid, count in zip(solids, counts, strict=True)
            if count
        ]
        points, normals = (np.vstack(parts) for parts in zip(*drawn, strict=True))
        exposed = np.ones(len(points), dtype=np.bool_)
        for solid in solids if len(solids) > 1 else ():
            (near,) = np.nonzero(exposed & (solid.outside_ball(points) < 0))
            exposed[near] = solid.distance(points[near]) >= -depth
        points, normals = points[exposed], normals[exposed]
        found.append((points, normals))
        n_found += len(points)
        if n_found >= n_points:
            points, normals = (np.vstack(parts) for parts in zip(*found, strict=True))
            chosen = rng.permutation(n_found)[:n_points]
            return points[chosen], normals[chosen]
    raise InputError("the solids have no exposed surface: each lies inside another")


def _sample_solid(solid: Solid, n_points: int, rng: np.random.Generator) -> tuple[Points, Points]:
    """Draw points and normals from the surface of one solid."""
    points, normals = sample_triangles(solid.outline.corners, n_points, rng)
    if solid.is_flat:
        return points, normals
    if solid.kind == "sphere":
        local = points - solid.centre
        local /= np.linalg.norm(local, axis=1, keepdims=True)
        return local * solid.size + solid.centre, local
    points = project([solid], points)
    return points, surface_normals([solid], points)


def spread(
    solids: Sequence[Solid], n_sensors: int, rng: np.random.Generator, on: Chosen | None = None
) -> tuple[Points, Points]:
    """Spread sensors evenly over the surface of solids, at points that a function accepts.

    Returns points, normals (n_sensors, 3): a maximal Poisson-disc sample, chosen from random
    candidates by farthest-point sampling (Gonzalez 1985, doi:10.1016/0304-3975(85)90224-5), so that
    no two sensors are closer than the covering radius.
    """
    points, normals = sample_surface(solids, _CANDIDATES_PER_SENSOR * n_sensors, rng)
    if on is not None:
        allowed = on(points)
        points, normals = points[allowed], normals[allowed]
    if len(points) < n_sensors:
        raise InputError(f"the surface is too small for {n_sensors} sensors")
    chosen = np.empty(n_sensors, dtype=np.intp)
    nearest = np.full(len(points), np.inf)
    chosen[0] = 0
    for i in range(1, n_sensors):
        distances = np.linalg.norm(points - points[chosen[i - 1]], axis=1)
        np.minimum(nearest, distances, out=nearest)
        chosen[i] = np.argmax(nearest)
    return points[chosen], normals[chosen]
