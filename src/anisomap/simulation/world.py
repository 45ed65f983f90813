"""What scenarios share: what they hand back, and bodies as the physics engine takes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anisomap.recording import Scalar
from anisomap.scene import Prop
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.geometry.solids import Solid

Progress: TypeAlias = Callable[[float], None]
"""Told the share done, from 0 to 1."""


@dataclass(frozen=True, eq=False)
class Run:
    """What a scenario hands back.

    Attributes
    ----------
    readings : ndarray of shape (T, N)
        One row a frame, one column a sensor of the body.
    rate_hz : float
        Frames a second.
    facts : mapping of str to str, int, float or bool
        Every parameter as it was used, and what was measured of the physics.
    props : tuple of Prop
        What there was to be seen.
    sensors : ndarray of shape (T, N, 3)
        Where the sensors were in each frame; T = 1 if they did not move.
    body : Body, optional
        What bears the sensors that were read, if not the very body that was given: the scenario
        put others beside them.
    """

    readings: NDArray[np.floating]
    rate_hz: float
    facts: Mapping[str, Scalar]
    props: tuple[Prop, ...]
    sensors: NDArray[np.float64]
    body: Body | None = None


def add_solids(
    mujoco: ModuleType, spec: Any, solids: Sequence[Solid], surface: Mapping[str, Any], skin: float
) -> None:
    """Put solids that do not move into a model.

    Parameters
    ----------
    mujoco : module
    spec : mujoco.MjSpec
    solids : sequence of Solid
    surface : mapping
        Contact parameters: ``condim``, ``solref``, ``solimp`` ...
    skin : float
        Thickness of a mesh's triangles: far below any depth of contact.

    Notes
    -----
    MuJoCo takes a mesh for its convex hull. A flexible surface that is pinned to the world keeps
    its triangles: each pushes back on its own, by springs that add up.
    """
    for i, solid in enumerate(solids):
        if solid.kind == "mesh":
            flex = spec.add_flex(name=f"mesh{i}", dim=2, radius=skin, vertbody=["world"], **surface)
            flex.vert = solid.outline.vertices.ravel()
            flex.elem = solid.outline.faces.ravel()
            continue
        spec.worldbody.add_geom(
            type=getattr(mujoco.mjtGeom, f"mjGEOM_{solid.kind.upper()}"),
            size=[*solid.size, *[0.0] * (3 - len(solid.size))],
            pos=solid.centre,
            quat=Rotation.from_matrix(solid.rotation).as_quat(scalar_first=True),
            **surface,
        )


def still_life(body: Body) -> tuple[Prop, ...]:
    """Give a body that stays where it is, as it is drawn."""
    return tuple(Prop("body", solid.outline, np.zeros((1, 1, 3))) for solid in body.solids)
