"""Bodies that are harder than the paper's: closed, holed, thin, branching, unevenly covered.

Sensors are spread evenly over all of the surface, except where it says otherwise. Each body reaches
to about 1 m from its middle; no body here is random: the same number of sensors, the same places.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from anisomap.simulation.bodies.body import Body
from anisomap.simulation.bodies.lattice import (
    CYLINDER_LENGTH,
    CYLINDER_RADIUS,
    SPHERE_RADIUS,
    great_circles,
)
from anisomap.simulation.checks import check_count
from anisomap.simulation.geometry import solids
from anisomap.simulation.geometry.solids import Solid
from anisomap.simulation.geometry.spreading import Density, spread

TORUS_RADIUS, TORUS_TUBE = 0.75, 0.3
CUBE_EDGE = 1.4
HOLE_RADIUS, PLATE_RADIUS, PLATE_THICKNESS = 0.4, 1.0, 0.2
DENSEST = 8.0
"""How many times as densely sensors stand at one pole of the uneven sphere as at the other."""

_SEED = 20110  # any number: that of the paper's first page serves
_MESH_AROUND = 64


def torus(n_sensors: int = 120) -> Body:
    """Make a ring: closed, with a hole that no flat map can show.

    Parameters
    ----------
    n_sensors : int

    Returns
    -------
    Body
    """
    angle = 2 * np.pi * np.arange(_MESH_AROUND // 2) / (_MESH_AROUND // 2)
    profile = np.column_stack(
        [TORUS_RADIUS + TORUS_TUBE * np.cos(angle), TORUS_TUBE * np.sin(angle)]
    )
    return covered("torus", [_ring(profile)], n_sensors)


def cube(n_sensors: int = 120) -> Body:
    """Make a cube: flat faces and edges of a right angle, over which nothing touches both sides.

    Parameters
    ----------
    n_sensors : int

    Returns
    -------
    Body
    """
    return covered("cube", [solids.box(3 * (CUBE_EDGE / 2,))], n_sensors)


def hemisphere(n_sensors: int = 80) -> Body:
    """Make half a ball with sensors on its dome, and none on its flat side.

    Parameters
    ----------
    n_sensors : int

    Returns
    -------
    Body
    """
    angle = np.linspace(0, np.pi / 2, _MESH_AROUND // 4 + 1)
    dome = SPHERE_RADIUS * np.column_stack([np.cos(angle), np.sin(angle)])
    dome[-1, 0] = 0
    half = solids.revolved(np.vstack([[0, 0], dome]), _MESH_AROUND)
    solid = solids.mesh(half.vertices - [0, 0, SPHERE_RADIUS / 2], half.faces)
    flat_side = -SPHERE_RADIUS / 2 + 1e-9
    return covered("hemisphere", [solid], n_sensors, lambda points: points[:, 2] > flat_side)


def hand(n_sensors: int = 160) -> Body:
    """Make a palm with four fingers and a thumb, covered on all sides.

    Parameters
    ----------
    n_sensors : int

    Returns
    -------
    Body
        Fingers are nearer to one another in space than along the skin.
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
    """Make the paper's cylinder with sensors on its ends, too: a closed surface.

    Parameters
    ----------
    n_sensors : int

    Returns
    -------
    Body
    """
    return covered("tube", [solids.cylinder(CYLINDER_RADIUS, CYLINDER_LENGTH / 2)], n_sensors)


def holed_plate(n_sensors: int = 120) -> Body:
    """Make a round plate with a round hole, with sensors on its upper face.

    Parameters
    ----------
    n_sensors : int

    Returns
    -------
    Body
        The way along the skin around the hole is longer than the straight line over it.
    """
    top = PLATE_THICKNESS / 2
    corners = [(HOLE_RADIUS, -top), (PLATE_RADIUS, -top), (PLATE_RADIUS, top), (HOLE_RADIUS, top)]
    return covered(
        "holed-plate",
        [_ring(np.array(corners))],
        n_sensors,
        lambda points: points[:, 2] > top - 1e-9,
    )


def uneven_sphere(n_sensors: int = 100) -> Body:
    """Make a sphere that is more densely covered the nearer to one pole.

    Parameters
    ----------
    n_sensors : int

    Returns
    -------
    Body
        `DENSEST` times as densely at one pole as at the other, growing evenly in between.
    """
    body = covered(
        "uneven-sphere",
        [solids.ball(SPHERE_RADIUS)],
        n_sensors,
        lambda points: 1 + (DENSEST - 1) * (points[:, 2] / SPHERE_RADIUS + 1) / 2,
    )
    return Body(body.name, body.positions, body.normals, body.solids, geodesic=great_circles)


def covered(
    name: str,
    parts: Sequence[Solid],
    n_sensors: int,
    density: Density | None = None,
    rng: np.random.Generator | int = _SEED,
) -> Body:
    """Make a body of solids and spread sensors over it.

    Parameters
    ----------
    name : str
    parts : sequence of Solid
    n_sensors : int
    density : callable, optional
        See `anisomap.simulation.geometry.spreading.spread`; 0 or False: no sensor.
    rng : numpy.random.Generator or int
        Or its seed.

    Returns
    -------
    Body

    Raises
    ------
    InputError
        If `n_sensors` is not a positive whole number, or no surface is left for them.
    """
    check_count("n_sensors", n_sensors)
    positions, normals = spread(parts, n_sensors, np.random.default_rng(rng), density)
    return Body(name, positions, normals, parts)


def _ring(profile: NDArray[np.float64]) -> Solid:
    """Turn a closed outline (radius, height) that keeps clear of the axis about it."""
    n_points = len(profile)
    angle = 2 * np.pi * np.arange(_MESH_AROUND) / _MESH_AROUND
    radius, height = profile[:, :1], np.tile(profile[:, 1:], _MESH_AROUND)
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=-1)
    index = np.arange(n_points * _MESH_AROUND).reshape(n_points, _MESH_AROUND)
    up, on = np.roll(index, -1, axis=0), np.roll(index, -1, axis=1)
    beyond = np.roll(up, -1, axis=1)
    faces = np.vstack(
        [
            np.stack([index, on, beyond], axis=-1).reshape(-1, 3),
            np.stack([index, beyond, up], axis=-1).reshape(-1, 3),
        ]
    )
    return solids.mesh(vertices.reshape(-1, 3), faces)
