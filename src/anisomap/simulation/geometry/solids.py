"""Solids that bodies and what touches them are made of, with exact distances from their surfaces.

Each is a primitive that has a closed form, or a closed mesh of triangles. A distance is positive
outside and negative inside.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType, ModuleType
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError, MissingExtraError
from anisomap.scene import Mesh, frozen
from anisomap.simulation.geometry.triangles import TriangleSearch

Points: TypeAlias = NDArray[np.float64]

_ROUND = 48  # corners of a drawn circle
_COARSE = 16  # the same, where there are many
_SLOPE_STEP = 1e-5  # of the reach
_PROJECTIONS = 4


@dataclass(frozen=True, eq=False)
class Solid:
    """One solid; make it with `ball`, `capsule`, `cylinder`, `box` or `mesh`.

    Parameters
    ----------
    kind : str
        MuJoCo's word for it: ``"sphere"``, ``"capsule"``, ``"cylinder"``, ``"box"``, ``"mesh"``.
    size : tuple of float
        What MuJoCo takes as its size: radius; radius and half of the length of the axis; half of
        each edge.
    centre : ndarray of shape (3,)
        Where its middle is.
    rotation : ndarray of shape (3, 3)
        Columns are its own x, y and z; the axis of a capsule or cylinder is its z.
    shape : Mesh, optional
        Of a mesh, its triangles about `centre`.
    """

    kind: str
    size: tuple[float, ...]
    centre: Points = field(default_factory=lambda: frozen(np.zeros(3)))
    rotation: Points = field(default_factory=lambda: frozen(np.eye(3)))
    shape: Mesh | None = None

    def distance(self, points: ArrayLike) -> Points:
        """Measure how far points are from the surface.

        Parameters
        ----------
        points : array_like of shape (n, 3)

        Returns
        -------
        ndarray of shape (n,)
            Negative inside. Exact for every kind, inside and outside.
        """
        local = self.into_own_frame(points)
        if self.kind == "mesh":
            return self._search.signed_distance(local)
        return _DISTANCES[self.kind](local, self.size)

    def into_own_frame(self, points: ArrayLike) -> Points:
        """Express points in the solid's own frame, shape (n, 3)."""
        return np.asarray((np.asarray(points, dtype=np.float64) - self.centre) @ self.rotation)

    def moved(self, rotation: ArrayLike, centre: ArrayLike) -> Solid:
        """Turn it about the origin, then shift it."""
        turn = np.asarray(rotation, dtype=np.float64)
        return replace(
            self,
            centre=frozen(turn @ self.centre + np.asarray(centre)),
            rotation=frozen(turn @ self.rotation),
        )

    def scaled(self, factor: float) -> Solid:
        """Make it `factor` times as large, about the origin."""
        shape = self.shape and Mesh(factor * self.shape.vertices, self.shape.faces)
        size = tuple(factor * length for length in self.size)
        return replace(self, size=size, centre=frozen(factor * self.centre), shape=shape)

    @cached_property
    def outline(self) -> Mesh:
        """Its surface as triangles; round ones with flats that are smaller than one can see."""
        drawn = self.shape or _tessellated(self.kind, self.size)
        return Mesh(drawn.vertices @ self.rotation.T + self.centre, drawn.faces)

    @property
    def is_flat(self) -> bool:
        """Whether `outline` is its very surface, and not a drawing of something round."""
        return self.kind in ("box", "mesh")

    @property
    def reach(self) -> float:
        """Radius of a ball about the origin that holds it."""
        if self.kind == "sphere":
            return float(np.linalg.norm(self.centre)) + self.size[0]
        if self.kind == "capsule":
            half_axis = self.size[1] * self.rotation[:, 2]
            ends = np.linalg.norm([self.centre - half_axis, self.centre + half_axis], axis=1)
            return float(ends.max()) + self.size[0]
        return float(np.linalg.norm(self.outline.vertices, axis=1).max())

    @cached_property
    def _search(self) -> TriangleSearch:
        if self.shape is None:
            raise InputError(f"a solid of the kind {self.kind!r} must have a mesh as its shape")
        return TriangleSearch(self.shape)


def ball(radius: float, centre: ArrayLike = (0.0, 0.0, 0.0)) -> Solid:
    """Make a ball."""
    return Solid("sphere", (float(radius),), frozen(centre))


def drawn_ball() -> Mesh:
    """Give a ball of radius 1 for drawing in numbers, with few triangles."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, _COARSE // 2 + 1)
    return revolved(np.column_stack([np.cos(angle), np.sin(angle)]), _COARSE)


def capsule(radius: float, start: ArrayLike, end: ArrayLike) -> Solid:
    """Make a capsule: all points within `radius` of the segment from `start` to `end`."""
    first, last = frozen(start), frozen(end)
    length = float(np.linalg.norm(last - first))
    turned = frozen(turned_to((last - first) / length))
    return Solid("capsule", (float(radius), length / 2), frozen((first + last) / 2), turned)


def cylinder(radius: float, half_length: float) -> Solid:
    """Make a cylinder about the z axis, its middle in the origin."""
    return Solid("cylinder", (float(radius), float(half_length)))


def box(half_edges: Sequence[float], centre: ArrayLike = (0.0, 0.0, 0.0)) -> Solid:
    """Make a box along the axes."""
    x, y, z = half_edges
    return Solid("box", (float(x), float(y), float(z)), frozen(centre))


def mesh(vertices: ArrayLike, faces: ArrayLike) -> Solid:
    """Make a solid of triangles.

    Raises
    ------
    InputError
        If the triangles do not close, or have no area.
    MissingExtraError
        If trimesh is not installed.
    """
    surface = load_trimesh().Trimesh(vertices, faces, process=True)
    if not (len(surface.faces) and np.isfinite(surface.area) and surface.area > 0):
        raise InputError("the mesh has no area; it must be made of triangles that enclose a body")
    if not surface.is_watertight:
        # An edge of a closed surface has a triangle on either side.
        edges, sides = np.unique(surface.edges_sorted, axis=0, return_counts=True)
        raise InputError(
            f"the mesh is not closed: {int((sides != 2).sum())} of its {len(edges)} edges do not "
            "have exactly two triangles; fill its holes, or give sensors without a mesh"
        )
    surface.fix_normals(multibody=True)
    return Solid("mesh", (), shape=Mesh(surface.vertices, surface.faces))


def distance_to_all(solids: Sequence[Solid], points: ArrayLike) -> Points:
    """Measure how far points are from solids taken together.

    Returns
    -------
    ndarray of shape (n,)
        Exact outside; inside, where solids overlap, the surface may be further off than it says.
    """
    return np.asarray(np.min([solid.distance(points) for solid in solids], axis=0))


def outward(solids: Sequence[Solid], points: ArrayLike) -> Points:
    """Give the direction in which the distance grows fastest: on the surface, its normal.

    Parameters
    ----------
    solids : sequence of Solid
    points : array_like of shape (n, 3)

    Returns
    -------
    ndarray of shape (n, 3)
        Unit vectors, by central differences.
    """
    points = np.asarray(points, dtype=np.float64)
    step = _SLOPE_STEP * max(solid.reach for solid in solids)
    shifted = np.stack([points + s * axis for axis in np.eye(3) for s in (step, -step)])
    distances = distance_to_all(solids, shifted.reshape(-1, 3)).reshape(3, 2, -1)
    slope = (distances[:, 0] - distances[:, 1]).T
    # On an edge the slope can vanish: any direction is as good as another there.
    slope[~slope.any(axis=1)] = [0, 0, 1]
    return np.asarray(slope / np.linalg.norm(slope, axis=1, keepdims=True))


def projected(solids: Sequence[Solid], points: ArrayLike) -> Points:
    """Move points along the normals to the surface, shape (n, 3)."""
    moved = np.array(points, dtype=np.float64)
    for _ in range(_PROJECTIONS):
        moved -= distance_to_all(solids, moved)[:, None] * outward(solids, moved)
    return moved


def load_trimesh() -> ModuleType:
    """Import trimesh, which reads meshes and knows whether they close.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    try:
        return importlib.import_module("trimesh")
    except ImportError as error:
        raise MissingExtraError("simulating a mesh", "simulation") from error


def _ball_distance(points: Points, size: tuple[float, ...]) -> Points:
    return np.asarray(np.linalg.norm(points, axis=1) - size[0])


def _capsule_distance(points: Points, size: tuple[float, ...]) -> Points:
    along = np.clip(points[:, 2], -size[1], size[1])
    axis = np.column_stack([np.zeros((len(points), 2)), along])
    return np.asarray(np.linalg.norm(points - axis, axis=1) - size[0])


def _cylinder_distance(points: Points, size: tuple[float, ...]) -> Points:
    beyond = np.column_stack(
        [np.linalg.norm(points[:, :2], axis=1) - size[0], np.abs(points[:, 2]) - size[1]]
    )
    return _from_slabs(beyond)


def _box_distance(points: Points, size: tuple[float, ...]) -> Points:
    return _from_slabs(np.abs(points) - size)


def _from_slabs(beyond: Points) -> Points:
    """Combine how far points are beyond each of some faces that meet at right angles."""
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
    return np.asarray(outside + np.minimum(beyond.max(axis=1), 0))


_DISTANCES: Mapping[str, Callable[[Points, tuple[float, ...]], Points]] = MappingProxyType(
    {
        "sphere": _ball_distance,
        "capsule": _capsule_distance,
        "cylinder": _cylinder_distance,
        "box": _box_distance,
    }
)


def turned_to(axis: Points) -> Points:
    """Give a rotation whose third column is a unit vector."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])


def _tessellated(kind: str, size: tuple[float, ...]) -> Mesh:
    if kind == "box":
        corners = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij")).reshape(3, 8).T
        quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
        faces = [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]
        return Mesh(corners * np.array(size), np.array(faces))
    return revolved(_profile(kind, size))


def _profile(kind: str, size: tuple[float, ...]) -> Points:
    """Give the outline (radius, height) of a solid of turning, from its lower pole up."""
    radius = size[0]
    if kind == "cylinder":
        return np.array([(0, -size[1]), (radius, -size[1]), (radius, size[1]), (0, size[1])])
    quarter = np.linspace(-np.pi / 2, 0, _ROUND // 4 + 1)
    lower = radius * np.column_stack([np.cos(quarter), np.sin(quarter)])
    half_axis = size[1] if kind == "capsule" else 0.0
    upper = lower[::-1] * [1, -1]
    # A ball has one equator, a capsule two.
    return np.vstack([lower - [0, half_axis], (upper if half_axis else upper[1:]) + [0, half_axis]])


def revolved(profile: ArrayLike, n_around: int = _ROUND) -> Mesh:
    """Turn an outline about the z axis into a closed mesh.

    Parameters
    ----------
    profile : array_like of shape (P, 2)
        Radius and height; the first and last lie on the axis, no others.
    n_around : int
        Corners of each circle.
    """
    outline = np.asarray(profile, dtype=np.float64)
    angle = 2 * np.pi * np.arange(n_around) / n_around
    circles = np.stack(
        np.broadcast_arrays(
            outline[1:-1, :1] * np.cos(angle), outline[1:-1, :1] * np.sin(angle), outline[1:-1, 1:]
        ),
        axis=-1,
    )
    n_circles = len(circles)
    index = np.arange(n_circles * n_around).reshape(n_circles, n_around)
    after = np.roll(index, -1, axis=1)
    south, north = index.size, index.size + 1
    faces = [
        np.stack([np.full(n_around, south), after[0], index[0]], axis=1),
        np.stack([index[:-1], after[:-1], after[1:]], axis=-1).reshape(-1, 3),
        np.stack([index[:-1], after[1:], index[1:]], axis=-1).reshape(-1, 3),
        np.stack([np.full(n_around, north), index[-1], after[-1]], axis=1),
    ]
    poles = [[0, 0, outline[0, 1]], [0, 0, outline[-1, 1]]]
    return Mesh(np.vstack([circles.reshape(-1, 3), poles]), np.vstack(faces))
