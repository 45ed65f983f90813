"""What a body is: solids, and sensors on their surface."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.recording import default_names
from anisomap.scene import frozen
from anisomap.simulation.geometry.solids import Points, Solid, distance_to_all, outward, projected

UNITS = "m"
"""Unit of every length in a simulation, unless a body that a user brings has another."""

ON_SURFACE = 1e-6
"""How far off the surface a sensor may be, as a share of the body's reach."""


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body and the sensors on it.

    Parameters
    ----------
    name : str
        Its name, for the record.
    positions : array_like of shape (N, 3)
        Sensors, on the surface.
    normals : array_like of shape (N, 3)
        Outward unit normals of the surface at the sensors.
    solids : sequence of Solid
        What things bounce off; together they are the body. Its middle is near the origin.
    names : tuple of str, optional
        One unique name a sensor; ``s0, s1, ...`` unless given.
    units : str
        Unit of every length.
    origin : array_like of shape (3,)
        Where the body's origin is in the frame in which a user gave it, and in which recordings
        tell its sensors' places.
    is_whole : bool
        Whether the solids' surface is the body's between the sensors, too.
    geodesic : callable, optional
        Takes positions; gives their (N, N) distances along the surface, where there is a closed
        form. Others are found by `anisomap.simulation.bodies.geodesics.surface_distances`.

    Raises
    ------
    InputError
        If there are no sensors, numbers are not finite, or a sensor is not on the surface.
    """

    name: str
    positions: Points
    normals: Points
    solids: Sequence[Solid]
    names: tuple[str, ...] = ()
    units: str = UNITS
    origin: Points = field(default_factory=lambda: frozen(np.zeros(3)))
    is_whole: bool = True
    geodesic: Callable[[Points], Points] | None = None

    def __post_init__(self) -> None:
        positions, normals = frozen(self.positions), frozen(self.normals)
        if positions.ndim != 2 or positions.shape[1] != 3 or not len(positions):
            raise InputError(
                f"sensors of the body {self.name} have shape {positions.shape}; "
                "they must be points in space, shape (N, 3)"
            )
        if normals.shape != positions.shape:
            raise InputError(f"{len(positions)} sensors of {self.name} need as many normals")
        for i, row in enumerate(np.column_stack([positions, normals])):
            if not np.isfinite(row).all():
                raise InputError(f"sensor {i} of the body {self.name} has no finite place")
        object.__setattr__(self, "positions", positions)
        object.__setattr__(self, "normals", normals)
        object.__setattr__(self, "origin", frozen(self.origin))
        object.__setattr__(self, "solids", tuple(self.solids))
        object.__setattr__(self, "names", tuple(self.names) or default_names(len(positions)))
        off = np.abs(self.distance(positions))
        if off.max() > ON_SURFACE * self.reach:
            worst = int(off.argmax())
            raise InputError(
                f"sensor {self.names[worst]} of the body {self.name} is {off[worst]:g} "
                f"{self.units} off its surface; sensors must be on it"
            )

    @property
    def n_sensors(self) -> int:
        """Number of sensors, N."""
        return len(self.positions)

    @cached_property
    def reach(self) -> float:
        """Radius of a ball about the origin that holds the body."""
        return max(solid.reach for solid in self.solids)

    @cached_property
    def spacing(self) -> float:
        """Median distance from a sensor to its nearest neighbour; with one sensor, the reach."""
        if self.n_sensors == 1:
            return self.reach
        return float(np.median(nearest_neighbours(self.positions, 1)[0]))

    def distance(self, points: ArrayLike) -> Points:
        """Measure how far points are from the surface, shape (n,); negative inside the body."""
        return distance_to_all(self.solids, points)

    def outward(self, points: ArrayLike) -> Points:
        """Give the normals of the surface at points on it, shape (n, 3)."""
        return outward(self.solids, points)

    def projected(self, points: ArrayLike) -> Points:
        """Move points along the normals to the surface, shape (n, 3)."""
        return projected(self.solids, points)

    def scaled(self, factor: float) -> Body:
        """Make it `factor` times as large, about the origin."""
        geodesic = self.geodesic
        return replace(
            self,
            positions=factor * self.positions,
            solids=[solid.scaled(factor) for solid in self.solids],
            geodesic=geodesic and (lambda points: factor * geodesic(points / factor)),
        )


def nearest_neighbours(points: Points, n_neighbours: int) -> tuple[Points, NDArray[np.intp]]:
    """Find the nearest others of each point: distances and indices, shape (n, n_neighbours)."""
    distances, indices = KDTree(points).query(points, k=[*range(2, n_neighbours + 2)])
    return np.asarray(distances), np.asarray(indices)


def straight_lines(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distances along a flat face: straight lines."""
    return np.asarray(np.linalg.norm(positions[:, None] - positions, axis=-1))
