"""MuJoCo models: solids and ground with contacts.

Running a simulation requires MuJoCo; importing this module does not.
"""

from __future__ import annotations

import logging
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anisomap.errors import import_extra
from anisomap.simulation.solids import Solid

_MESH_THICKNESS = 1e-6  # x reach
_logger = logging.getLogger(__name__)


def load_mujoco() -> ModuleType:
    """Import MuJoCo; its warnings are logged instead of printed and written to a file."""
    mujoco: ModuleType = import_extra("mujoco", "simulating a recording", "simulation")
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda text: _logger.info("MuJoCo warns: %s", text))
    return mujoco


def new_model(step: float, gravity: float, integrator: str) -> Any:
    """Begin a model. step in s; integrator: end of the name in ``mjtIntegrator``."""
    mujoco = load_mujoco()
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, -gravity]
    spec.option.timestep = step
    spec.option.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    return spec


def add_solid(spec: Any, solid: Solid, **contact: Any) -> None:
    """Add a fixed solid; a mesh is added as a flexible surface pinned to the world.

    MuJoCo would replace a mesh geom by its convex hull.
    """
    if solid.kind == "mesh":
        thickness = _MESH_THICKNESS * solid.reach
        name = f"mesh{len(spec.flexes)}"
        flex = spec.add_flex(name=name, dim=2, radius=thickness, vertbody=["world"], **contact)
        flex.vert, flex.elem = solid.outline.vertices.ravel(), solid.outline.faces.ravel()
    else:
        rotation = Rotation.from_matrix(solid.rotation.copy())  # SciPy 1.15 requires writable input
        turn = rotation.as_quat(scalar_first=True)
        add_geom(spec.worldbody, solid.kind, solid.size, pos=solid.centre, quat=turn, **contact)


def add_geom(body: Any, kind: str, size: tuple[float, ...], **options: Any) -> None:
    """Add a geom to a body; kind and size as in `Solid`."""
    shape = getattr(load_mujoco().mjtGeom, f"mjGEOM_{kind.upper()}")
    body.add_geom(type=shape, size=[*size, *[0.0] * (3 - len(size))], **options)


def add_ground(spec: Any, heights: NDArray[np.float64], half_width: float, **contact: Any) -> None:
    """Add fixed ground. heights (n, n): rows are along y, columns along x."""
    lowest, relief, n = float(heights.min()), float(np.ptp(heights)), len(heights)
    spec.add_hfield(
        name="ground",
        nrow=n,
        ncol=n,
        size=[half_width, half_width, relief, 1.0],
        userdata=((heights - lowest) / relief).ravel(),
    )
    add_geom(spec.worldbody, "hfield", (), hfieldname="ground", pos=[0, 0, lowest], **contact)
