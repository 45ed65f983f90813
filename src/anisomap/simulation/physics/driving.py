"""What makes a body roll: the parameters of a locomotion, and the driver that follows them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anisomap.errors import InputError
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.checks import check_positive
from anisomap.simulation.options import REACH, SPACING, parameter
from anisomap.simulation.physics.terrain import Terrain

_ARRIVED = 1.5  # reaches from a place that was headed for
_PATIENCE = 10.0  # seconds
_LONGEST_STEP = 0.006  # seconds, for a body that reaches to 1 m and gravity of 9.81 m/s2
_STEEPEST = 0.35  # roughness over correlation length; the drive stalls on steeper ground


@dataclass(frozen=True)
class LocomotionOptions:
    """Parameters of a locomotion; defaults are for the paper's sphere, see `simulation.options`.

    Parameters
    ----------
    half_width : float
        Metres from the middle of the ground to each edge. 8: some turns of the body in a line.
    roughness : float
        Root mean square of the ground's height, metres. 0.1: a tenth of the body, so that it
        wavers and is touched at several places at once, and never stalls.
    correlation : float
        Width of the bumps in metres: see
        `anisomap.simulation.physics.terrain.bumpy_terrain`. 0.5: half the
        body, so that one end of a cylinder can be up while the other is down.
    cell : float
        Metres between the points of the ground whose height is given. 0.2: less than half of
        `correlation`, so that bumps are smooth, and not much less, which would only cost time.
    speed : float
        Metres a second at which the drive rolls the body. 2: in 2,000 frames a sphere turns over
        32 times.
    turning : float
        Most radians a second at which a cylinder, which cannot simply change its direction, is
        turned about the vertical. 0.3: slow enough not to skid.
    gravity : float
        Metres a second squared. 9.81 on a body of 1 m; it grows with the body, so that a small
        one moves as a large one does.
    friction : float
        Of body and ground, sliding. 1: rubber on a dry floor; it rolls and does not slide.
    detection_radius : float
        Metres. 0.44: the distance between neighbouring sensors of the sphere; it grows with that.
    frame_interval : float
        Seconds between frames. 0.05: the body moves by a tenth of its radius.
    timestep : float
        Longest step of the physics, seconds; it is shortened until a whole number makes a frame.
        0.005: the ground is given as springs that settle in 0.02 s.

    Raises
    ------
    InputError
        If a parameter is not positive, the step is too long, the cells are too large for the
        bumps, or the ground is too steep.
    """

    half_width: float = parameter(8.0, "m", REACH)
    roughness: float = parameter(0.1, "m", REACH)
    correlation: float = parameter(0.5, "m", REACH)
    cell: float = parameter(0.2, "m", REACH)
    speed: float = parameter(2.0, "m/s", REACH)
    turning: float = 0.3
    gravity: float = parameter(9.81, "m/s2", REACH)
    friction: float = 1.0
    detection_radius: float = parameter(0.44, "m", SPACING)
    frame_interval: float = 0.05
    timestep: float = 0.005

    def __post_init__(self) -> None:
        for name in ("half_width", "roughness", "correlation", "cell", "detection_radius"):
            check_positive(name, getattr(self, name), "m")
        check_positive("speed", self.speed, "m/s")
        check_positive("turning", self.turning, "rad/s")
        check_positive("gravity", self.gravity, "m/s2")
        check_positive("friction", self.friction)
        check_positive("frame_interval", self.frame_interval, "s")
        check_positive("timestep", self.timestep, "s")
        if self.timestep > _LONGEST_STEP:
            raise InputError(
                f"timestep is {self.timestep:g} s, too long for contacts with the ground, which "
                f"would sink in or bounce off; take at most {_LONGEST_STEP:g} s"
            )
        if self.cell > self.correlation / 2 * (1 + 1e-9):
            raise InputError(
                f"cell is {self.cell:g} m, too large for bumps with a correlation length of "
                f"{self.correlation:g} m; take at most half of that"
            )
        if self.roughness > _STEEPEST * self.correlation * (1 + 1e-9):
            raise InputError(
                f"roughness is {self.roughness:g} m, too much for bumps with a correlation length "
                f"of {self.correlation:g} m: the body could not climb them; take at most "
                f"{_STEEPEST * self.correlation:g} m"
            )

    @property
    def steps_a_frame(self) -> int:
        """How many steps of the physics make a frame."""
        return max(1, math.ceil(self.frame_interval / self.timestep * (1 - 1e-12)))

    @property
    def step(self) -> float:
        """The step of the physics as it is taken, in seconds."""
        return self.frame_interval / self.steps_a_frame

    def scaled(self, factor: float) -> LocomotionOptions:
        """Give the same locomotion in another unit of length, or of a body as much larger."""
        lengths = ("half_width", "roughness", "correlation", "cell", "speed", "gravity")
        scaled = {name: factor * getattr(self, name) for name in (*lengths, "detection_radius")}
        return replace(self, **scaled)


class Driver:
    """Turns a body towards places chosen at random, as a motor with a set speed would.

    A sphere is rolled in any direction. A cylinder rolls to and fro across its axis, and is turned
    slowly about the vertical while it does.
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
        self._kind, self._radius = solid.kind, solid.size[0]
        self._model = _build(mujoco, body, terrain, options)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[2] = _highest(terrain, body.reach) + self._radius
        if self._kind == "cylinder":
            lying = Rotation.from_euler("y", 90, degrees=True)
            self._data.qpos[3:7] = lying.as_quat(scalar_first=True)
        # A torque that closes the gap to the set speed within a few frames.
        mass, inertia = float(self._model.body_mass[1]), float(self._model.body_inertia[1].max())
        self._gain = (inertia + mass * self._radius**2) / (2 * options.frame_interval)
        mujoco.mj_forward(self._model, self._data)
        self._room = options.half_width - 2 * _ARRIVED
        self._set_out(rng.uniform(-self._room, self._room, size=2))

    def step(self) -> None:
        """Push the body as a motor would, and let a step of the physics pass."""
        data, options = self._data, self._options
        self._waited += options.step
        way = self._goal - data.qpos[:2]
        if self._strays():
            self._set_out(np.zeros(2))
        elif np.hypot(*way) < _ARRIVED or self._missed(way) or self._waited > _PATIENCE:
            self._set_out(self._rng.uniform(-self._room, self._room, size=2))
        way = self._goal - data.qpos[:2]
        spin = np.array(data.cvel[1, :3])
        wanted = self._wanted_spin(way / np.hypot(*way))
        push = self._gain * (wanted - spin)
        if self._kind == "cylinder":
            # The motor works along the axis, the steering about the vertical; the ground does
            # the rest.
            axis = data.xmat[1].reshape(3, 3)[:, 2]
            push = axis * (axis @ push) + np.array([0, 0, push[2]])
        data.xfrc_applied[1, 3:] = push
        self._mujoco.mj_step(self._model, data)

    def look(self) -> tuple[Any, ...]:
        """Tell where the body is and how it moves.

        Returns
        -------
        tuple
            Its centre (3,), its rotation (3, 3), how fast its surface slides over the ground as a
            share of the set speed (NaN in the air), the speed of its centre, and how deep it is in
            the ground.
        """
        data = self._data
        self._mujoco.mj_forward(self._model, data)
        centre = np.array(data.xpos[1])
        spin, velocity = np.array(data.cvel[1, :3]), np.array(data.qvel[:3])
        slip = math.nan
        if data.ncon:
            arms = np.array(data.contact.pos) - centre
            forces = -np.array(data.contact.dist)
            slides = velocity + np.cross(spin, arms)
            normals = np.array(data.contact.frame)[:, :3]
            slides -= np.einsum("cd,cd->c", slides, normals)[:, None] * normals
            # What presses most is what rolls.
            slip = float(np.linalg.norm(slides[forces.argmax()])) / self._options.speed
        overlap = max(0.0, -float(data.contact.dist.min(initial=0.0)))
        turned = np.array(data.xmat[1]).reshape(3, 3)
        return centre, turned, slip, float(np.linalg.norm(velocity)), overlap

    def _missed(self, way: NDArray[np.float64]) -> bool:
        return self._kind == "cylinder" and bool(self._forward * (self._ahead() @ way) < 0)

    def _strays(self) -> bool:
        """Tell whether a cylinder, whose turns are wide, heads for the edge of the ground."""
        place = self._data.qpos[:2]
        outward = self._forward * self._ahead() * np.sign(place) > 0
        return self._kind == "cylinder" and bool((outward & (np.abs(place) > self._room)).any())

    def _set_out(self, goal: NDArray[np.float64]) -> None:
        self._goal = goal
        self._waited = 0.0
        # Which way a cylinder rolls is settled until it has arrived or passed by.
        way = self._goal - self._data.qpos[:2]
        self._forward = 1.0 if self._ahead() @ way >= 0 else -1.0

    def _ahead(self) -> NDArray[np.float64]:
        """Give the direction in which the body rolls when it spins about its own axis."""
        # What spins about an axis a and stands on the ground rolls towards a x vertical.
        axis = self._data.xmat[1].reshape(3, 3)[:, 2]
        return np.array([axis[1], -axis[0]]) / max(float(np.hypot(axis[0], axis[1])), 1e-9)

    def _wanted_spin(self, way: NDArray[np.float64]) -> NDArray[np.float64]:
        pace = self._options.speed / self._radius
        if self._kind == "sphere":
            return pace * np.array([-way[1], way[0], 0])
        axis = self._data.xmat[1].reshape(3, 3)[:, 2]
        heading = self._forward * self._ahead()
        off = math.atan2(heading[0] * way[1] - heading[1] * way[0], heading @ way)
        turning = min(max(off, -self._options.turning), self._options.turning)
        return np.asarray(self._forward * pace * axis + np.array([0, 0, turning]))


def _highest(terrain: Terrain, reach: float) -> float:
    """Give the height of the highest ground under a body in the middle, to begin above it."""
    middle, cells = len(terrain.heights) // 2, math.ceil(reach / terrain.cell)
    below = slice(middle - cells, middle + cells + 1)
    return float(terrain.heights[below, below].max())


def _build(mujoco: ModuleType, body: Body, terrain: Terrain, options: LocomotionOptions) -> Any:
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
    grip = {"friction": [options.friction, 0.005, 0.0001], "condim": 3}
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="ground", pos=[0, 0, lowest], **grip
    )
    thing = spec.worldbody.add_body()
    thing.add_freejoint()
    solid = body.solids[0]
    thing.add_geom(
        type=getattr(mujoco.mjtGeom, f"mjGEOM_{solid.kind.upper()}"),
        size=[*solid.size, *[0.0] * (3 - len(solid.size))],
        mass=1,
        **grip,
    )
    return spec.compile()
