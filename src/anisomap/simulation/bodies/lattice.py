"""The bodies of McGregor et al. (2011), section "Geometries" and Figure 5.

The paper gives no lengths. Here a body reaches to about 1 m from its middle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.simulation.bodies.body import Body, straight_lines
from anisomap.simulation.checks import check_count
from anisomap.simulation.geometry import solids

SPHERE_RADIUS = 1.0
"""Metres: the unit of all other lengths."""

CYLINDER_RADIUS = 0.5
CYLINDER_LENGTH = 2.0
"""Metres. With 10 columns of 6, neighbours are 0.31 apart around it and 0.33 along it."""

Y_ARMS = 3
Y_ARM_LENGTH = 1.0
Y_ARM_RADIUS = 0.13
"""Metres. With 7 rings of 5, neighbours are 0.13 apart along an arm and 0.15 around it."""
_Y_AROUND = 5
_Y_CLEAR = 0.22  # where the arms' surfaces have parted: 0.13 / sin(60 deg) = 0.15, and some more

PLANE_EDGE = 2.0
PLANE_THICKNESS = 0.2


def sphere(n_sensors: int = 60) -> Body:
    """Make a sphere with sensors spread evenly over it.

    Parameters
    ----------
    n_sensors : int
        The paper's has 60.

    Returns
    -------
    Body

    Raises
    ------
    InputError
        If `n_sensors` is not a positive whole number.

    Notes
    -----
    The sensors are a Fibonacci lattice (Gonzalez 2010, Mathematical Geosciences 42: 49-64,
    doi:10.1007/s11004-009-9257-x): each stands for the same area, and the distances between
    neighbours differ by a few per cent only.
    """
    check_count("n_sensors", n_sensors)
    turns = np.arange(n_sensors)
    height = 1 - (2 * turns + 1) / n_sensors
    angle = np.pi * (3 - np.sqrt(5)) * turns
    ring = np.sqrt(1 - height**2)
    normals = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), height])
    return Body(
        name="sphere",
        positions=SPHERE_RADIUS * normals,
        normals=normals,
        solids=[solids.ball(SPHERE_RADIUS)],
        geodesic=great_circles,
    )


def cylinder(n_sensors: int = 60) -> Body:
    """Make a cylinder with columns of sensors on its side, and none on its ends.

    Parameters
    ----------
    n_sensors : int
        A multiple of 10: they stand in 10 columns. The paper's has 60, 6 a column.

    Returns
    -------
    Body

    Raises
    ------
    InputError
        If `n_sensors` does not make 10 columns.
    """
    n_rows = _share(n_sensors, 10, "columns")
    normals = ring_directions(10)
    heights = middles(n_rows, CYLINDER_LENGTH)
    around, up = np.repeat(normals, n_rows, axis=0), np.tile(heights, 10)
    return Body(
        name="cylinder",
        positions=CYLINDER_RADIUS * around + up[:, None] * [0, 0, 1],
        normals=around,
        solids=[solids.cylinder(CYLINDER_RADIUS, CYLINDER_LENGTH / 2)],
    )


def y_shape(n_sensors: int = 105) -> Body:
    """Make three round arms that meet at equal angles, with rings of sensors around each.

    Parameters
    ----------
    n_sensors : int
        A multiple of 15: each arm has rings of 5. The paper's has 105, 7 rings an arm.

    Returns
    -------
    Body

    Raises
    ------
    InputError
        If `n_sensors` does not make rings of 5 on 3 arms.
    """
    n_rings = _share(n_sensors, Y_ARMS * _Y_AROUND, "places around the arms")
    arms = ring_directions(Y_ARMS)
    # A ring in the frame of its arm: x along it, so that y and z go around.
    ring = np.roll(ring_directions(_Y_AROUND), 1, axis=1)
    along = np.linspace(_Y_CLEAR, Y_ARM_LENGTH, n_rings) if n_rings > 1 else [Y_ARM_LENGTH]
    positions, normals = [], []
    for arm in arms:
        frame = np.column_stack([arm, np.cross([0, 0, 1], arm), [0, 0, 1]])
        for distance in along:
            normals.append(ring @ frame.T)
            positions.append(distance * arm + Y_ARM_RADIUS * normals[-1])
    return Body(
        name="y-shape",
        positions=np.vstack(positions),
        normals=np.vstack(normals),
        solids=[solids.capsule(Y_ARM_RADIUS, np.zeros(3), Y_ARM_LENGTH * arm) for arm in arms],
    )


def plane(n_sensors: int = 169) -> Body:
    """Make a cuboid with a square grid of sensors on its upper face.

    Parameters
    ----------
    n_sensors : int
        A square number. The paper's has 169: 13 x 13.

    Returns
    -------
    Body

    Raises
    ------
    InputError
        If `n_sensors` is not a square number.
    """
    check_count("n_sensors", n_sensors)
    side = round(np.sqrt(n_sensors))
    if side**2 != n_sensors:
        raise InputError(
            f"n_sensors is {n_sensors}; a plane takes a square number, such as {side**2}"
        )
    grid = middles(side, PLANE_EDGE)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    half = PLANE_EDGE / 2
    return Body(
        name="plane",
        positions=np.column_stack([x.ravel(), y.ravel(), np.full(n_sensors, PLANE_THICKNESS / 2)]),
        normals=np.tile([0.0, 0.0, 1.0], (n_sensors, 1)),
        solids=[solids.box((half, half, PLANE_THICKNESS / 2))],
        geodesic=straight_lines,
    )


def great_circles(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances along a sphere about the origin."""
    radius = np.linalg.norm(positions, axis=1).mean()
    chords = straight_lines(positions)
    return np.asarray(2 * radius * np.arcsin(np.clip(chords / (2 * radius), 0, 1)))


def ring_directions(n: int) -> NDArray[np.float64]:
    """Give n unit vectors in the x-y plane at equal angles, the first along x; shape (n, 3)."""
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])


def middles(n: int, length: float) -> NDArray[np.float64]:
    """Cut a length about 0 into n equal parts, and give their middles."""
    return np.asarray(length * ((np.arange(n) + 0.5) / n - 0.5))


def _share(n_sensors: int, groups: int, what: str) -> int:
    check_count("n_sensors", n_sensors)
    if n_sensors % groups:
        raise InputError(f"n_sensors is {n_sensors}; it must be a multiple of the {groups} {what}")
    return n_sensors // groups
