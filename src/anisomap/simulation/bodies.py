"""Bodies with sensors on their surface, without any engine: to add one, add a function to `BODIES`.

Lengths are in metres. A body stands with its middle in the origin.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.simulation.world import check_count

UNITS = "m"
"""Unit of every length in a simulation."""

SPHERE_RADIUS = 1.0
"""Metres. The paper gives no lengths: the body's radius is the unit of all others here."""

_ON_SURFACE = 1e-9


@dataclass(frozen=True)
class Geom:
    """One solid that a body is made of.

    Parameters
    ----------
    kind : str
        MuJoCo's word for it: ``"sphere"``.
    size : tuple of float
        What MuJoCo takes as its size, in metres: of a sphere, the radius.
    """

    kind: str
    size: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body and the sensors on it.

    Parameters
    ----------
    name : str
        Its name, for the record.
    positions : array_like of shape (N, 3)
        Sensors, on the surface. Metres.
    normals : array_like of shape (N, 3)
        Outward unit normals of the surface at the sensors.
    geoms : tuple of Geom
        The solids that things bounce off.
    distance : callable
        Takes points of shape (n, 3); gives their distances from the surface, shape (n,), negative
        inside the body.
    reach : float
        Radius of a ball about the origin that holds the body.

    Raises
    ------
    InputError
        If a sensor is not on the surface.
    """

    name: str
    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    geoms: tuple[Geom, ...]
    distance: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    reach: float

    def __post_init__(self) -> None:
        positions = _frozen_points(self.positions)
        off = np.abs(self.distance(positions))
        if off.max() > _ON_SURFACE * self.reach:
            worst = int(off.argmax())
            raise InputError(
                f"sensor {worst} of the body {self.name} is {off[worst]:g} m off its surface; "
                "sensors must be on it"
            )
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "normals", _frozen_points(self.normals))


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
    neighbours differ by a few per cent only. McGregor et al. (2011), section "Geometries".
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
        geoms=(Geom("sphere", (SPHERE_RADIUS,)),),
        distance=lambda points: np.linalg.norm(points, axis=1) - SPHERE_RADIUS,
        reach=SPHERE_RADIUS,
    )


BODIES: Mapping[str, Callable[..., Body]] = MappingProxyType({"sphere": sphere})
"""Each takes the number of its sensors, and has a default for it."""


def _frozen_points(values: ArrayLike) -> NDArray[np.float64]:
    points = np.array(values, dtype=np.float64)
    points.setflags(write=False)
    return points
