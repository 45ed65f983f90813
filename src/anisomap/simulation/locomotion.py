"""Locomotion: a sphere or cylinder rolls over uneven ground under gravity.

McGregor et al. (2011), section "Scenarios". Its parameters are in Text S1, which was not
available to us; defaults here were chosen for the reasons given. Lengths are in m, for a sphere of
radius 1 m.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from anisomap.base.immutable import Immutable
from anisomap.errors import AnisomapWarning, InputError
from anisomap.numerics.surfaces import Mesh, Points, TriangleSearch
from anisomap.simulation.body import Body
from anisomap.simulation.options import (
    REACH,
    SPACING,
    PhysicsOptions,
    Progress,
    Prop,
    ScenarioResult,
    no_progress,
    positive,
    report_frames,
)
from anisomap.simulation.physics import add_geom, add_ground, load_mujoco, new_model

_TRUNCATION = 4.0  # of the Gaussian, x its standard deviation
_ARRIVAL_DISTANCE = 1.5  # reaches from a goal
_GOAL_TIMEOUT = 10.0  # s
_MAX_TIMESTEP = 0.006  # s, for a body with a reach of 1 m at a gravity of 9.81 m/s2
_MAX_STEEPNESS = 0.35  # roughness / correlation length; on steeper ground the body stalls
_SETTLING_TIME = 1.0  # s
_MOVING_SPEED = 0.1  # x set speed
_MIN_HALF_WIDTH = 4.0  # x reach
# Limits for runs without a warning. A cylinder stops briefly to reverse.
_MAX_MEDIAN_SLIP, _MIN_SHARE_MOVING = 0.1, 0.9


@dataclass(frozen=True, eq=False)
class Terrain(Immutable):
    """Solid ground with heights on a square grid.

    heights (n, n): Rows are along y, columns along x. The centre of the grid is above the origin.
    cell: Grid spacing.
    """

    heights: NDArray[np.float64]
    cell: float

    @property
    def half_width(self) -> float:
        """Distance from the centre to each edge."""
        return self.cell * (len(self.heights) - 1) / 2

    @cached_property
    def mesh(self) -> Mesh:
        """Triangles of the ground; as in MuJoCo, diagonals go from (r, c) to (r + 1, c + 1)."""
        n = len(self.heights)
        across = self.cell * np.arange(n) - self.half_width
        x, y = np.meshgrid(across, across)
        index = np.arange(n * n).reshape(n, n)
        here, right, up, beyond = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
        faces = np.array([[here, right, beyond], [here, beyond, up]])
        vertices = np.column_stack([x.ravel(), y.ravel(), self.heights.ravel()])
        return Mesh(vertices, np.moveaxis(faces, 1, -1).reshape(-1, 3))

    @cached_property
    def distance(self) -> Callable[[Points], Points]:
        """Exact distance of points (n, 3) from the surface, shape (n,)."""
        return TriangleSearch(self.mesh).signed_distance

    def readings(self, points: Points, detection_radius: float) -> NDArray[np.float32]:
        """Read the ground with short-range proximity sensors. points (n, 3)."""
        found = np.zeros(len(points), dtype=np.float32)
        # The height above the highest peak is a lower bound of the distance.
        near = points[:, 2] - self.heights.max() < detection_radius
        found[near] = np.maximum(detection_radius - self.distance(points[near]), 0)
        return found


def bumpy_terrain(
    half_width: float, cell: float, roughness: float, correlation: float, rng: np.random.Generator
) -> Terrain:
    """Generate ground with smooth random bumps: white noise with a Gaussian filter."""
    n = 2 * int(np.ceil(half_width / cell)) + 1
    noise = rng.standard_normal((n, n))
    smooth = gaussian_filter(noise, correlation / cell, mode="reflect", truncate=_TRUNCATION)
    smooth -= smooth.mean()
    spread = float(np.sqrt(np.mean(smooth**2)))
    return Terrain(roughness / spread * smooth, cell)


@dataclass(frozen=True)
class LocomotionOptions(PhysicsOptions):
    """Options of locomotion. Defaults, for a sphere of 1 m, scale with the body.

    Parameters
    ----------
    half_width : float
        Distance from the middle of the ground to each edge, in m. 8: several turns of the body.
    roughness : float
        Root mean square height of the ground, in m. 0.1: a tenth of the body, so that it is touched
        in several places at once and does not stall.
    correlation : float
        Correlation length of the ground, in m, see
        `anisomap.simulation.locomotion.bumpy_terrain`. 0.5: half of the body, so that the
        two ends of a cylinder can be at different heights.
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
        Detection radius of the sensors, in m. 0.44: the sensor spacing of the sphere. It scales
        with the body.
    frame_interval : float
        Time between frames, in s. 0.05: the body moves by a tenth of its radius.
    timestep : float
        Longest step of the physics, in s. It is shortened to divide a frame into equal steps.
        0.005: a quarter of the time constant of contacts with the ground, 0.02 s.
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
    timestep: float = positive(0.005, "s")

    def __post_init__(self) -> None:
        super().__post_init__()
        bound = f"{_MAX_TIMESTEP:g} s for stable contacts with the ground"
        self.at_most("timestep", _MAX_TIMESTEP, bound)
        half, steepest = self.correlation / 2, _MAX_STEEPNESS * self.correlation
        self.at_most("cell", half, f"half of correlation ({half:g} m)")
        bound = f"{_MAX_STEEPNESS:g} x correlation ({steepest:g} m)"
        self.at_most("roughness", steepest, bound, "; the body would stall")

    @property
    def longest_step(self) -> float:
        """Longest step of the physics, in s."""
        return self.timestep


class Driver:
    """Torque controller that rolls a body towards random goals at a set speed.

    A cylinder rolls perpendicular to its axis while it slowly turns about the vertical.
    """

    def __init__(
        self, body: Body, terrain: Terrain, options: LocomotionOptions, rng: np.random.Generator
    ) -> None:
        self._mujoco, self._options, self._rng = load_mujoco(), options, rng
        solid = body.solids[0]
        self._is_cylinder, self._radius = solid.kind == "cylinder", solid.size[0]
        self._model = _build_model(body, terrain, options)
        self._data = self._mujoco.MjData(self._model)
        # The body starts at the centre, on the highest ground below it.
        middle, cells = len(terrain.heights) // 2, math.ceil(body.reach / terrain.cell)
        below = slice(middle - cells, middle + cells + 1)
        self._data.qpos[2] = float(terrain.heights[below, below].max()) + self._radius
        if self._is_cylinder:
            lying = Rotation.from_euler("y", 90, degrees=True)
            self._data.qpos[3:7] = lying.as_quat(scalar_first=True)
        # The torque reaches the set speed within a few frames.
        mass, inertia = float(self._model.body_mass[1]), float(self._model.body_inertia[1].max())
        self._gain = (inertia + mass * self._radius**2) / (2 * options.frame_interval)
        self._mujoco.mj_forward(self._model, self._data)
        self._goal_limit = options.half_width - 2 * _ARRIVAL_DISTANCE
        self._draw_goal()

    def step(self) -> None:
        """Apply the torque and advance the physics by one step."""
        data, options = self._data, self._options
        self._elapsed += options.step
        to_goal = self._goal - data.qpos[:2]
        # A cylinder turns slowly; near the edge, it heads for the centre if it moves outwards.
        outward = self._sense * self._ahead() * np.sign(data.qpos[:2]) > 0
        beyond = np.abs(data.qpos[:2]) > self._goal_limit
        if self._is_cylinder and (outward & beyond).any():
            self._set_goal(np.zeros(2))
        elif (
            np.hypot(*to_goal) < _ARRIVAL_DISTANCE
            or (self._is_cylinder and self._sense * (self._ahead() @ to_goal) < 0)  # passed it
            or self._elapsed > _GOAL_TIMEOUT
        ):
            self._draw_goal()
        to_goal = self._goal - data.qpos[:2]
        spin = np.array(data.cvel[1, :3])
        torque = self._gain * (self._target_spin(to_goal / np.hypot(*to_goal)) - spin)
        if self._is_cylinder:
            # Drive along the axis and steer about the vertical; the ground determines all else.
            axis = data.xmat[1].reshape(3, 3)[:, 2]
            torque = axis * (axis @ torque) + np.array([0, 0, torque[2]])
        data.xfrc_applied[1, 3:] = torque
        self._mujoco.mj_step(self._model, data)

    def measure(self) -> tuple[Any, ...]:
        """Measure the state of the body."""
        data = self._data
        self._mujoco.mj_forward(self._model, data)
        centre = np.array(data.xpos[1])
        spin, velocity = np.array(data.cvel[1, :3]), np.array(data.qvel[:3])
        slip = math.nan
        if data.ncon:
            deepest = data.contact.dist.argmin()  # this contact carries the load
            normal = data.contact.frame[deepest, :3]
            slide = velocity + np.cross(spin, data.contact.pos[deepest] - centre)
            slide -= (slide @ normal) * normal
            slip = float(np.linalg.norm(slide)) / self._options.speed
        overlap = max(0.0, -float(data.contact.dist.min(initial=0.0)))
        rotation = np.array(data.xmat[1]).reshape(3, 3)
        return centre, rotation, slip, float(np.linalg.norm(velocity)), overlap

    def _draw_goal(self) -> None:
        self._set_goal(self._rng.uniform(-self._goal_limit, self._goal_limit, size=2))

    def _set_goal(self, goal: NDArray[np.float64]) -> None:
        self._goal = goal
        self._elapsed = 0.0
        # A cylinder keeps its direction until it has reached or passed the goal.
        to_goal = self._goal - self._data.qpos[:2]
        self._sense = 1.0 if self._ahead() @ to_goal >= 0 else -1.0

    def _ahead(self) -> NDArray[np.float64]:
        """Return the rolling direction of the body for a spin about its axis."""
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


def _build_model(body: Body, terrain: Terrain, options: LocomotionOptions) -> Any:
    spec = new_model(options.step, options.gravity, "IMPLICITFAST")
    # Torsional and rolling friction are MuJoCo's defaults.
    surface = {"friction": [options.friction, 0.005, 0.0001], "condim": 3}
    add_ground(spec, terrain.heights, terrain.half_width, **surface)
    rolling = spec.worldbody.add_body()
    rolling.add_freejoint()
    add_geom(rolling, body.solids[0].kind, body.solids[0].size, mass=1, **surface)
    return spec.compile()


@dataclass(frozen=True, eq=False)
class Journey:
    """Motion of a rolling body.

    centres (T, 3), rotations (T, 3, 3), speeds (T,): Motion of the body.
    slips (T,): Surface speed at the contact, as a share of the set speed; NaN without contact.
    overlaps (T,): Depth of the body in the ground.
    """

    terrain: Terrain
    centres: NDArray[np.float64]
    rotations: NDArray[np.float64]
    slips: NDArray[np.float64]
    speeds: NDArray[np.float64]
    overlaps: NDArray[np.float64]

    def sensors(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sensor positions in each frame, shape (T, N, 3)."""
        rotated = np.einsum("tij,nj->tni", self.rotations, positions)
        return np.asarray(rotated + self.centres[:, None])


def can_roll(body: Body) -> bool:
    """Return whether a body is a single sphere or cylinder centred at the origin."""
    first = body.solids[0]
    rolls = first.kind in ("sphere", "cylinder") and not first.centre.any()
    return len(body.solids) == 1 and rolls


def locomotion(
    body: Body,
    n_frames: int,
    options: LocomotionOptions,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> ScenarioResult:
    """Simulate the body, a sphere or a cylinder, that rolls over uneven ground."""
    reach = body.reach
    scaled = options.scaled(1 / reach)
    unit = body.scaled(1 / reach)
    journey = simulate_journey(unit, n_frames, scaled, rng, progress)
    sensors = journey.sensors(unit.positions)
    readings = journey.terrain.readings(sensors.reshape(-1, 3), scaled.detection_radius)
    readings = reach * readings.reshape(n_frames, body.n_sensors)
    slip = float(np.nanmedian(journey.slips))
    moving = float(np.mean(journey.speeds > _MOVING_SPEED * scaled.speed))
    touched = float(np.mean((readings > 0).any(axis=0)))
    _warn_about(slip, moving, touched)
    if np.abs(journey.centres[:, :2]).max() > scaled.half_width:
        raise InputError("the body rolled off the ground; use a lower speed or a larger half_width")
    ground = journey.terrain.mesh
    ground = replace(ground, vertices=reach * ground.vertices)
    centres, rotations = reach * journey.centres[:, None], journey.rotations[:, None]
    return ScenarioResult(
        readings,
        (
            Prop("ground", ground, np.zeros((1, 1, 3))),
            *(Prop("body", solid.outline, centres, rotations) for solid in body.solids),
        ),
        facts={
            "timestep": options.step,
            "median_slip": slip,
            "share_moving": moving,
            "share_touched": touched,
            "deepest_overlap": reach * float(journey.overlaps.max()),
        },
        sensors=reach * sensors,
    )


def simulate_journey(
    body: Body,
    n_frames: int,
    options: LocomotionOptions,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> Journey:
    """Simulate the motion of the body; see `locomotion`."""
    if not can_roll(body):
        raise InputError(f"the body {body.name} does not roll; choose a sphere or a cylinder")
    if options.half_width < (least := _MIN_HALF_WIDTH * body.reach):
        raise InputError(f"half_width must be at least {least:g}, got {options.half_width:g}")
    terrain = bumpy_terrain(
        options.half_width, options.cell, options.roughness, options.correlation, rng
    )
    driver = Driver(body, terrain, options, rng)
    for _ in range(math.ceil(_SETTLING_TIME / options.step)):
        driver.step()
    states = []
    for frame in report_frames(n_frames, progress):
        for _ in range(options.steps_per_frame if frame else 0):
            driver.step()
        states.append(driver.measure())
    return Journey(terrain, *(np.array(column) for column in zip(*states, strict=True)))


def _warn_about(slip: float, moving: float, touched: float) -> None:
    problems = []
    if slip > _MAX_MEDIAN_SLIP:
        problems.append(f"it slid at {slip:.0%} of its speed: increase friction")
    if moving < _MIN_SHARE_MOVING:
        problems.append(f"it stood still in {1 - moving:.0%} of the frames: reduce roughness")
    if touched < 1:
        problems.append(
            f"only {touched:.0%} of the sensors touched the ground: increase the number of frames"
        )
    if problems:
        warnings.warn(f"the body did not roll well: {'; '.join(problems)}", AnisomapWarning, 3)
