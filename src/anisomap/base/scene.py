"""Geometry of a simulated run, for drawing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.base.immutable import Immutable


@dataclass(frozen=True, eq=False)
class Mesh(Immutable):
    """A triangle mesh.

    vertices (V, 3)
    faces: Vertices of each triangle, counter-clockwise as seen from outside.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.intp]

    def __post_init__(self) -> None:
        faces = np.array(self.faces, dtype=np.intp).reshape(-1, 3)
        self.set_fields(vertices=frozen(self.vertices), faces=faces)


@dataclass(frozen=True, eq=False)
class Prop(Immutable):
    """Objects of one shape in a scene, static or moving.

    role: Determines the style of drawing; only the edges of a room are drawn.
    mesh: Surface in local coordinates.
    centres (T, B, 3): Positions of the local origins of B objects in each frame; T = 1 for static
        objects.
    rotations (T, B, 3, 3): Rotation matrix of each object in each frame. Default: identity.
    scales (B,): Size of each object relative to the mesh. Default: 1.
    """

    role: str
    mesh: Mesh
    centres: NDArray[np.float64]
    rotations: NDArray[np.float64] | None = None
    scales: NDArray[np.float64] | None = None

    def surfaces(self, frame: int) -> list[NDArray[np.float64]]:
        """Return the vertices of each of the B objects in a frame, each of shape (V, 3)."""
        centres = self.centres[frame % len(self.centres)]
        scales = np.ones(len(centres)) if self.scales is None else self.scales
        corners = scales[:, None, None] * self.mesh.vertices
        if self.rotations is not None:
            rotations = self.rotations[frame % len(self.rotations)]
            corners = np.einsum("bij,bvj->bvi", rotations, corners)
        return list(corners + centres[:, None])


@dataclass(frozen=True, eq=False)
class Scene(Immutable):
    """Objects, sensors and readings of a simulated run.

    sensors (T, N, 3): Sensor positions in each frame; T = 1 for static sensors.
    readings (T, N)
    times (T,): In seconds.
    units: Unit of lengths.
    """

    title: str
    props: tuple[Prop, ...]
    sensors: NDArray[np.float64]
    readings: NDArray[np.floating]
    times: NDArray[np.float64]
    units: str

    @property
    def n_frames(self) -> int:
        """Number of frames, T."""
        return len(self.readings)


def frozen(values: ArrayLike) -> NDArray[np.float64]:
    """Copy numbers into a read-only array."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
