"""The named bodies: bodies of the paper, with sensors on lattices, and more difficult ones.

To add a body, add one function and one line to `BODIES`. All functions raise InputError if
`n_sensors` is not a positive integer or does not fit the lattice. Positions are reproducible.

The first four are the simulated bodies of McGregor et al. (2011), section "Geometries" and Figure
5. The paper gives no lengths; lengths here, in m, give each body a reach of about 1 m. The hexagon
is the hardware patch of six IIT triangles, each with 12 capacitive pads, two of which are thermal
and not used as sensors (Maiolino et al. 2013, "A flexible and robust large scale capacitive tactile
system for robots", IEEE Sensors Journal 13(10): 3910-3917, doi:10.1109/JSEN.2013.2258149). On all
other bodies, the sensors are a maximal Poisson-disc sample of the surface; lengths were chosen by
hand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from anisomap.base.channels import PADS, TACTILE
from anisomap.errors import InputError
from anisomap.numerics.neighbours import nearest_distances
from anisomap.numerics.ranges import COUNT
from anisomap.numerics.surfaces import estimate_normals
from anisomap.simulation import solids
from anisomap.simulation.body import Body, straight_lines
from anisomap.simulation.solids import Chosen, Points, Solid, spread

_GOLDEN_ANGLE = float(np.pi * (3 - np.sqrt(5)))  # between points of a Fibonacci lattice

SPHERE_RADIUS = 1.0  # the reference of all other lengths
# With 10 columns of 6, the spacing is 0.31 around the cylinder and 0.33 along it.
CYLINDER_RADIUS, CYLINDER_LENGTH, _CYLINDER_COLUMNS = 0.5, 2.0, 10
# With 7 rings of 5, the spacing is 0.13 along an arm and 0.15 around it.
_Y_ARMS, _Y_ARM_LENGTH, _Y_ARM_RADIUS, _Y_RING_SENSORS = 3, 1.0, 0.13, 5
_Y_FIRST_RING = 0.22  # beyond 0.13 / sin(60 deg) = 0.15, where the surfaces of two arms meet
_PLANE_EDGE, _PLANE_THICKNESS = 2.0, 0.2

_SEED = 20110  # arbitrary
_MESH_AROUND = 64  # vertices per circle
_FACE_MARGIN = 1e-9  # tolerance for points on a face
_MAX_BALL_RADIUS = 0.6  # x median spacing: adjacent balls overlap, so nothing passes between them


def sphere(n_sensors: int = 60) -> Body:
    """Make a sphere with evenly spaced sensors.

    Sensors form a Fibonacci lattice (Gonzalez 2010, Mathematical Geosciences 42: 49-64,
    doi:10.1007/s11004-009-9257-x): each sensor represents the same area, and distances between
    neighbours differ by a few per cent.
    """
    COUNT.check("n_sensors", n_sensors)
    index = np.arange(n_sensors)
    height, angle = 1 - 2 * (index + 0.5) / n_sensors, _GOLDEN_ANGLE * index
    radius = np.sqrt(1 - height**2)
    normals = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])
    return Body(
        name="sphere",
        positions=SPHERE_RADIUS * normals,
        normals=normals,
        solids=[solids.ball(SPHERE_RADIUS)],
        geodesic=great_circles,
    )


def cylinder(n_sensors: int = 60) -> Body:
    """Make a cylinder with sensors in columns on its side and none on its ends."""
    n_rows = _divided(n_sensors, _CYLINDER_COLUMNS, "number of columns")
    columns = 2 * np.pi * np.arange(_CYLINDER_COLUMNS) / _CYLINDER_COLUMNS
    angles = np.repeat(columns, n_rows)
    heights = np.tile(midpoints(n_rows, CYLINDER_LENGTH), _CYLINDER_COLUMNS)
    around = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(n_sensors)])
    return Body(
        name="cylinder",
        positions=CYLINDER_RADIUS * around + heights[:, None] * [0, 0, 1],
        normals=around,
        solids=[solids.cylinder(CYLINDER_RADIUS, CYLINDER_LENGTH / 2)],
    )


def y_shape(n_sensors: int = 105) -> Body:
    """Make a Y-shape of three round arms with rings of sensors around each."""
    n_rings = _divided(n_sensors, _Y_ARMS * _Y_RING_SENSORS, "number of sensors per ring of 3 arms")
    arms = ring_directions(_Y_ARMS)
    # A ring in the frame of its arm, which lies along x.
    ring = np.roll(ring_directions(_Y_RING_SENSORS), 1, axis=1)
    along = np.linspace(_Y_FIRST_RING, _Y_ARM_LENGTH, n_rings) if n_rings > 1 else [_Y_ARM_LENGTH]
    positions, normals = [], []
    for arm in arms:
        frame = np.column_stack([arm, np.cross([0, 0, 1], arm), [0, 0, 1]])
        for distance in along:
            normals.append(ring @ frame.T)
            positions.append(distance * arm + _Y_ARM_RADIUS * normals[-1])
    return Body(
        name="y-shape",
        positions=np.vstack(positions),
        normals=np.vstack(normals),
        solids=[solids.capsule(_Y_ARM_RADIUS, np.zeros(3), _Y_ARM_LENGTH * arm) for arm in arms],
    )


def plane(n_sensors: int = 169) -> Body:
    """Make a cuboid with a square grid of sensors on its upper face."""
    COUNT.check("n_sensors", n_sensors)
    side = round(np.sqrt(n_sensors))
    if side**2 != n_sensors:
        raise InputError(f"n_sensors of a plane must be a square, as {side**2}, got {n_sensors}")
    grid = midpoints(side, _PLANE_EDGE)
    places = np.stack(np.meshgrid(grid, grid, indexing="ij"), axis=-1).reshape(-1, 2)
    return _flat("plane", places, _PLANE_EDGE / 2, _PLANE_THICKNESS / 2)


def _flat(name: str, places: Points, half: float, height: float, names: Sequence[str] = ()) -> Body:
    """Make a square box with sensors on its upper face. places (N, 2), half of the edge, height."""
    return Body(
        name=name,
        positions=np.column_stack([places, np.full(len(places), height)]),
        normals=np.tile([0.0, 0.0, 1.0], (len(places), 1)),
        solids=[solids.box((half, half, height))],
        names=tuple(names),
        geodesic=straight_lines,
    )


def great_circles(positions: Points) -> Points:
    """Compute the distances along a sphere centred at the origin, shape (N, N)."""
    radius = np.linalg.norm(positions, axis=1).mean()
    chords = straight_lines(positions)
    return np.asarray(2 * radius * np.arcsin(np.clip(chords / (2 * radius), 0, 1)))


def ring_directions(n: int) -> Points:
    """Return n unit vectors in the x-y plane at equal angles, starting at x; shape (n, 3)."""
    angle = 2 * np.pi * np.arange(n) / n
    return np.column_stack([np.cos(angle), np.sin(angle), np.zeros(n)])


def midpoints(n: int, length: float) -> Points:
    """Return the midpoints of n equal parts of an interval centred at 0; shape (n,)."""
    return np.asarray(length * ((np.arange(n) + 0.5) / n - 0.5))


def _divided(n_sensors: int, groups: int, meaning: str) -> int:
    COUNT.check("n_sensors", n_sensors)
    if n_sensors % groups:
        raise InputError(f"n_sensors must be a multiple of {groups}, the {meaning}")
    return n_sensors // groups


_TRIANGLES = 6
_APEX_MM = 18.6  # from the centre of a triangle, with edges of 32.2 mm, to a corner
_MARGIN_MM = 8.0  # between the outer pads and the edge of the patch; chosen by hand
_THICKNESS_MM = 5.0  # chosen by hand
_MM = 1e-3


def hexagon(n_sensors: int = 60) -> Body:
    """Make a hexagonal patch of six triangles.

    With 60 sensors, the two thermal pads of each triangle are excluded; with 72, all twelve pads
    are sensors, as in the paper.
    """
    sensing = {60: [*TACTILE], 72: [*range(len(PADS))]}.get(n_sensors)
    if sensing is None:
        raise InputError(f"n_sensors of the hexagonal patch must be 60 or 72, got {n_sensors}")
    names = [f"t{i}p{pad}" for i in range(_TRIANGLES) for pad in sensing]
    # Each triangle has a corner at the centre of the patch.
    triangle = PADS - [0, _APEX_MM]
    angles = np.arange(_TRIANGLES) * np.pi / 3
    turns = [np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) for a in angles]
    places = _MM * np.vstack([(triangle @ turn.T)[sensing] for turn in turns])
    half = float(np.abs(places).max() + _MM * _MARGIN_MM)
    return _flat("hexagon", places, half, _MM * _THICKNESS_MM / 2, names)


def hemisphere(n_sensors: int = 80) -> Body:
    """Make a hemisphere with sensors on its dome and none on its flat side."""
    angle = np.linspace(0, np.pi / 2, _MESH_AROUND // 4 + 1)
    dome = SPHERE_RADIUS * np.column_stack([np.cos(angle), np.sin(angle)])
    dome[-1, 0] = 0
    half = solids.revolved(np.vstack([[0, 0], dome]), _MESH_AROUND)
    solid = solids.mesh(replace(half, vertices=half.vertices - [0, 0, SPHERE_RADIUS / 2]))
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


def covered(name: str, parts: Sequence[Solid], n_sensors: int, on: Chosen | None = None) -> Body:
    """Make a body from solids, and spread sensors over points that a function accepts."""
    COUNT.check("n_sensors", n_sensors)
    positions, normals = spread(parts, n_sensors, np.random.default_rng(_SEED), on)
    return Body(name, positions, normals, parts)


def body_from_points(
    positions: ArrayLike, *, names: Sequence[str] = (), name: str = "points", units: str = ""
) -> Body:
    """Make a body from the positions of sensors alone.

    Parameters
    ----------
    positions : array_like of shape (N, 3)
        At least 4 sensors.
    names : sequence of str, optional
        Names of the sensors.
    name, units : str

    Returns
    -------
    Body
        A union of balls, each of which touches the surface from below at one sensor; normals are
        estimated from nearby sensors. Where the skin is not concave, the balls overlap and
        approximate the unknown surface.

    Raises
    ------
    InputError
        If there are fewer than 4 sensors, they are not 3D, or two have the same position.
    """
    places = np.asarray(positions, dtype=np.float64)
    if places.ndim != 2 or places.shape[1] != 3 or len(places) < 4:
        raise InputError(f"positions must have shape (N, 3) with N at least 4, got {places.shape}")
    spacing = nearest_distances(places)
    if spacing.min() <= 0:
        # Distances are compared, since squares of small differences may underflow.
        distances = np.linalg.norm(places - places[int(spacing.argmin())], axis=1)
        first, second = np.argsort(distances, kind="stable")[:2]
        raise InputError(f"positions must be distinct; sensors {first} and {second} coincide")
    outward, _ = estimate_normals(places)
    origin = (places.min(axis=0) + places.max(axis=0)) / 2
    centred = places - origin
    largest = _MAX_BALL_RADIUS * float(np.median(spacing))
    balls = []
    for at, normal in zip(centred, outward, strict=True):
        # The largest ball below the sensor without other sensors.
        others = centred - at
        others = others[others @ normal < 0]
        touching = np.einsum("nd,nd->n", others, others) / (-2 * (others @ normal))
        radius = float(min(largest, touching.min(initial=np.inf)))
        balls.append(solids.ball(radius, at - radius * normal))
    return Body(
        name, centred, outward, balls, names=tuple(names), units=units, origin=origin,
        is_whole=False,
    )  # fmt: skip


BODIES: Mapping[str, Callable[..., Body]] = MappingProxyType(
    {
        "sphere": sphere,
        "cylinder": cylinder,
        "y-shape": y_shape,
        "plane": plane,
        "hexagon": hexagon,
        "hemisphere": hemisphere,
        "hand": hand,
    }
)
"""Functions ``make(n_sensors)`` with a default number of sensors. The paper's bodies come first."""
