"""What a simulation looks like: plain data between those who simulate and those who draw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface made of triangles.

    Parameters
    ----------
    vertices : array_like of shape (V, 3)
    faces : array_like of int, shape (F, 3)
        Vertices of each triangle, counter-clockwise as seen from outside.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.intp]

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", frozen(self.vertices))
        faces = np.array(self.faces, dtype=np.intp).reshape(-1, 3)
        faces.setflags(write=False)
        object.__setattr__(self, "faces", faces)


@dataclass(frozen=True, eq=False)
class Prop:
    """A thing on the stage: alike things that stand or move.

    Parameters
    ----------
    role : {"body", "stimulus", "ground", "room"}
        What it is, which decides how it is drawn; of a room only the edges are.
    mesh : Mesh
        Its surface, in its own frame.
    centres : array_like of shape (T, B, 3)
        Where the origins of B such things are in each frame; T = 1 for what stands still.
    rotations : array_like of shape (T, B, 3, 3), optional
        How each is turned; not at all unless given.
    scales : array_like of shape (B,), optional
        How many times as large as the mesh each is; 1 unless given.
    """

    role: str
    mesh: Mesh
    centres: NDArray[np.float64]
    rotations: NDArray[np.float64] | None = None
    scales: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        for name in ("centres", "rotations", "scales"):
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, frozen(values))

    def surfaces(self, frame: int) -> list[NDArray[np.float64]]:
        """Give the vertices of each thing as it is in a frame, shape (V, 3) each."""
        centres = self.centres[frame % len(self.centres)]
        scales = np.ones(len(centres)) if self.scales is None else self.scales
        corners = scales[:, None, None] * self.mesh.vertices
        if self.rotations is not None:
            turned = self.rotations[frame % len(self.rotations)]
            corners = np.einsum("bij,bvj->bvi", turned, corners)
        return list(corners + centres[:, None])


@dataclass(frozen=True, eq=False)
class Scene:
    """A run as it can be drawn.

    Parameters
    ----------
    title : str
    props : tuple of Prop
    sensors : array_like of shape (T, N, 3)
        Where the sensors are in each frame; T = 1 if they do not move.
    readings : array_like of shape (T, N)
    times : array_like of shape (T,)
        Seconds.
    units : str
        Of lengths.
    """

    title: str
    props: tuple[Prop, ...]
    sensors: NDArray[np.float64]
    readings: NDArray[np.floating]
    times: NDArray[np.float64]
    units: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "sensors", frozen(self.sensors))
        object.__setattr__(self, "times", frozen(self.times))

    @property
    def n_frames(self) -> int:
        """How many frames there are, T."""
        return len(self.readings)


def frozen(values: ArrayLike) -> NDArray[np.float64]:
    """Copy numbers into a read-only array."""
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
