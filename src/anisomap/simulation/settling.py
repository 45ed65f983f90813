"""How far a thing comes down on a body before it touches it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.simulation.paths import Skin, Wandering
from anisomap.simulation.solids import Points, Solid


def settle(
    skin: Skin,
    path: Wandering,
    offsets: Points,
    radii: NDArray[np.float64],
    depths: NDArray[np.float64],
    axes: Points | None = None,
) -> NDArray[np.float64]:
    """Bring a rigid cluster of balls or capsules down along the normals of a path.

    Parameters
    ----------
    skin : Skin
    path : Wandering
    offsets : ndarray of shape (T, B, 3)
        Where the middle of each ball or capsule is from the middle of the cluster.
    radii : ndarray of shape (B,)
    depths : ndarray of shape (T,)
        How deep the deepest of them may reach into the body. Less than each radius.
    axes : ndarray of shape (T, B, 3), optional
        From the middle of each capsule to the end of its segment; across the normals. Balls unless
        given.

    Returns
    -------
    ndarray of shape (T,)
        How high the middle of the cluster is above the point of the path, along the normal. What
        stands in the way is the whole body, as densely as `Skin` samples it: on the paper's sphere
        that is to within some thousandths of the radius.
    """
    ground = KDTree(skin.points)
    lengths = np.zeros(offsets.shape[:2]) if axes is None else np.linalg.norm(axes, axis=2)
    extents = (np.linalg.norm(offsets, axis=2) + lengths + radii).max(axis=1)
    below = ground.query_ball_point(path.points, extents)
    heights = np.empty(len(offsets))
    for t, stones in enumerate(below):
        normal = path.normals[t]
        points = np.vstack([skin.points[stones], path.points[t]]) - path.points[t]
        from_middle = points[:, None] - offsets[t]
        up = from_middle @ normal
        across = from_middle - up[..., None] * normal
        if axes is not None:
            across -= _nearest_on_axes(across, axes[t])
        room = (radii - depths[t]) ** 2 - np.einsum("sbd,sbd->sb", across, across)
        touching = up + np.sqrt(np.maximum(room, 0))
        heights[t] = np.max(touching, where=room > 0, initial=-depths[t])
    return heights


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
