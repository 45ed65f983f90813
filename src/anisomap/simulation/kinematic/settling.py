"""How far a thing comes down on a body before it touches it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.simulation.bodies.body import Body
from anisomap.simulation.geometry.solids import Points, Solid
from anisomap.simulation.kinematic.paths import Skin, Wandering

_ROUNDING = 1e-9  # of a radius
_ALONG = 9

CLEAR = 1.5
"""How high a thing lifts off, in detection radii: nothing is in range there."""


@dataclass(frozen=True, eq=False)
class Cluster:
    """Balls or capsules that move together.

    Attributes
    ----------
    offsets : ndarray of shape (T, B, 3)
        Where the middle of each is from the middle of the cluster, in each frame.
    radii : ndarray of shape (B,)
    axes : ndarray of shape (T, B, 3), optional
        From the middle of each capsule to the end of its segment; across the normals. None of
        balls.
    """

    offsets: Points
    radii: NDArray[np.float64]
    axes: Points | None = None

    def placed(self, path: Wandering, heights: NDArray[np.float64]) -> Points:
        """Give the middle of each ball or capsule, heights (T,) above a path; (T, B, 3)."""
        middle = path.points + heights[:, None] * path.normals
        return np.asarray(middle[:, None] + self.offsets)


def settle(
    body: Body, skin: Skin, path: Wandering, cluster: Cluster, depths: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Bring a cluster down along the normals of a path until it touches.

    Parameters
    ----------
    body : Body
    skin : Skin
    path : Wandering
        Of that body.
    cluster : Cluster
    depths : ndarray of shape (T,)
        How deep the deepest ball or capsule may reach into the body. Less than each radius.

    Returns
    -------
    ndarray of shape (T,)
        How high the middle of the cluster is above the point of the path, along the normal: the
        lowest place where nothing is deeper in the body than that. The whole body stands in the
        way, first as densely as `Skin` samples it, then by its exact distance (of capsules, that
        of some points along the axis).
    """
    ground = KDTree(skin.points)
    away = np.linalg.norm(cluster.offsets, axis=2)
    if cluster.axes is not None:
        away += np.linalg.norm(cluster.axes, axis=2)
    extents = (away + cluster.radii).max(axis=1)
    lowest = (cluster.radii - np.einsum("tbd,td->tb", cluster.offsets, path.normals)).min(axis=1)
    heights = np.asarray(lowest - depths, dtype=np.float64)
    for t, (point, normal) in enumerate(zip(path.points, path.normals, strict=True)):
        rise, may_sink = np.inf, True
        while may_sink or rise > _ROUNDING * extents[t]:
            middle = point + heights[t] * normal
            stones = ground.query_ball_point(middle, extents[t])
            around = np.vstack([skin.points[stones], point]) - middle
            rise = _rise(cluster, t, around, normal, depths[t])
            heights[t] += rise if may_sink else max(rise, 0.0)
            may_sink = False
    return heights + _too_deep(body, path, cluster, heights, depths)


def _too_deep(
    body: Body,
    path: Wandering,
    cluster: Cluster,
    heights: NDArray[np.float64],
    depths: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Tell by how much a cluster is too deep in a body, where it stands between samples; (T,)."""
    points = cluster.placed(path, heights)[:, :, None]
    if cluster.axes is not None:
        points = points + np.linspace(-1, 1, _ALONG)[:, None] * cluster.axes[:, :, None]
    clear = body.distance(points.reshape(-1, 3)).reshape(points.shape[:3]).min(axis=2)
    return np.asarray(np.maximum((cluster.radii - clear).max(axis=1) - depths, 0))


def _rise(cluster: Cluster, frame: int, points: Points, normal: Points, depth: float) -> float:
    """Tell how far a cluster must rise to rest on the points, about its middle, in or below it."""
    from_middle = points[:, None] - cluster.offsets[frame]
    up = from_middle @ normal
    across = from_middle - up[..., None] * normal
    if cluster.axes is not None:
        across -= _nearest_on_axes(across, cluster.axes[frame])
    room = (cluster.radii - depth) ** 2 - np.einsum("sbd,sbd->sb", across, across)
    half = np.sqrt(np.maximum(room, 0))
    tops = (up + half)[up < half - _ROUNDING * cluster.radii]
    return float(tops.max()) if tops.size else 0.0


def _nearest_on_axes(points: Points, axes: Points) -> Points:
    along = np.einsum("sbd,bd->sb", points, axes) / np.einsum("bd,bd->b", axes, axes)
    return np.asarray(np.clip(along, -1, 1)[..., None] * axes)


def support(solids: Sequence[Solid], directions: Points) -> NDArray[np.float64]:
    """Tell how far solids reach in directions: the support function of them all.

    Parameters
    ----------
    solids : sequence of Solid
    directions : ndarray of shape (T, 3)
        Unit vectors.

    Returns
    -------
    ndarray of shape (T,)
        The greatest ``x @ direction`` of all their points ``x``; exact for every kind.
    """
    return np.asarray(np.max([_reaches(solid, directions) for solid in solids], axis=0))


def _reaches(solid: Solid, directions: Points) -> NDArray[np.float64]:
    middle = directions @ solid.centre
    own = directions @ solid.rotation
    size = solid.size
    if solid.kind == "mesh":
        return np.asarray((directions @ solid.outline.vertices.T).max(axis=1))
    if solid.kind == "box":
        return np.asarray(middle + np.abs(own) @ np.array(size))
    if solid.kind == "sphere":
        return np.asarray(middle + size[0])
    ends = middle + size[1] * np.abs(own[:, 2])
    if solid.kind == "capsule":
        return np.asarray(ends + size[0])
    return np.asarray(ends + size[0] * np.hypot(own[:, 0], own[:, 1]))
