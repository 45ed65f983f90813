"""Display of scenes with MuJoCo, in its interactive viewer or rendered off screen by EGL."""

from __future__ import annotations

import importlib
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anisomap.base.scene import Mesh, Prop, Scene
from anisomap.errors import AnisomapError
from anisomap.simulation.physics.models import load_mujoco
from anisomap.simulation.solids import coarse_ball

_COLOURS = {
    "ground": (0.72, 0.78, 0.66, 1.0),
    "body": (0.79, 0.81, 0.83, 1.0),
    "stimulus": (0.90, 0.62, 0.0, 0.8),
}
# Colours of sensors without a reading and with the largest reading: the ends of viridis.
_LOW, _HIGH = np.array([0.27, 0.0, 0.33, 1.0]), np.array([0.99, 0.91, 0.14, 1.0])
_SENSOR_RADIUS = 0.016  # x extent of the sensors
_CAMERA_DISTANCE = 1.35  # x extent of the scene


class NoScreenError(AnisomapError):
    """No display is available, and off-screen rendering is not possible."""


def render(
    scene: Scene, frames: Sequence[int], *, width: int = 960, height: int = 720
) -> list[NDArray[np.uint8]]:
    """Render frames of a scene off screen.

    Parameters
    ----------
    scene : Scene
    frames : sequence of int
    width, height : int
        Pixels.

    Returns
    -------
    list of ndarray of uint8, shape (height, width, 3)
        The body is grey and stimuli are orange. Sensors range from violet (no reading) to yellow
        (the largest reading of the recording).

    Raises
    ------
    NoScreenError
        If EGL is not available.
    MissingExtraError
        If MuJoCo is not installed.
    """
    load_mujoco()
    # A separate process, since a graphics library that fails to start may end the process.
    try:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            return pool.submit(_render_here, scene, list(frames), width, height).result()
    except (BrokenProcessPool, ImportError, AttributeError, OSError, RuntimeError) as error:
        raise NoScreenError(
            f"MuJoCo cannot render off screen, which requires EGL: {error}"
        ) from error


def _render_here(
    scene: Scene, frames: list[int], width: int, height: int
) -> list[NDArray[np.uint8]]:
    os.environ["MUJOCO_GL"] = "egl"  # must be set before MuJoCo is imported
    mujoco = load_mujoco()
    visual = _VisualModel(scene, width, height)
    model = visual.model
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(model, camera)
    camera.azimuth, camera.elevation = 120, -25
    camera.distance = _CAMERA_DISTANCE * model.stat.extent
    pixels = []
    with mujoco.Renderer(model, height, width, max_geom=model.ngeom + 100) as renderer:
        for frame in frames:
            visual.pose(frame)
            renderer.update_scene(visual.data, camera)
            pixels.append(np.array(renderer.render(), dtype=np.uint8))
    return pixels


def show(scene: Scene) -> None:
    """Play a scene in MuJoCo's viewer until its window is closed."""
    named = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not (named or sys.platform in ("darwin", "win32")):
        raise NoScreenError("MuJoCo's viewer needs a display, and none is available")
    visual = _VisualModel(scene)
    viewer = importlib.import_module("mujoco.viewer")
    step = float(np.median(np.diff(scene.times))) if scene.n_frames > 1 else 1.0
    frame = 0
    with viewer.launch_passive(visual.model, visual.data) as window:
        while window.is_running():
            visual.pose(frame)
            window.sync()
            time.sleep(step)
            frame = (frame + 1) % scene.n_frames


class _VisualModel:
    """A MuJoCo model for display: one mocap body per object, then one per sensor."""

    def __init__(self, scene: Scene, width: int = 960, height: int = 720) -> None:
        self._mujoco = mujoco = load_mujoco()
        self._scene = scene
        self._spec = spec = mujoco.MjSpec()
        spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
        spec.visual.headlight.ambient = [0.45, 0.45, 0.45]
        spec.visual.headlight.diffuse = [0.6, 0.6, 0.6]
        spec.add_texture(
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
            rgb1=[1, 1, 1],
            width=64,
            height=384,
        )
        self._objects: list[tuple[Prop, int]] = []
        self._meshes: dict[tuple[int, float], str] = {}
        for prop in scene.props:
            if prop.role in _COLOURS:
                count = prop.centres.shape[1]
                for i, scale in enumerate(np.ones(count) if prop.scales is None else prop.scales):
                    self._add(prop.mesh, float(scale), _COLOURS[prop.role])
                    self._objects.append((prop, i))
        marker = coarse_ball()
        radius = _SENSOR_RADIUS * float(np.ptp(scene.sensors[0], axis=0).max())
        for _ in range(scene.sensors.shape[1]):
            self._add(marker, radius, tuple(_LOW))
        corners = np.vstack([s for p in scene.props if p.role != "ground" for s in p.surfaces(0)])
        spec.stat.extent = float(np.ptp(corners, axis=0).max())
        spec.stat.center = (corners.min(axis=0) + corners.max(axis=0)) / 2
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)

    def _add(self, mesh: Mesh, scale: float, colour: tuple[float, ...]) -> None:
        spec, key = self._spec, (id(mesh), scale)
        if key not in self._meshes:
            self._meshes[key] = f"mesh{len(self._meshes)}"
            spec.add_mesh(
                name=self._meshes[key],
                uservert=scale * mesh.vertices.ravel(),
                userface=mesh.faces.ravel(),
                # The ground is an open mesh.
                inertia=self._mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
            )
        spec.worldbody.add_body(mocap=True).add_geom(
            type=self._mujoco.mjtGeom.mjGEOM_MESH,
            meshname=self._meshes[key],
            rgba=colour,
            contype=0,
            conaffinity=0,
        )

    def pose(self, frame: int) -> None:
        """Move objects and sensors to their places in a frame; colour sensors by readings."""
        scene, data, n_objects = self._scene, self.data, len(self._objects)
        for index, (prop, i) in enumerate(self._objects):
            turn = np.eye(3)
            if prop.rotations is not None:
                turn = prop.rotations[frame % len(prop.rotations)][i]
            data.mocap_pos[index] = prop.centres[frame % len(prop.centres)][i]
            data.mocap_quat[index] = Rotation.from_matrix(turn).as_quat(scalar_first=True)
        data.mocap_pos[n_objects:] = scene.sensors[frame % len(scene.sensors)]
        level = scene.readings[frame] / (float(np.nanmax(scene.readings)) or 1.0)
        self.model.geom_rgba[n_objects:] = _LOW + np.nan_to_num(level)[:, None] * (_HIGH - _LOW)
        self._mujoco.mj_forward(self.model, data)
