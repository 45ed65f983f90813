"""Fits of maps to the surface of a mesh, and the handedness that they imply."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.numerics.neighbours import Kernel
from anisomap.numerics.procrustes import extent, fit_similarity
from anisomap.numerics.surfaces import Mesh, Points, TriangleSearch, areas_of, sample_triangles
from anisomap.placement.handedness import Tied
from anisomap.sensor_map import MAX_COORDINATE

# Tuned on rubbed spheres, cylinders, y-shapes, tori, cubes, hands and tubes, seeds 201 and 202.
_INDEPENDENT = 20.0  # number of independent errors of a map; errors of neighbours are correlated
_ANCHOR_WEIGHT = 3.0  # of an anchor relative to a nearest point, in comparisons of hands
_MAX_ITERATIONS = 60  # of iterated closest points
_CONVERGED = 1e-4  # largest step, in sizes of the map
# Fields of displacements that bend a map to a surface: reaches in sizes of the map, and relative
# variance of the noise. Fields of shorter reach move sensors along the surface.
_BEND_REACHES, _BEND_NOISE = (4.0, 2.0, 1.0), 0.1
_BEND_ANCHOR_WEIGHT = 10.0  # of an anchor relative to a nearest point; 3 to 30 give equal results
_BEND_ITERATIONS, _BEND_CONVERGED = 25, 1e-3  # the largest step, in sizes of the map
# Points drawn on the mesh, at distances of about 1 % of its size, far less than those compared.
_N_SAMPLES = 20_000


class Surface:
    """A mesh with an exact search, and a faster search among points drawn on the mesh.

    mesh: In metres.
    """

    def __init__(self, mesh: Mesh) -> None:
        corners = mesh.corners
        if not len(corners) or not np.isfinite(corners).all():
            raise InputError("a mesh must have triangles with finite vertices")
        if np.abs(corners).max() > MAX_COORDINATE:
            raise InputError(f"coordinates of a mesh must be at most {MAX_COORDINATE:g} m")
        if not areas_of(corners).sum() > 0:
            raise InputError("the triangles of a mesh must have an area")
        rng = np.random.default_rng(0)  # fixed, for reproducible searches
        self._points, self._normals = sample_triangles(corners, _N_SAMPLES, rng)
        self._tree = KDTree(self._points)
        self.nearest = TriangleSearch(mesh).nearest

    def goal(self, placed: Points, tied: Tied) -> Points:
        """Return positions of anchors, and other sensors on planes of nearest drawn points."""
        found = np.asarray(self._tree.query(placed)[1])
        normals = self._normals[found]
        height = np.einsum("nd,nd->n", placed - self._points[found], normals)
        projected = np.asarray(placed - height[:, None] * normals)
        projected[tied.sensors] = tied.targets
        return projected


def surface_evidence(tied: Tied, surface: Surface) -> float:
    """Return the log likelihood ratio of a map and its mirror image, by fits to a surface.

    Besl & McKay (1992), IEEE Trans. PAMI 14(2): 239-256, starting from the fit to the anchors.
    """
    misfits = []
    weights = np.ones(len(tied.positions))
    weights[tied.sensors] = _ANCHOR_WEIGHT
    for hand in (False, True):
        placed = fit_to_surface(tied, surface, reflection=hand, anchor_weight=_ANCHOR_WEIGHT)
        squares = np.sum((placed - surface.goal(placed, tied)) ** 2, axis=1)
        misfits.append(float(np.sqrt(weights @ squares / weights.sum())))
    same, mirrored = np.maximum(misfits, np.finfo(float).eps * extent(tied.targets))
    return float(_INDEPENDENT * np.log(mirrored / same))


def check_near_surface(positions: Points, errors: NDArray[np.float64], surface: Surface) -> None:
    """Check that placed sensors are near a surface, before bending."""
    off = np.linalg.norm(surface.nearest(positions)[0] - positions, axis=1)
    if np.median(off - errors) > 0:
        raise InputError(
            f"the placed map is {np.median(off):.3g} m off the mesh (median), farther than its "
            f"error of {np.median(errors):.3g} m; check the unit and frame of the mesh, and map "
            "curved skins in 3D"
        )


def fit_to_surface(
    tied: Tied, surface: Surface, *, reflection: bool, anchor_weight: float | None = None
) -> Points:
    """Fit a similarity to anchors and to the nearest points of a surface. Returns (N, 3)."""
    positions, n_sensors = tied.positions, len(tied.positions)
    weights = np.ones(n_sensors)
    weights[tied.sensors] = anchor_weight or n_sensors / len(tied.sensors)
    placed = fit_similarity(tied.anchors, tied.targets, reflection=reflection).apply(positions)
    size = float(np.ptp(placed))
    for _ in range(_MAX_ITERATIONS):
        goal, before = surface.goal(placed, tied), placed
        placed = fit_similarity(positions, goal, weights, reflection=reflection).apply(positions)
        if np.abs(placed - before).max() < _CONVERGED * size:
            break
    return placed


def bend_to_surface(placed: Points, tied: Tied, surface: Surface) -> Points:
    """Bend a placed map, (N, 3), by a smooth field to a surface and to its anchors.

    Non-rigid iterated closest points (Amberg, Romdhani & Vetter 2007,
    doi:10.1109/CVPR.2007.383165), with Gaussian processes of decreasing reach.
    """
    size, noise = extent(placed), np.full(len(placed), _BEND_NOISE)
    noise[tied.sensors] = _BEND_NOISE / _BEND_ANCHOR_WEIGHT
    bent = placed
    for reach in _BEND_REACHES:
        covariance = Kernel(reach * size, _BEND_NOISE).between(placed, placed)
        factor = cho_factor(covariance + np.diag(noise))
        for _ in range(_BEND_ITERATIONS):
            goal, before = surface.goal(bent, tied), bent
            bent = placed + covariance @ cho_solve(factor, goal - placed)
            if np.abs(bent - before).max() < _BEND_CONVERGED * size:
                break
    return np.asarray(bent)
