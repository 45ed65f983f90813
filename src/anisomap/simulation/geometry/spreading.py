"""Random and evenly spread points on the surface of solids."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.scene import Mesh
from anisomap.simulation.geometry.solids import (
    Points,
    Solid,
    project,
    surface_normals,
    union_distance,
)

Density = Callable[[Points], NDArray[np.float64] | NDArray[np.bool_]]

_CANDIDATES_PER_SENSOR = 100  # more candidates barely make the spacing more even
_MAX_ROUNDS = 50  # of rejection sampling
_ROUNDING = 1e-9  # x reach


def sample_surface(
    solids: Sequence[Solid], n_points: int, rng: np.random.Generator
) -> tuple[Points, Points]:
    """Draw points uniformly from the surface of a union of solids.

    Parameters
    ----------
    solids : sequence of Solid
    n_points : int
    rng : numpy.random.Generator

    Returns
    -------
    points, normals : ndarray of shape (n_points, 3)
        Points on the surface and outside all other solids, and unit normals there.

    Raises
    ------
    InputError
        If nearly all of the surface is inside other solids.
    """
    areas = np.array([_doubled_areas(solid.outline)[0].sum() for solid in solids])
    inside = -_ROUNDING * max(solid.reach for solid in solids)
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
        if len(solids) > 1:
            exposed = union_distance(solids, points) >= inside
            points, normals = points[exposed], normals[exposed]
        found.append((points, normals))
        n_found += len(points)
        if n_found >= n_points:
            points, normals = (np.vstack(parts) for parts in zip(*found, strict=True))
            chosen = rng.permutation(n_found)[:n_points]
            return points[chosen], normals[chosen]
    raise InputError(
        "the solids have no exposed surface for sensors, since each lies inside another"
    )


def _sample_solid(solid: Solid, n_points: int, rng: np.random.Generator) -> tuple[Points, Points]:
    """Draw points and normals from the surface of one solid."""
    doubled, cross = _doubled_areas(solid.outline)
    corners = solid.outline.vertices[solid.outline.faces]
    chosen = rng.choice(len(corners), size=n_points, p=doubled / doubled.sum())
    # The root makes points uniform on a triangle (Osada et al. 2002, doi:10.1145/571647.571648).
    first, second = np.sqrt(rng.random(n_points)), rng.random(n_points)
    weights = np.column_stack([1 - first, first * (1 - second), first * second])
    points = np.einsum("nc,ncd->nd", weights, corners[chosen])
    if solid.is_flat:
        return points, cross[chosen] / doubled[chosen, None]
    points = project([solid], points)
    return points, surface_normals([solid], points)


def _doubled_areas(mesh: Mesh) -> tuple[NDArray[np.float64], Points]:
    """Return twice the area of each triangle, and its outward normal with that length."""
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
        Function of points (n, 3) that returns the relative density of sensors (n,), at least 0; no
        sensors are placed where it is 0 or False. Default: uniform.

    Returns
    -------
    points, normals : ndarray of shape (n_sensors, 3)
        Chosen from random candidates by farthest-point sampling (Gonzalez 1985,
        doi:10.1016/0304-3975(85)90224-5), so that no two are closer than the covering radius.

    Raises
    ------
    InputError
        If there is no surface, or hardly any, with positive density.
    """
    points, normals = sample_surface(solids, _CANDIDATES_PER_SENSOR * n_sensors, rng)
    weight = np.ones(len(points)) if density is None else density(points)
    stretch = np.sqrt(np.asarray(weight, dtype=np.float64))
    points, normals, stretch = points[stretch > 0], normals[stretch > 0], stretch[stretch > 0]
    if len(points) < n_sensors:
        raise InputError(f"the surface with positive density is too small for {n_sensors} sensors")
    chosen = np.empty(n_sensors, dtype=np.intp)
    nearest = np.full(len(points), np.inf)
    chosen[0] = 0
    for i in range(1, n_sensors):
        distances = np.linalg.norm(points - points[chosen[i - 1]], axis=1)
        np.minimum(nearest, distances, out=nearest)
        chosen[i] = np.argmax(stretch * nearest)
    return points[chosen], normals[chosen]
