"""Bombardment: a body fixed in the middle of a zero-gravity box, elastic balls flying about it.

McGregor et al. (2011), section "Scenarios". The paper's values are lost with its Text S1; those
here are ours. Lengths are in metres, and the paper's sphere has a radius of 1 m.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import asdict, dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.scene import Prop
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.checks import check_count, check_positive
from anisomap.simulation.engine import load_mujoco
from anisomap.simulation.geometry import solids
from anisomap.simulation.options import REACH, parameter
from anisomap.simulation.physics.elastic import ElasticContact, total_energy
from anisomap.simulation.sensing import read_balls
from anisomap.simulation.world import Progress, Run, add_solids, still_life

ENERGY_TOLERANCE = 0.02
"""A run whose energy strays further than this share of it is not to be trusted."""

_STEPS_A_CONTACT = 16
_FEWEST_STEPS_A_CONTACT = 10  # 10 keep the energy to 0.2 % over 2,000 frames, 7 to 14 %
_SOFTEST = 0.25  # of the ball's radius
_PLACING_ATTEMPTS = 2000
_ROUNDING = 1e-9  # that scaled lengths may be off by
_SKIN = 1e-6  # thickness of a mesh's triangles, as a share of the body's reach


@dataclass(frozen=True)
class BombardmentOptions:
    """Parameters of a bombardment; defaults are for the paper's sphere, see `simulation.options`.

    Parameters
    ----------
    box_half_width : float
        Metres from the middle of the box to each wall. 3: two body radii of free flight beside
        the body, so that balls arrive from everywhere.
    n_balls : int
        40: they fill 2 % of the box, and 86 % of the readings are zero, as on real skin.
    ball_radius : float
        Metres; of balls of several sizes, the geometric mean. 0.3: below the 0.43 between
        neighbouring sensors of the sphere, so that a touch is local, and above half of it, so
        that no touch falls between sensors.
    size_ratio : float
        Radius of the largest ball over that of the smallest, at least 1; those between grow by
        equal ratios, and all have the same density. 1: all alike, as in the paper.
    speed : float
        Metres a second, root mean square over the balls. 3: a ball crosses the box in 2 s, so that
        the body is hit some 400 times in 2,000 frames.
    detection_radius : float
        Metres. 0.44: about the distance between neighbouring sensors of the sphere, so that
        neighbours feel a touch together and sensors further off hardly do. It grows with the
        body, so that balls are in range for some frames however densely the sensors stand. Of all
        parameters the one that decides how good a map gets: r-ANISOMAP reaches a Mantel r of .90
        with 0.35, of .94 with 0.4, of .96 with 0.44 on the sphere (means of 30 seeds), and .85,
        .95, .98 with 0.3 and .91, .98, .99 with 0.44 on cylinder, Y and plane (of 3).
    frame_interval : float
        Seconds between frames. 0.05: a ball is in a sensor's range for some six frames.
    softness : float
        Metres that a ball presses into what it meets at `speed`; at other speeds it is in
        proportion to their square root. 0.02: small beside the ball. At most a quarter of the
        smallest.
    timestep : float, optional
        Longest step of the physics, in seconds; it is shortened until a whole number of steps
        makes a frame. A sixteenth of a contact unless given: 1.1 ms with the other defaults.

    Raises
    ------
    InputError
        If a parameter is not positive, the balls are too soft, or the step is too long.
    """

    box_half_width: float = parameter(3.0, "m", REACH)
    n_balls: int = 40
    ball_radius: float = parameter(0.3, "m", REACH)
    size_ratio: float = 1.0
    speed: float = parameter(3.0, "m/s", REACH)
    detection_radius: float = parameter(0.44, "m", REACH)
    frame_interval: float = 0.05
    softness: float = parameter(0.02, "m", REACH)
    timestep: float | None = None

    def __post_init__(self) -> None:
        check_count("n_balls", self.n_balls)
        for name in ("box_half_width", "ball_radius", "detection_radius", "softness"):
            check_positive(name, getattr(self, name), "m")
        check_positive("speed", self.speed, "m/s")
        check_positive("frame_interval", self.frame_interval, "s")
        if not (math.isfinite(self.size_ratio) and self.size_ratio >= 1):
            raise InputError(f"size_ratio is {self.size_ratio:g}; it must be at least 1")
        smallest = float(self.radii.min())
        if self.softness > _SOFTEST * smallest * (1 + _ROUNDING):
            raise InputError(
                f"softness is {self.softness:g} m, too much for balls of {smallest:g} m "
                f"radius: fast ones would pass through; take at most {_SOFTEST * smallest:g} m"
            )
        if self.timestep is None:
            return
        check_positive("timestep", self.timestep, "s")
        longest = self.shortest_contact / _FEWEST_STEPS_A_CONTACT
        if self.timestep > longest * (1 + _ROUNDING):
            raise InputError(
                f"timestep is {self.timestep:g} s, too long for balls at {self.speed:g} m/s, whose "
                f"contacts last {self.shortest_contact:.3g} s: they would gain energy or pass "
                f"through; take at most {longest:.3g} s, or leave it out"
            )

    @property
    def radii(self) -> NDArray[np.float64]:
        """Radius of each ball, shape (n_balls,), the smallest first."""
        if self.n_balls == 1:
            return np.array([self.ball_radius])
        exponents = np.linspace(-0.5, 0.5, self.n_balls)
        return np.asarray(self.ball_radius * self.size_ratio**exponents)

    @property
    def masses(self) -> NDArray[np.float64]:
        """Mass of each ball, shape (n_balls,): 1 kg where the radius is `ball_radius`."""
        return np.asarray((self.radii / self.ball_radius) ** 3)

    @property
    def speeds(self) -> NDArray[np.float64]:
        """Root mean square speed that each ball has, by the equipartition of energy."""
        share = 1 / np.sqrt(self.masses)
        return np.asarray(self.speed * share / np.sqrt(np.mean(share**2)))

    @property
    def shortest_contact(self) -> float:
        """Seconds that a contact of the smallest, fastest balls lasts."""
        return self.contact.duration * math.sqrt(self.speed / float(self.speeds.max()))

    def scaled(self, factor: float) -> BombardmentOptions:
        """Give the same bombardment in another unit of length, or of a body as much larger."""
        lengths = ("box_half_width", "ball_radius", "speed", "detection_radius", "softness")
        return replace(self, **{name: factor * getattr(self, name) for name in lengths})

    @property
    def contact(self) -> ElasticContact:
        """How balls meet one another, the body and the walls."""
        return ElasticContact(self.softness, self.speed)

    @property
    def steps_a_frame(self) -> int:
        """How many steps of the physics make a frame."""
        step = self.timestep or self.shortest_contact / _STEPS_A_CONTACT
        return max(1, math.ceil(self.frame_interval / step * (1 - 1e-12)))

    @property
    def step(self) -> float:
        """The step of the physics as it is taken, in seconds."""
        return self.frame_interval / self.steps_a_frame


@dataclass(frozen=True, eq=False)
class Flight:
    """Where the balls were, and whether physics held.

    Attributes
    ----------
    centres : ndarray of shape (T, B, 3)
        Centres of the balls in each frame. Metres; frame 0 is the start.
    energies : ndarray of shape (T,)
        Kinetic energy and that stored in contacts. Joules.
    overlaps : ndarray of shape (T,)
        How deep the deepest contact of the frame was. Metres; 0 where nothing touched.
    """

    centres: NDArray[np.float64]
    energies: NDArray[np.float64]
    overlaps: NDArray[np.float64]

    @property
    def energy_drift(self) -> float:
        """How far the energy strayed from the first frame's, as a share of it.

        Of each tenth of the run the mean counts: within a contact, the energy of discrete steps
        swings to and fro by a per cent of a ball's.
        """
        tenths = np.array_split(self.energies, min(10, self.energies.size))
        return max(abs(float(tenth.mean()) / float(self.energies[0]) - 1) for tenth in tenths)


def bombardment(
    body: Body,
    n_frames: int,
    options: BombardmentOptions,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Run:
    """Record what a body's sensors read while balls bombard it.

    Parameters
    ----------
    body : Body
        Fixed in the middle of the box.
    n_frames : int
        Frames to record; the first is the start.
    options : BombardmentOptions
    rng : numpy.random.Generator
        Places the balls and sets them off.
    progress : callable, optional
        Told the share done, from 0 to 1.

    Returns
    -------
    Run

    Raises
    ------
    InputError
        If the balls do not fit into the box beside the body.
    MissingExtraError
        If MuJoCo is not installed.

    Warns
    -----
    AnisomapWarning
        If the energy strayed by more than `ENERGY_TOLERANCE`.
    """
    # The engine's tolerances suit lengths of about 1, whatever the size of the body.
    reach = body.reach
    flight = fly(body.scaled(1 / reach), n_frames, options.scaled(1 / reach), rng, progress)
    if flight.energy_drift > ENERGY_TOLERANCE:
        warnings.warn(
            f"the energy of the balls strayed by {flight.energy_drift:.1%}: "
            f"take a timestep below {options.step:g} s, or fewer balls",
            AnisomapWarning,
            stacklevel=2,
        )
    centres = reach * flight.centres
    readings = read_balls(body.positions, centres, options.radii, options.detection_radius)
    measured = {
        "energy_drift": flight.energy_drift,
        "deepest_overlap": reach * float(flight.overlaps.max()),
    }
    return Run(
        readings,
        rate_hz=1 / options.frame_interval,
        facts=asdict(options) | {"timestep": options.step} | measured,
        props=(
            *still_life(body),
            Prop("room", solids.box(3 * (options.box_half_width,)).outline, np.zeros((1, 1, 3))),
            Prop("stimulus", solids.drawn_ball(), centres, scales=options.radii),
        ),
        sensors=body.positions[None],
    )


def fly(
    body: Body,
    n_frames: int,
    options: BombardmentOptions,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Flight:
    """Let balls fly about a body; see `bombardment`."""
    mujoco = load_mujoco()
    centres = _place(body, options, rng)
    model = _build(mujoco, body, options)
    data = mujoco.MjData(model)
    data.qpos[:] = centres.ravel()
    data.qvel[:] = _set_off(options, rng).ravel()
    masses = np.repeat(options.masses, 3)
    flight = Flight(
        np.empty((n_frames, options.n_balls, 3)), np.empty(n_frames), np.empty(n_frames)
    )
    report_every = max(1, n_frames // 100)
    for frame in range(n_frames):
        if frame:
            mujoco.mj_step(model, data, nstep=options.steps_a_frame)
        mujoco.mj_forward(model, data)
        flight.centres[frame] = data.qpos.reshape(-1, 3)
        flight.energies[frame] = total_energy(data, options.step, masses)
        flight.overlaps[frame] = max(0.0, -data.efc_pos.min(initial=0.0))
        if progress is not None and frame % report_every == 0:
            progress(frame / n_frames)
    if progress is not None:
        progress(1.0)
    return flight


def _place(
    body: Body, options: BombardmentOptions, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Place balls by random sequential rejection: clear of walls, body and one another."""
    radii, half = options.radii, options.box_half_width
    widest = float(radii.max())
    if half - body.reach <= 2 * widest:
        raise InputError(
            f"balls of {widest:g} m radius do not fit between the body, which reaches to "
            f"{body.reach:g} m, and the walls at {half:g} m; make box_half_width more than "
            f"{body.reach + 2 * widest:g} m, or the balls smaller"
        )
    placed = np.empty((options.n_balls, 3))
    n_placed = failures = 0
    while n_placed < options.n_balls:
        radius = radii[n_placed]
        centre = rng.uniform(radius - half, half - radius, size=3)
        gaps = np.linalg.norm(placed[:n_placed] - centre, axis=1) - radii[:n_placed]
        if (gaps > radius).all() and body.distance(centre[None])[0] > radius:
            placed[n_placed] = centre
            n_placed, failures = n_placed + 1, 0
        elif (failures := failures + 1) == _PLACING_ATTEMPTS:
            raise InputError(
                f"only {n_placed} of {options.n_balls} balls of {widest:g} m radius found room "
                f"in a box of half-width {half:g} m; take fewer or smaller balls, or a larger box"
            )
    return placed


def _set_off(options: BombardmentOptions, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw velocities as collisions would leave them, so that no warm-up is needed (Maxwell)."""
    velocities = rng.standard_normal((options.n_balls, 3)) * options.speeds[:, None]
    mean_square = np.mean(np.sum(velocities**2, axis=1))
    return np.asarray(velocities * (options.speed / math.sqrt(mean_square)))


def _build(mujoco: ModuleType, body: Body, options: BombardmentOptions) -> Any:
    """Build the model: frictionless balls that slide along x, y and z.

    Nothing turns them, so three sliding joints do; and the joints' limits are the walls, which
    saves looking for contacts with them.
    """
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, 0]
    spec.option.timestep = options.step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER  # symplectic: energy does not creep
    contact = options.contact
    surface = {"condim": 1, "solref": contact.solref, "solimp": contact.solimp}
    add_solids(mujoco, spec, body.solids, surface, _SKIN * body.reach)
    for radius, mass in zip(options.radii, options.masses, strict=True):
        ball = spec.worldbody.add_body()
        ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], mass=mass, **surface)
        room = options.box_half_width - radius
        for axis in np.eye(3):
            ball.add_joint(
                type=mujoco.mjtJoint.mjJNT_SLIDE,
                axis=axis,
                limited=mujoco.mjtLimited.mjLIMITED_TRUE,
                range=[-room, room],
                solref_limit=contact.solref,
                solimp_limit=contact.solimp,
            )
    return spec.compile()
