"""Options of locomotion, and the driver that rolls the body."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anisomap.errors import InputError
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.options import (
    REACH,
    SPACING,
    ScenarioOptions,
    positive,
    steps_per_frame,
)
from anisomap.simulation.physics.elastic import geom_shape
from anisomap.simulation.physics.terrain import Terrain

_ARRIVAL_DISTANCE = 1.5  # reaches from a goal
_GOAL_TIMEOUT = 10.0  # s
_MAX_TIMESTEP = 0.006  # s, for a body with a reach of 1 m at a gravity of 9.81 m/s2
_MAX_STEEPNESS = 0.35  # roughness / correlation length; on steeper ground the body stalls
_ROUNDING = 1e-9  # relative error of scaled lengths


@dataclass(frozen=True)
class LocomotionOptions(ScenarioOptions):
    """Options of locomotion. Defaults are for the paper's sphere.

    They scale with the body, see `anisomap.simulation.options`.

    Parameters
    ----------
    half_width : float
        Distance from the middle of the ground to each edge, in m. 8: several turns of the body.
    roughness : float
        Root mean square height of the ground, in m. 0.1: a tenth of the body, so that it is touched
        in several places at once and does not stall.
    correlation : float
        Correlation length of the ground, in m, see
        `anisomap.simulation.physics.terrain.bumpy_terrain`. 0.5: half of the body, so that the two
        ends of a cylinder can be at different heights.
    cell : float
        Grid spacing of the ground, in m. 0.2: less than half of `correlation`, so that bumps are
        smooth; smaller cells cost time.
    speed : float
        Target speed, in m/s. 2: a sphere makes 32 turns in 2,000 frames.
    turning : float
        Largest angular speed about the vertical of a cylinder, in rad/s. 0.3: slow enough not to
        skid.
    gravity : float
        Gravitational acceleration, in m/s2. 9.81: for a body of 1 m; it scales with the body, so
        that bodies of all sizes move alike.
    friction : float
        Coefficient of sliding friction. 1: rubber on a dry floor, so that the body rolls instead of
        sliding.
    detection_radius : float
        Detection radius of the sensors, in m. 0.44: the sensor spacing of the sphere, with which it
        scales.
    frame_interval : float
        Time between frames, in s. 0.05: the body moves by a tenth of its radius.
    timestep : float
        Longest step of the physics, in s. It is shortened to divide a frame into equal steps.
        0.005: a quarter of the time constant of contacts with the ground, 0.02 s.

    Raises
    ------
    InputError
        If an option is not positive, the step is too long, the cells are too large for the bumps,
        or the ground is too steep.
    """

    half_width: float = positive(8.0, "m", REACH)
    roughness: float = positive(0.1, "m", REACH)
    correlation: float = positive(0.5, "m", REACH)
    cell: float = positive(0.2, "m", REACH)
    speed: float = positive(2.0, "m/s", REACH)
    turning: float = positive(0.3, "rad/s")
    gravity: float = positive(9.81, "m/s2", REACH)
    friction: float = positive(1.0)
    detection_radius: float = positive(0.44, "m", SPACING)
    frame_interval: float = positive(0.05, "s")
    timestep: float = positive(0.005, "s")

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.timestep > _MAX_TIMESTEP:
            raise InputError(
                f"timestep must be at most {_MAX_TIMESTEP:g} s for stable contacts with the "
                f"ground, got {self.timestep:g} s"
            )
        if self.cell > self.correlation / 2 * (1 + _ROUNDING):
            raise InputError(
                f"cell must be at most half of correlation ({self.correlation / 2:g} m), "
                f"got {self.cell:g} m"
            )
        steepest = _MAX_STEEPNESS * self.correlation
        if self.roughness > steepest * (1 + _ROUNDING):
            raise InputError(
                f"roughness must be at most {_MAX_STEEPNESS:g} x correlation ({steepest:g} m), "
                f"got {self.roughness:g} m; the body would stall"
            )

    @property
    def steps_per_frame(self) -> int:
        """Number of physics steps per frame."""
        return steps_per_frame(self.frame_interval, self.timestep)

    @property
    def step(self) -> float:
        """Effective step of the physics, in s."""
        return self.frame_interval / self.steps_per_frame


class Driver:
    """Torque controller that rolls a body towards random goals at a set speed.

    A sphere rolls in any direction. A cylinder rolls perpendicular to its axis, forwards or
    backwards, and turns slowly about the vertical at the same time.
    """

    def __init__(
        self,
        mujoco: ModuleType,
        body: Body,
        terrain: Terrain,
        options: LocomotionOptions,
        rng: np.random.Generator,
    ) -> None:
        self._mujoco, self._options, self._rng = mujoco, options, rng
        solid = body.solids[0]
        self._is_cylinder, self._radius = solid.kind == "cylinder", solid.size[0]
        self._model = _build_model(mujoco, body, terrain, options)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[2] = _height_below(terrain, body.reach) + self._radius
        if self._is_cylinder:
            lying = Rotation.from_euler("y", 90, degrees=True)
            self._data.qpos[3:7] = lying.as_quat(scalar_first=True)
        # The torque reaches the set speed within a few frames.
        mass, inertia = float(self._model.body_mass[1]), float(self._model.body_inertia[1].max())
        self._gain = (inertia + mass * self._radius**2) / (2 * options.frame_interval)
        mujoco.mj_forward(self._model, self._data)
        self._goal_limit = options.half_width - 2 * _ARRIVAL_DISTANCE
        self._set_goal(self._draw_goal())

    def step(self) -> None:
        """Apply the torque and advance the physics by one step."""
        data, options = self._data, self._options
        self._elapsed += options.step
        to_goal = self._goal - data.qpos[:2]
        if self._is_leaving():
            self._set_goal(np.zeros(2))
        elif (
            np.hypot(*to_goal) < _ARRIVAL_DISTANCE
            or self._has_passed(to_goal)
            or self._elapsed > _GOAL_TIMEOUT
        ):
            self._set_goal(self._draw_goal())
        to_goal = self._goal - data.qpos[:2]
        spin = np.array(data.cvel[1, :3])
        torque = self._gain * (self._target_spin(to_goal / np.hypot(*to_goal)) - spin)
        if self._is_cylinder:
            # Drive along the axis and steer about the vertical; the ground determines the rest.
            axis = data.xmat[1].reshape(3, 3)[:, 2]
            torque = axis * (axis @ torque) + np.array([0, 0, torque[2]])
        data.xfrc_applied[1, 3:] = torque
        self._mujoco.mj_step(self._model, data)

    def measure(self) -> tuple[Any, ...]:
        """Measure the state of the body.

        Returns
        -------
        tuple
            Centre (3,), rotation (3, 3), slip (speed of the surface at the contact as a share of
            the set speed; NaN without contact), speed of the centre, and depth in the ground.
        """
        data = self._data
        self._mujoco.mj_forward(self._model, data)
        centre = np.array(data.xpos[1])
        spin, velocity = np.array(data.cvel[1, :3]), np.array(data.qvel[:3])
        slip = math.nan
        if data.ncon:
            arms = np.array(data.contact.pos) - centre
            depths = -np.array(data.contact.dist)
            slides = velocity + np.cross(spin, arms)
            normals = np.array(data.contact.frame)[:, :3]
            slides -= np.einsum("cd,cd->c", slides, normals)[:, None] * normals
            # The deepest contact carries the load.
            slip = float(np.linalg.norm(slides[depths.argmax()])) / self._options.speed
        overlap = max(0.0, -float(data.contact.dist.min(initial=0.0)))
        rotation = np.array(data.xmat[1]).reshape(3, 3)
        return centre, rotation, slip, float(np.linalg.norm(velocity)), overlap

    def _draw_goal(self) -> NDArray[np.float64]:
        return self._rng.uniform(-self._goal_limit, self._goal_limit, size=2)

    def _set_goal(self, goal: NDArray[np.float64]) -> None:
        self._goal = goal
        self._elapsed = 0.0
        # A cylinder keeps rolling forwards or backwards until it has reached or passed its goal.
        to_goal = self._goal - self._data.qpos[:2]
        self._sense = 1.0 if self._ahead() @ to_goal >= 0 else -1.0

    def _has_passed(self, to_goal: NDArray[np.float64]) -> bool:
        """Return whether a cylinder has passed its goal."""
        return self._is_cylinder and bool(self._sense * (self._ahead() @ to_goal) < 0)

    def _is_leaving(self) -> bool:
        """Return whether a cylinder, which turns slowly, is near the edge and moving outwards."""
        place = self._data.qpos[:2]
        outward = self._sense * self._ahead() * np.sign(place) > 0
        beyond = np.abs(place) > self._goal_limit
        return self._is_cylinder and bool((outward & beyond).any())

    def _ahead(self) -> NDArray[np.float64]:
        """Return the direction in which the body rolls when it spins about its own axis."""
        # A body with spin a on the ground rolls along the cross product of a and the vertical.
        axis = self._data.xmat[1].reshape(3, 3)[:, 2]
        return np.array([axis[1], -axis[0]]) / max(float(np.hypot(axis[0], axis[1])), 1e-9)

    def _target_spin(self, direction: NDArray[np.float64]) -> NDArray[np.float64]:
        rate = self._options.speed / self._radius
        if not self._is_cylinder:
            return rate * np.array([-direction[1], direction[0], 0])
        axis = self._data.xmat[1].reshape(3, 3)[:, 2]
        heading = self._sense * self._ahead()
        off = math.atan2(heading[0] * direction[1] - heading[1] * direction[0], heading @ direction)
        turning = min(max(off, -self._options.turning), self._options.turning)
        return np.asarray(self._sense * rate * axis + np.array([0, 0, turning]))


def _height_below(terrain: Terrain, reach: float) -> float:
    """Return the height of the highest ground below a body in the middle."""
    middle, cells = len(terrain.heights) // 2, math.ceil(reach / terrain.cell)
    below = slice(middle - cells, middle + cells + 1)
    return float(terrain.heights[below, below].max())


def _build_model(
    mujoco: ModuleType, body: Body, terrain: Terrain, options: LocomotionOptions
) -> Any:
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, -options.gravity]
    spec.option.timestep = options.step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    lowest, highest = float(terrain.heights.min()), float(terrain.heights.max())
    n = len(terrain.heights)
    half = terrain.half_width
    spec.add_hfield(
        name="ground",
        nrow=n,
        ncol=n,
        size=[half, half, highest - lowest, 1.0],
        userdata=((terrain.heights - lowest) / (highest - lowest)).ravel(),
    )
    # Torsional and rolling friction are MuJoCo's defaults.
    surface = {"friction": [options.friction, 0.005, 0.0001], "condim": 3}
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="ground", pos=[0, 0, lowest], **surface
    )
    rolling = spec.worldbody.add_body()
    rolling.add_freejoint()
    rolling.add_geom(**geom_shape(mujoco, body.solids[0]), mass=1, **surface)
    return spec.compile()
