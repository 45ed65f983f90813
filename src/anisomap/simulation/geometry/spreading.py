"""Points spread over the surface of solids."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.scene import Mesh
from anisomap.simulation.geometry.solids import Points, Solid, distance_to_all, outward, projected

Density = Callable[[Points], NDArray[np.float64] | NDArray[np.bool_]]

_CANDIDATES = 100  # a sensor; more make the spacing hardly more even
_ROUNDS = 50
_ROUNDING = 1e-9  # of the reach


def sample_surface(
    solids: Sequence[Solid], n_points: int, rng: np.random.Generator
) -> tuple[Points, Points]:
    """Draw points uniformly from the surface of solids taken together.

    Parameters
    ----------
    solids : sequence of Solid
    n_points : int
    rng : numpy.random.Generator

    Returns
    -------
    points, normals : ndarray of shape (n_points, 3)
        On the surface, where no other solid hides it, and its unit normals there.

    Raises
    ------
    InputError
        If there is next to no surface to be seen.
    """
    areas = np.array([_areas(solid.outline)[0].sum() for solid in solids])
    inside = -_ROUNDING * max(solid.reach for solid in solids)
    found: list[tuple[Points, Points]] = []
    n_found = 0
    for _ in range(_ROUNDS):
        shares = rng.multinomial(n_points, areas / areas.sum())
        drawn = [
            _on_solid(solid, int(share), rng)
            for solid, share in zip(solids, shares, strict=True)
            if share
        ]
        points, normals = (np.vstack(parts) for parts in zip(*drawn, strict=True))
        if len(solids) > 1:
            seen = distance_to_all(solids, points) >= inside
            points, normals = points[seen], normals[seen]
        found.append((points, normals))
        n_found += len(points)
        if n_found >= n_points:
            points, normals = (np.vstack(parts) for parts in zip(*found, strict=True))
            chosen = rng.permutation(n_found)[:n_points]
            return points[chosen], normals[chosen]
    raise InputError("the solids hide one another's surface, so that no sensor can be put on it")


def _on_solid(solid: Solid, n_points: int, rng: np.random.Generator) -> tuple[Points, Points]:
    """Draw points from a solid's surface; with its normals there."""
    doubled, cross = _areas(solid.outline)
    corners = solid.outline.vertices[solid.outline.faces]
    chosen = rng.choice(len(corners), size=n_points, p=doubled / doubled.sum())
    # The root spreads points evenly over a triangle (Osada et al. 2002, doi:10.1145/571647.571648).
    first, second = np.sqrt(rng.random(n_points)), rng.random(n_points)
    weights = np.column_stack([1 - first, first * (1 - second), first * second])
    points = np.einsum("nc,ncd->nd", weights, corners[chosen])
    if solid.is_flat:
        return points, cross[chosen] / doubled[chosen, None]
    points = projected([solid], points)
    return points, outward([solid], points)


def _areas(mesh: Mesh) -> tuple[NDArray[np.float64], Points]:
    """Give twice the area of each triangle, and the vector of that length out of it."""
    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return np.linalg.norm(cross, axis=1), np.asarray(cross)


def spread(
    solids: Sequence[Solid],
    n_sensors: int,
    rng: np.random.Generator,
    density: Density | None = None,
) -> tuple[Points, Points]:
    """Spread sensors evenly over the surface of solids: a maximal Poisson-disc sample.

    Parameters
    ----------
    solids : sequence of Solid
    n_sensors : int
    rng : numpy.random.Generator
    density : callable, optional
        Takes points (n, 3); gives how many times as densely sensors stand there as elsewhere, (n,),
        at least 0, and none where it is 0. Evenly unless given.

    Returns
    -------
    points, normals : ndarray of shape (n_sensors, 3)
        Of many points drawn at random, each next one is that furthest from those chosen before
        (Gonzalez 1985, doi:10.1016/0304-3975(85)90224-5). So there is a radius such that no two
        are nearer than it, and no place is further from all.
    """
    points, normals = sample_surface(solids, _CANDIDATES * n_sensors, rng)
    weight = np.ones(len(points)) if density is None else density(points)
    stretch = np.sqrt(np.asarray(weight, dtype=np.float64))
    points, normals, stretch = points[stretch > 0], normals[stretch > 0], stretch[stretch > 0]
    if len(points) < n_sensors:
        raise InputError(f"there is hardly any surface on which {n_sensors} sensors may stand")
    chosen = np.empty(n_sensors, dtype=np.intp)
    nearest = np.full(len(points), np.inf)
    chosen[0] = 0
    for i in range(1, n_sensors):
        away = np.linalg.norm(points - points[chosen[i - 1]], axis=1)
        np.minimum(nearest, away, out=nearest)
        chosen[i] = np.argmax(stretch * nearest)
    return points[chosen], normals[chosen]
