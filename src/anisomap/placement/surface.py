"""A map on the surface of a mesh: its handedness, and the nearest points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.numerics.kriging import Kernel
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.surfaces import TriangleSearch
from anisomap.scene import Mesh

# Tuned on rubbed spheres, cylinders, y-shapes, tori, cubes, hands and tubes, seeds 201 and 202.
_INDEPENDENT = 20.0  # independent errors of a map, which are correlated between neighbours
_ANCHOR_WEIGHT = 3.0  # of an anchor against the nearest point of a sensor, to compare hands
_MAX_ITERATIONS = 60  # of iterated closest points
_CONVERGED = 1e-4  # largest step, in sizes of the map
# Fields of displacements that bend a map to a surface: reaches in sizes of the map, and variance of
# the noise relative to that of the field. Fields of shorter reach move sensors along the surface.
_BEND_REACHES, _BEND_NOISE = (4.0, 2.0, 1.0), 0.1
_BEND_ANCHOR_WEIGHT = 10.0  # of an anchor against the nearest point; 3 to 30 give equal results
_BEND_ITERATIONS, _BEND_CONVERGED = 25, 1e-3  # the largest step, in sizes of the map
# Points drawn on the mesh, about 1 % of its size apart: far less than the distances compared.
_N_SAMPLES = 20_000
_MAX_COORDINATE = 1e75  # m; the square of an area, the fourth power of a length, is finite


class Surface:
    """A mesh, searched exactly or, faster, among points drawn on it.

    mesh: In metres.
    """

    def __init__(self, mesh: Mesh) -> None:
        corners = mesh.vertices[mesh.faces]
        if not len(corners) or not np.isfinite(corners).all():
            raise InputError("a mesh must have triangles with finite vertices")
        if np.abs(corners).max() > _MAX_COORDINATE:
            raise InputError(f"coordinates of a mesh must be at most {_MAX_COORDINATE:g} m")
        doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.linalg.norm(doubled, axis=1)
        if not areas.sum() > 0:
            raise InputError("the triangles of a mesh must have an area")
        rng = np.random.default_rng(0)  # fixed: one mesh is always searched alike
        drawn = rng.choice(len(areas), _N_SAMPLES, p=areas / areas.sum())
        # Uniform on a triangle: Osada et al. (2002), ACM Trans. Graphics 21(4): 807-832.
        root, along = np.sqrt(rng.random(_N_SAMPLES)), rng.random(_N_SAMPLES)
        weights = np.stack([1 - root, root * (1 - along), root * along])
        self._points = np.einsum("cs,scd->sd", weights, corners[drawn])
        self._normals = doubled[drawn] / areas[drawn, None]
        self._tree = KDTree(self._points)
        self._search = TriangleSearch(mesh)

    def nearest(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Find the nearest points on the mesh, and the normals there, both of shape (n, 3)."""
        return self._search.nearest(points)

    def nearly_nearest(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Project points onto the planes of the nearest drawn points, shape (n, 3)."""
        found = np.asarray(self._tree.query(points)[1])
        normals = self._normals[found]
        height = np.einsum("nd,nd->n", points - self._points[found], normals)
        return np.asarray(points - height[:, None] * normals)


def surface_evidence(
    positions: NDArray[np.float64],
    sensors: NDArray[np.intp],
    targets: NDArray[np.float64],
    surface: Surface,
) -> float:
    """Compare how well a map and its mirror image fit a surface.

    positions (N, 3), targets (n, 3).

    Besl & McKay (1992), IEEE Trans. PAMI 14(2): 239-256, from the fit to the anchors.
    """
    size = float(np.sqrt(np.sum(np.var(targets, axis=0))))
    misfits = [_misfit(positions, sensors, targets, surface, hand) for hand in (False, True)]
    same, mirrored = np.maximum(misfits, np.finfo(float).eps * size)
    return float(_INDEPENDENT * np.log(mirrored / same))


def check_near_surface(
    positions: NDArray[np.float64], errors: NDArray[np.float64], surface: Surface
) -> None:
    """Check that placed sensors are near a surface, before a map is bent to it.

    positions (N, 3), errors (N,).
    """
    off = np.linalg.norm(surface.nearest(positions)[0] - positions, axis=1)
    if np.median(off - errors) > 0:
        raise InputError(
            f"the placed map is {np.median(off):.3g} m off the mesh (median), farther than its "
            f"error of {np.median(errors):.3g} m; check the unit and frame of the mesh, and map "
            "curved skins in 3D"
        )


def fit_to_surface(
    positions: NDArray[np.float64],
    sensors: NDArray[np.intp],
    targets: NDArray[np.float64],
    surface: Surface,
    *,
    reflection: bool,
    anchor_weight: float | None = None,
) -> NDArray[np.float64]:
    """Fit a similarity to anchors and to the nearest points of a surface. Returns (N, 3)."""
    n_sensors = len(positions)
    weights = np.ones(n_sensors)
    weights[sensors] = n_sensors / len(sensors) if anchor_weight is None else anchor_weight
    placed = fit_similarity(positions[sensors], targets, reflection=reflection).apply(positions)
    size = float(np.ptp(placed))
    for _ in range(_MAX_ITERATIONS):
        goal = surface.nearly_nearest(placed)
        goal[sensors] = targets
        before = placed
        placed = fit_similarity(positions, goal, weights, reflection=reflection).apply(positions)
        if np.abs(placed - before).max() < _CONVERGED * size:
            break
    return placed


def bend_to_surface(
    placed: NDArray[np.float64],
    sensors: NDArray[np.intp],
    targets: NDArray[np.float64],
    surface: Surface,
) -> NDArray[np.float64]:
    """Bend a placed map smoothly to a surface and to its anchors.

    placed (N, 3) -> (N, 3).

    Maps are distorted smoothly, so the nearest points of the surface tell the field, as in
    non-rigid iterated closest points (Amberg, Romdhani & Vetter 2007,
    doi:10.1109/CVPR.2007.383165). Here the field is a Gaussian process of which the reach shrinks.
    """
    size = float(np.sqrt(np.sum(np.var(placed, axis=0))))
    noise = np.full(len(placed), _BEND_NOISE)
    noise[sensors] = _BEND_NOISE / _BEND_ANCHOR_WEIGHT
    bent = placed
    for reach in _BEND_REACHES:
        covariance = Kernel(reach * size, _BEND_NOISE).between(placed, placed)
        factor = cho_factor(covariance + np.diag(noise))
        for _ in range(_BEND_ITERATIONS):
            goal = surface.nearly_nearest(bent)
            goal[sensors] = targets
            before = bent
            bent = placed + covariance @ cho_solve(factor, goal - placed)
            if np.abs(bent - before).max() < _BEND_CONVERGED * size:
                break
    return np.asarray(bent)


def _misfit(
    positions: NDArray[np.float64],
    sensors: NDArray[np.intp],
    targets: NDArray[np.float64],
    surface: Surface,
    reflection: bool,
) -> float:
    """Return the weighted RMS distance from the surface and the anchors."""
    placed = fit_to_surface(
        positions,
        sensors,
        targets,
        surface,
        reflection=reflection,
        anchor_weight=_ANCHOR_WEIGHT,
    )
    goal = surface.nearly_nearest(placed)
    goal[sensors] = targets
    weights = np.ones(len(positions))
    weights[sensors] = _ANCHOR_WEIGHT
    squares = np.sum((placed - goal) ** 2, axis=1)
    return float(np.sqrt(weights @ squares / weights.sum()))
