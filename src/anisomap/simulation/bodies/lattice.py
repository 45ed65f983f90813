"""Bodies with sensors on regular lattices: sphere, cylinder, Y-shape, plane and hexagon.

These are the simulated bodies of McGregor et al. (2011), section "Geometries" and Figure 5. The
paper gives no lengths; those here give each body a reach of about 1 m. All functions raise
InputError if `n_sensors` does not fit the lattice.

The hardware patch is a hexagon of six IIT triangles, each with 12 capacitive pads, two of which are
thermal and not used as sensors (Maiolino et al. 2013, "A flexible and robust large scale capacitive
tactile system for robots", IEEE Sensors Journal 13(10): 3910-3917, doi:10.1109/JSEN.2013.2258149).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.simulation import solids
from anisomap.simulation.bodies.body import Body, straight_lines
from anisomap.simulation.checks import COUNT

Floats = NDArray[np.float64]

GOLDEN_ANGLE = float(np.pi * (3 - np.sqrt(5)))
"""Angle between successive points of a Fibonacci lattice, in rad."""

SPHERE_RADIUS = 1.0  # m, the reference of all other lengths

# m. With 10 columns of 6, the spacing is 0.31 around the cylinder and 0.33 along it.
CYLINDER_RADIUS = 0.5
CYLINDER_LENGTH = 2.0
CYLINDER_COLUMNS = 10

# m. With 7 rings of 5, the spacing is 0.13 along an arm and 0.15 around it.
Y_ARMS = 3
Y_ARM_LENGTH = 1.0
Y_ARM_RADIUS = 0.13
Y_RING_SENSORS = 5
Y_FIRST_RING = 0.22  # beyond 0.13 / sin(60 deg) = 0.15, where the surfaces of two arms meet

PLANE_EDGE = 2.0  # m
PLANE_THICKNESS = 0.2  # m


def sphere(n_sensors: int = 60) -> Body:
    """Make a sphere with evenly spaced sensors.

    Sensors form a Fibonacci lattice (Gonzalez 2010, Mathematical Geosciences 42: 49-64,
    doi:10.1007/s11004-009-9257-x): each represents the same area, and distances between
    neighbours differ by a few per cent.
    """
    COUNT.check("n_sensors", n_sensors)
    normals = fibonacci_cap(n_sensors)
    return Body(
        name="sphere",
        positions=SPHERE_RADIUS * normals,
        normals=normals,
        solids=[solids.ball(SPHERE_RADIUS)],
        geodesic=great_circles,
    )


def cylinder(n_sensors: int = 60, *, placement: str = "columns", seed: int = 0) -> Body:
    """Make a cylinder with sensors on its side and none on its ends."""
    if placement not in CYLINDER_PLACEMENTS:
        raise InputError(
            f"there is no placement {placement!r}; choose from {', '.join(CYLINDER_PLACEMENTS)}"
        )
    COUNT.check("n_sensors", n_sensors)
    angles, heights = CYLINDER_PLACEMENTS[placement](n_sensors, np.random.default_rng(seed))
    around = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n_sensors)])
    return Body(
        name="cylinder" if placement == "columns" else f"cylinder-{placement}",
        positions=CYLINDER_RADIUS * around + heights[:, None] * [0, 0, 1],
        normals=around,
        solids=[solids.cylinder(CYLINDER_RADIUS, CYLINDER_LENGTH / 2)],
    )


def _columns(n_sensors: int, _: np.random.Generator) -> tuple[Floats, Floats]:
    n_rows = _divided(n_sensors, CYLINDER_COLUMNS, "number of columns")
    angles = 2 * np.pi * np.arange(CYLINDER_COLUMNS) / CYLINDER_COLUMNS
    heights = midpoints(n_rows, CYLINDER_LENGTH)
    return np.repeat(angles.astype(np.float64), n_rows), np.tile(heights, CYLINDER_COLUMNS)


def _fibonacci(n_sensors: int, _: np.random.Generator) -> tuple[Floats, Floats]:
    angles = np.asarray(GOLDEN_ANGLE * np.arange(n_sensors), dtype=np.float64)
    return angles, midpoints(n_sensors, CYLINDER_LENGTH)


def _random(n_sensors: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    angles = rng.uniform(0, 2 * np.pi, n_sensors)
    return angles, rng.uniform(-CYLINDER_LENGTH / 2, CYLINDER_LENGTH / 2, n_sensors)


CYLINDER_PLACEMENTS: Mapping[str, Callable[[int, np.random.Generator], tuple[Floats, Floats]]] = (
    MappingProxyType({"columns": _columns, "fibonacci": _fibonacci, "random": _random})
)
"""Angles and heights of the sensors of a cylinder, given their number and a generator."""


def y_shape(n_sensors: int = 105) -> Body:
    """Make a Y-shape of three round arms with rings of sensors around each."""
    n_rings = _divided(n_sensors, Y_ARMS * Y_RING_SENSORS, "number of sensors per ring of 3 arms")
    arms = ring_directions(Y_ARMS)
    # A ring in the frame of its arm, which lies along x.
    ring = np.roll(ring_directions(Y_RING_SENSORS), 1, axis=1)
    along = np.linspace(Y_FIRST_RING, Y_ARM_LENGTH, n_rings) if n_rings > 1 else [Y_ARM_LENGTH]
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
    """Make a cuboid with a square grid of sensors on its upper face."""
    COUNT.check("n_sensors", n_sensors)
    side = round(np.sqrt(n_sensors))
    if side**2 != n_sensors:
        raise InputError(
            f"n_sensors of a plane must be a square number such as {side**2}, got {n_sensors}"
        )
    grid = midpoints(side, PLANE_EDGE)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    half = PLANE_EDGE / 2
    return Body(
        name="plane",
        positions=np.column_stack([x.ravel(), y.ravel(), np.full(n_sensors, PLANE_THICKNESS / 2)]),
        normals=np.tile([0.0, 0.0, 1.0], (n_sensors, 1)),
        solids=[solids.box((half, half, PLANE_THICKNESS / 2))],
        geodesic=straight_lines,
    )


def fibonacci_cap(n: int, lowest: float = -1.0) -> NDArray[np.float64]:
    """Return n evenly spaced unit vectors with z of at least `lowest`, shape (n, 3)."""
    index = np.arange(n)
    height = 1 - (1 - lowest) * (index + 0.5) / n
    angle = GOLDEN_ANGLE * index
    radius = np.sqrt(1 - height**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def great_circles(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the distances along a sphere centred at the origin, shape (N, N)."""
    radius = np.linalg.norm(positions, axis=1).mean()
    chords = straight_lines(positions)
    return np.asarray(2 * radius * np.arcsin(np.clip(chords / (2 * radius), 0, 1)))


def ring_directions(n: int) -> NDArray[np.float64]:
    """Return n unit vectors in the x-y plane at equal angles, starting at x; shape (n, 3)."""
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])


def midpoints(n: int, length: float) -> NDArray[np.float64]:
    """Return the midpoints of n equal parts of an interval centred at 0; shape (n,)."""
    return np.asarray(length * ((np.arange(n) + 0.5) / n - 0.5))


def _divided(n_sensors: int, groups: int, meaning: str) -> int:
    COUNT.check("n_sensors", n_sensors)
    if n_sensors % groups:
        raise InputError(
            f"n_sensors must be a multiple of {groups}, the {meaning}; got {n_sensors}"
        )
    return n_sensors // groups


TRIANGLES = 6

# Pads in the order of their channels, in mm, relative to the middle of the triangle. They lie on a
# triangular lattice with a pitch of 6.533 mm, except for the thermal pads.
_PADS_MM = np.array(
    [
        (6.533, 0.0),
        (9.8, -5.66),
        (3.267, -5.66),
        (0.0, 0.0),
        (-3.267, -5.66),
        (-9.8, -5.66),
        (-6.51, -3.75),
        (-6.533, 0.0),
        (-3.267, 5.66),
        (0.0, 11.317),
        (0.0, 7.507),
        (3.267, 5.66),
    ]
)
THERMAL_PADS = (6, 10)
_N_PADS = len(_PADS_MM)

_APEX_MM = 18.6  # from the middle of a triangle, with edges of 32.2 mm, to its corner
_MARGIN_MM = 8.0  # between the outer pads and the edge of the patch; chosen by hand
_THICKNESS_MM = 5.0  # chosen by hand
_MM = 1e-3


def hexagon(n_sensors: int = 60) -> Body:
    """Make a hexagonal patch of six triangles with ten sensors each (the paper counts twelve)."""
    sensing = [pad for pad in range(_N_PADS) if pad not in THERMAL_PADS]
    expected = TRIANGLES * len(sensing)
    if n_sensors != expected:
        raise InputError(f"n_sensors of the hexagonal patch must be {expected}, got {n_sensors}")
    flat = _MM * np.vstack([_triangle(i)[sensing] for i in range(TRIANGLES)])
    height = _MM * _THICKNESS_MM / 2
    half = np.abs(flat).max() + _MM * _MARGIN_MM
    return Body(
        name="hexagon",
        positions=np.column_stack([flat, np.full(len(flat), height)]),
        normals=np.tile([0.0, 0.0, 1.0], (len(flat), 1)),
        solids=[solids.box((half, half, height))],
        names=tuple(f"t{i}p{pad}" for i in range(TRIANGLES) for pad in sensing),
        geodesic=straight_lines,
    )


def _triangle(index: int) -> NDArray[np.float64]:
    """Return the pads of a triangle with its corner in the middle of the patch; shape (12, 2)."""
    angle = index * np.pi / 3
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    return np.asarray((_PADS_MM - [0, _APEX_MM]) @ rotation.T)
