"""Bodies with irregular, evenly spread sensors: maximal Poisson-disc samples of the surface.

These bodies are harder to map than the paper's: closed, with holes, thin, branching or unevenly
covered. Each has a reach of about 1 m. Positions are reproducible: they depend only on `n_sensors`,
a positive integer. Sensors cover the whole surface unless stated otherwise. All lengths (in m) were
chosen by hand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from anisomap.simulation import solids
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.bodies.lattice import (
    CYLINDER_LENGTH,
    CYLINDER_RADIUS,
    SPHERE_RADIUS,
    great_circles,
)
from anisomap.simulation.checks import COUNT
from anisomap.simulation.solids import Density, Solid, spread

TORUS_RADIUS, TORUS_TUBE = 0.75, 0.3
CUBE_EDGE = 1.4
HOLE_RADIUS, PLATE_RADIUS, PLATE_THICKNESS = 0.4, 1.0, 0.2
MAX_DENSITY = 8.0
"""Ratio of the densities of sensors at the two poles of the uneven sphere."""

_SEED = 20110  # arbitrary
_MESH_AROUND = 64  # vertices per circle
_FACE_MARGIN = 1e-9  # tolerance for points on a face


def torus(n_sensors: int = 120) -> Body:
    """Make a torus with evenly spread sensors."""
    angle = 2 * np.pi * np.arange(_MESH_AROUND // 2) / (_MESH_AROUND // 2)
    profile = np.column_stack(
        [TORUS_RADIUS + TORUS_TUBE * np.cos(angle), TORUS_TUBE * np.sin(angle)]
    )
    return covered("torus", [_ring(profile)], n_sensors)


def cube(n_sensors: int = 120) -> Body:
    """Make a cube with evenly spread sensors on all faces."""
    return covered("cube", [solids.box(3 * (CUBE_EDGE / 2,))], n_sensors)


def hemisphere(n_sensors: int = 80) -> Body:
    """Make a hemisphere with sensors on its dome and none on its flat side."""
    angle = np.linspace(0, np.pi / 2, _MESH_AROUND // 4 + 1)
    dome = SPHERE_RADIUS * np.column_stack([np.cos(angle), np.sin(angle)])
    dome[-1, 0] = 0
    half = solids.revolved(np.vstack([[0, 0], dome]), _MESH_AROUND)
    solid = solids.mesh(half.vertices - [0, 0, SPHERE_RADIUS / 2], half.faces)
    flat_side = -SPHERE_RADIUS / 2 + _FACE_MARGIN
    return covered("hemisphere", [solid], n_sensors, lambda points: points[:, 2] > flat_side)


def hand(n_sensors: int = 160) -> Body:
    """Make a hand with a palm, four fingers and a thumb, covered on all sides.

    Fingers are closer to one another in space than along the skin.
    """
    across = np.array([-0.36, -0.12, 0.12, 0.36])
    lengths = np.array([0.6, 0.72, 0.75, 0.55])
    fingers = [
        solids.capsule(0.1, (x, 0.2, 0), (1.5 * x, 0.2 + length, 0))
        for x, length in zip(across, lengths, strict=True)
    ]
    thumb = solids.capsule(0.12, (0.35, -0.45, 0), (0.85, -0.05, 0.1))
    palm = solids.box((0.46, 0.45, 0.12), (0, -0.25, 0))
    return covered("hand", [palm, *fingers, thumb], n_sensors)


def tube(n_sensors: int = 100) -> Body:
    """Make a cylinder with sensors on its side and its ends."""
    return covered("tube", [solids.cylinder(CYLINDER_RADIUS, CYLINDER_LENGTH / 2)], n_sensors)


def holed_plate(n_sensors: int = 120) -> Body:
    """Make a round plate with a round hole and sensors on its upper face.

    Paths along the skin around the hole are longer than the straight line.
    """
    top = PLATE_THICKNESS / 2
    corners = [(HOLE_RADIUS, -top), (PLATE_RADIUS, -top), (PLATE_RADIUS, top), (HOLE_RADIUS, top)]
    return covered(
        "holed-plate",
        [_ring(np.array(corners))],
        n_sensors,
        lambda points: points[:, 2] > top - _FACE_MARGIN,
    )


def uneven_sphere(n_sensors: int = 100) -> Body:
    """Make a sphere with sensors that are denser towards one pole.

    The density rises linearly along the axis, by a factor of `MAX_DENSITY`.
    """
    body = covered(
        "uneven-sphere",
        [solids.ball(SPHERE_RADIUS)],
        n_sensors,
        lambda points: 1 + (MAX_DENSITY - 1) * (points[:, 2] / SPHERE_RADIUS + 1) / 2,
    )
    return replace(body, geodesic=great_circles)


def covered(
    name: str,
    parts: Sequence[Solid],
    n_sensors: int,
    density: Density | None = None,
    rng: np.random.Generator | int = _SEED,
) -> Body:
    """Make a body from solids and spread sensors over it."""
    COUNT.check("n_sensors", n_sensors)
    positions, normals = spread(parts, n_sensors, np.random.default_rng(rng), density)
    return Body(name, positions, normals, parts)


def _ring(profile: NDArray[np.float64]) -> Solid:
    """Revolve a closed outline (radius, height) that does not meet the axis about z."""
    surface = solids.revolved(profile, _MESH_AROUND, is_ring=True)
    return solids.mesh(surface.vertices, surface.faces)
