"""Bombardment: elastic balls fly about a body fixed in the middle of a box without gravity.

McGregor et al. (2011), section "Scenarios". Its parameters are in Text S1, which was not
available to us; defaults here were chosen for the reasons given. Lengths are in m, for a sphere of
radius 1 m.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.numerics.ranges import COUNT, Range
from anisomap.simulation import solids
from anisomap.simulation.body import Body
from anisomap.simulation.kinematic import read_balls
from anisomap.simulation.options import (
    REACH,
    PhysicsOptions,
    Progress,
    Prop,
    ScenarioResult,
    no_progress,
    option,
    positive,
    report_frames,
    static_props,
)
from anisomap.simulation.physics import add_geom, add_solid, load_mujoco, new_model

ENERGY_TOLERANCE = 0.02
"""Maximum relative change of energy of a run without a warning."""

_LEMNISCATE = 2.6220575542921198  # duration of a contact with a cubic spring, x depth / speed
_WIDTH = 3  # x softness: the depth of a ball nine times as fast as `speed`
# Impedance increases linearly with depth. The first value is the minimum in MuJoCo.
_IMPEDANCE_AT_SURFACE, _IMPEDANCE_INSIDE = 0.0001, 0.01
_STEPS_PER_CONTACT = 16
_MIN_STEPS_PER_CONTACT = 10  # energy varies by 0.2 % over 2,000 frames with 10, by 14 % with 7
_MAX_SOFTNESS = 0.25  # x radius of a ball
_MAX_ATTEMPTS = 2000  # to place a ball


@dataclass(frozen=True)
class BombardmentOptions(PhysicsOptions):
    """Options of a bombardment. Defaults, for a sphere of 1 m, scale with the body.

    Parameters
    ----------
    box_half_width : float
        Distance from the middle of the box to each wall, in m. 3: two body radii of free flight, so
        that balls arrive from all directions.
    n_balls : int
        Number of balls. 40: they fill 2 % of the box, and 86 % of the readings are zero, as on real
        skin.
    ball_radius : float
        Radius of the balls, in m. 0.3: below the sensor spacing of the sphere (0.43), so that
        contacts are local, and above half of it, so that no contact falls between sensors.
    speed : float
        Root mean square speed of the balls, in m/s. 3: a ball crosses the box in 2 s, and the body
        is hit about 400 times in 2,000 frames.
    detection_radius : float
        Detection radius of the sensors, in m. 0.44: about the sensor spacing of the sphere, so that
        mostly neighbours respond to the same contact. It scales with the body, so that balls are in
        range for several frames at any density of sensors. It has the largest effect on map
        quality: r-ANISOMAP reaches a Mantel r of .90 with 0.35, .94 with 0.4 and .96 with 0.44 on
        the sphere (means of 30 seeds), and .85, .95, .98 with 0.3 and .91, .98, .99 with 0.44 on
        the cylinder, the Y-shape and the plane (means of 3).
    one_sided : int
        1 if sensors read only balls in front of the skin. 0: as in the paper, sensors read all
        balls within their range, even through a thin body.
    frame_interval : float
        Time between frames, in s. 0.05: a ball is in range of a sensor for about six frames.
    softness : float
        Depth of a contact at `speed`, in m; depth is proportional to the square root of the speed.
        0.02: small compared to a ball. At most a quarter of the radius of a ball.
    timestep : float, optional
        Longest step of the physics, in s. It is shortened to divide a frame into equal steps.
        Default: a sixteenth of a contact, 1.1 ms with the other defaults.
    """

    box_half_width: float = positive(3.0, "m", REACH)
    n_balls: int = option(40, COUNT)
    ball_radius: float = positive(0.3, "m", REACH)
    speed: float = positive(3.0, "m/s", REACH)
    detection_radius: float = positive(0.44, "m", REACH)
    one_sided: int = option(0, Range("0 or 1", lambda value: value in (0, 1), whole=True))
    softness: float = positive(0.02, "m", REACH)
    timestep: float | None = positive(None, "s")

    def __post_init__(self) -> None:
        super().__post_init__()
        softest = _MAX_SOFTNESS * self.ball_radius
        bound = f"{softest:g} m, a quarter of the ball radius"
        self.at_most("softness", softest, bound, "; fast balls would pass through each other")
        if self.timestep is not None:
            longest = self.contact_duration / _MIN_STEPS_PER_CONTACT
            bound = f"{longest:.3g} s for contacts of {self.contact_duration:.3g} s"
            self.at_most("timestep", longest, bound, "; energy would not be conserved")

    @property
    def contact(self) -> dict[str, Any]:
        """Parameters of contacts in MuJoCo, with the force of a cubic spring and no friction.

        With an impedance (see "Solver parameters" in MuJoCo's documentation) near 1, a ball that
        touches two objects simultaneously can gain energy, for any step; near 0, forces add up. The
        impedance increases from 0 with depth x, so that the acceleration, ``stiffness (x / width)^2
        x``, starts smoothly: otherwise, the integrator's error depends on the phase.
        """
        width = _WIDTH * self.softness
        stiffness = 2 * (self.speed * width / self.softness**2) ** 2
        midpoint, power = 0.5, 1.0
        return {
            "condim": 1,
            "solref": [-stiffness, 0.0],  # no damping
            "solimp": [_IMPEDANCE_AT_SURFACE, _IMPEDANCE_INSIDE, width, midpoint, power],
        }

    @property
    def contact_duration(self) -> float:
        """Duration of a contact at `speed`, in s."""
        return _LEMNISCATE * self.softness / self.speed

    @property
    def longest_step(self) -> float:
        """Longest step of the physics, in s."""
        return self.timestep or self.contact_duration / _STEPS_PER_CONTACT


@dataclass(frozen=True, eq=False)
class Flight:
    """Flight of the balls from the initial state.

    centres (T, B, 3): Centres of the balls. energies (T,): Kinetic energy plus energy in contacts.
    overlaps (T,): Depth of the deepest contact; 0 without contacts.
    """

    centres: NDArray[np.float64]
    energies: NDArray[np.float64]
    overlaps: NDArray[np.float64]

    @property
    def energy_drift(self) -> float:
        """Largest relative deviation from the first energy, of means over tenths of the run."""
        tenths = np.array_split(self.energies, min(10, self.energies.size))
        return max(abs(float(tenth.mean()) / float(self.energies[0]) - 1) for tenth in tenths)


def bombardment(
    body: Body,
    n_frames: int,
    options: BombardmentOptions,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> ScenarioResult:
    """Simulate elastic balls that bounce off the body in a box without gravity."""
    # MuJoCo's tolerances suit lengths of about 1, so the body is scaled to a reach of 1.
    reach = body.reach
    flight = simulate_flight(
        body.scaled(1 / reach), n_frames, options.scaled(1 / reach), rng, progress
    )
    if flight.energy_drift > ENERGY_TOLERANCE:
        warnings.warn(
            f"the energy of the balls changed by {flight.energy_drift:.1%}; use a timestep below "
            f"{options.step:g} s, or fewer balls",
            AnisomapWarning,
            stacklevel=2,
        )
    centres = reach * flight.centres
    box = solids.box(3 * (options.box_half_width,)).outline
    room = Prop("room", box, np.zeros((1, 1, 3)))
    radii = np.full(options.n_balls, options.ball_radius)
    balls = Prop("stimulus", solids.coarse_ball(), centres, scales=radii)
    normals = body.normals if options.one_sided else None
    return ScenarioResult(
        read_balls(body.positions, centres, options.ball_radius, options.detection_radius, normals),
        (*static_props(body), room, balls),
        facts={
            "timestep": options.step,
            "energy_drift": flight.energy_drift,
            "deepest_overlap": reach * float(flight.overlaps.max()),
        },
    )


def simulate_flight(
    body: Body,
    n_frames: int,
    options: BombardmentOptions,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> Flight:
    """Simulate the flight of the balls; see `bombardment`."""
    mujoco = load_mujoco()
    centres = _place_balls(body, options, rng)
    model = _build_model(body, options)
    data = mujoco.MjData(model)
    data.qpos[:] = centres.ravel()
    # The Maxwell distribution is the equilibrium of collisions.
    velocities = rng.standard_normal((options.n_balls, 3)) * options.speed
    mean_square = np.mean(np.sum(velocities**2, axis=1))
    data.qvel[:] = (velocities * (options.speed / math.sqrt(mean_square))).ravel()
    flight = Flight(
        np.empty((n_frames, options.n_balls, 3)), np.empty(n_frames), np.empty(n_frames)
    )
    for frame in report_frames(n_frames, progress):
        if frame:
            mujoco.mj_step(model, data, nstep=options.steps_per_frame)
        mujoco.mj_forward(model, data)
        flight.centres[frame] = data.qpos.reshape(-1, 3)
        # The energy stored in contacts of cubic springs; efc_pos is minus the depth.
        stored = -data.efc_force @ data.efc_pos / 4
        velocities = data.qvel + options.step / 2 * data.qacc
        flight.energies[frame] = velocities @ velocities / 2 + stored
        flight.overlaps[frame] = max(0.0, -data.efc_pos.min(initial=0.0))
    return flight


def _place_balls(
    body: Body, options: BombardmentOptions, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Place balls by random sequential rejection, without contact."""
    radius, half = options.ball_radius, options.box_half_width
    least = body.reach + 2 * radius
    if half <= least:
        raise InputError(
            f"balls of {radius:g} m radius do not fit between the body and the walls: "
            f"box_half_width must exceed {least:g} m, got {half:g} m"
        )
    placed = np.empty((options.n_balls, 3))
    n_placed = failures = 0
    while n_placed < options.n_balls:
        centre = rng.uniform(radius - half, half - radius, size=3)
        gaps = np.linalg.norm(placed[:n_placed] - centre, axis=1) - radius
        if (gaps > radius).all() and body.distance(centre[None])[0] > radius:
            placed[n_placed] = centre
            n_placed, failures = n_placed + 1, 0
        elif (failures := failures + 1) == _MAX_ATTEMPTS:
            raise InputError(
                f"only {n_placed} of {options.n_balls} balls of {radius:g} m radius fit into a "
                f"box of half-width {half:g} m; use fewer or smaller balls, or a larger box"
            )
    return placed


def _build_model(body: Body, options: BombardmentOptions) -> Any:
    """Build a model of balls that slide along x, y and z, with limits of joints as walls."""
    spec = new_model(options.step, 0, "EULER")  # symplectic: energy does not drift
    surface = options.contact
    for solid in body.solids:
        add_solid(spec, solid, **surface)
    limit = options.box_half_width - options.ball_radius
    for _ in range(options.n_balls):
        ball = spec.worldbody.add_body()
        add_geom(ball, "sphere", (options.ball_radius,), mass=1, **surface)
        for axis in np.eye(3):
            ball.add_joint(
                type=load_mujoco().mjtJoint.mjJNT_SLIDE,
                axis=axis,
                range=[-limit, limit],
                solref_limit=surface["solref"],
                solimp_limit=surface["solimp"],
            )
    return spec.compile()
