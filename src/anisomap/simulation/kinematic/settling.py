"""Placement of a stimulus in contact with a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.simulation.bodies.body import Body
from anisomap.simulation.geometry.solids import Points, Solid
from anisomap.simulation.kinematic.paths import StrokePath, SurfaceSample

_TOLERANCE = 1e-9  # x radius
_N_AXIS_POINTS = 9

LIFT_HEIGHT = 1.5
"""Height of a lifted stimulus, x detection radius: out of range of all sensors."""


@dataclass(frozen=True, eq=False)
class Cluster:
    """Balls or capsules that move together.

    Attributes
    ----------
    offsets : ndarray of shape (T, B, 3)
        Position of each ball or capsule relative to the middle of the cluster, in each frame.
    radii : ndarray of shape (B,)
    axes : ndarray of shape (T, B, 3), optional
        From the middle of each capsule to one end of its segment, perpendicular to the normals of
        the path. None for balls.
    """

    offsets: Points
    radii: NDArray[np.float64]
    axes: Points | None = None

    def placed(self, path: StrokePath, heights: NDArray[np.float64]) -> Points:
        """Return the middle of each ball or capsule at heights (T,) above a path; (T, B, 3)."""
        middle = path.points + heights[:, None] * path.normals
        return np.asarray(middle[:, None] + self.offsets)


def settle(
    body: Body,
    sample: SurfaceSample,
    path: StrokePath,
    cluster: Cluster,
    depths: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Lower a cluster along the normals of a path until it is in contact with the body.

    Parameters
    ----------
    body : Body
    sample : SurfaceSample
        Of the same body.
    path : StrokePath
        On the same body.
    cluster : Cluster
    depths : ndarray of shape (T,)
        Depth of the deepest ball or capsule in the body, less than each radius.

    Returns
    -------
    ndarray of shape (T,)
        Height of the middle of the cluster above the path, along the normal: the lowest at which
        nothing is deeper in the body than `depths`. Contact is found with the sampled surface of
        the whole body, then corrected by exact distances (for capsules, at points along the axis).
    """
    surface = KDTree(sample.points)
    extents = np.linalg.norm(cluster.offsets, axis=2)
    if cluster.axes is not None:
        extents += np.linalg.norm(cluster.axes, axis=2)
    extents = (extents + cluster.radii).max(axis=1)
    lowest = (cluster.radii - np.einsum("tbd,td->tb", cluster.offsets, path.normals)).min(axis=1)
    heights = np.asarray(lowest - depths, dtype=np.float64)
    for t, (point, normal) in enumerate(zip(path.points, path.normals, strict=True)):
        rise, may_sink = np.inf, True
        while may_sink or rise > _TOLERANCE * extents[t]:
            middle = point + heights[t] * normal
            near = surface.query_ball_point(middle, extents[t])
            around = np.vstack([sample.points[near], point]) - middle
            rise = _required_rise(cluster, t, around, normal, depths[t])
            heights[t] += rise if may_sink else max(rise, 0.0)
            may_sink = False
    return heights + _excess_depth(body, path, cluster, heights, depths)


def _excess_depth(
    body: Body,
    path: StrokePath,
    cluster: Cluster,
    heights: NDArray[np.float64],
    depths: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the depth beyond `depths` by exact distances; shape (T,)."""
    points = cluster.placed(path, heights)[:, :, None]
    if cluster.axes is not None:
        points = points + np.linspace(-1, 1, _N_AXIS_POINTS)[:, None] * cluster.axes[:, :, None]
    clear = body.distance(points.reshape(-1, 3)).reshape(points.shape[:3]).min(axis=2)
    return np.asarray(np.maximum((cluster.radii - clear).max(axis=1) - depths, 0))


def _required_rise(
    cluster: Cluster, frame: int, points: Points, normal: Points, depth: float
) -> float:
    """Return the rise at which a cluster rests on points given relative to its middle."""
    from_middle = points[:, None] - cluster.offsets[frame]
    up = from_middle @ normal
    across = from_middle - up[..., None] * normal
    if cluster.axes is not None:
        across -= _nearest_on_axes(across, cluster.axes[frame])
    squared = (cluster.radii - depth) ** 2 - np.einsum("sbd,sbd->sb", across, across)
    half = np.sqrt(np.maximum(squared, 0))
    tops = (up + half)[up < half - _TOLERANCE * cluster.radii]
    return float(tops.max()) if tops.size else 0.0


def _nearest_on_axes(points: Points, axes: Points) -> Points:
    along = np.einsum("sbd,bd->sb", points, axes) / np.einsum("bd,bd->b", axes, axes)
    return np.asarray(np.clip(along, -1, 1)[..., None] * axes)


def support(solids: Sequence[Solid], directions: Points) -> NDArray[np.float64]:
    """Evaluate the support function of a union of solids.

    Parameters
    ----------
    solids : sequence of Solid
    directions : ndarray of shape (T, 3)
        Unit vectors.

    Returns
    -------
    ndarray of shape (T,)
        Maximum of ``x @ direction`` over all points ``x`` of the solids; exact for all kinds.
    """
    return np.asarray(np.max([_support_of_one(solid, directions) for solid in solids], axis=0))


def _support_of_one(solid: Solid, directions: Points) -> NDArray[np.float64]:
    middle = directions @ solid.centre
    local = directions @ solid.rotation
    size = solid.size
    if solid.kind == "mesh":
        return np.asarray((directions @ solid.outline.vertices.T).max(axis=1))
    if solid.kind == "box":
        return np.asarray(middle + np.abs(local) @ np.array(size))
    if solid.kind == "sphere":
        return np.asarray(middle + size[0])
    ends = middle + size[1] * np.abs(local[:, 2])
    if solid.kind == "capsule":
        return np.asarray(ends + size[0])
    return np.asarray(ends + size[0] * np.hypot(local[:, 0], local[:, 1]))
