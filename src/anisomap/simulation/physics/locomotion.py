"""Locomotion: a sphere or cylinder rolls over uneven ground under gravity.

McGregor et al. (2011), section "Scenarios". The paper's parameters were in its Text S1, which is no
longer available; defaults here were chosen for the reasons given. Lengths are in m, and the paper's
sphere has a radius of 1 m.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.scene import Prop
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.engine import load_mujoco
from anisomap.simulation.physics.driving import Driver, LocomotionOptions
from anisomap.simulation.physics.terrain import Terrain, bumpy_terrain
from anisomap.simulation.result import Progress, ScenarioResult, no_progress

ROLLING = ("sphere", "cylinder")
"""Kinds of solid that can roll."""

# Limits beyond which a run is returned with a warning.
MAX_MEDIAN_SLIP = 0.1
MIN_SHARE_MOVING = 0.9  # not 1: a cylinder stops briefly to reverse
MIN_SHARE_TOUCHED = 1.0

_SETTLING_TIME = 1.0  # s
_MOVING_SPEED = 0.1  # x set speed
_MIN_HALF_WIDTH = 4.0  # x reach


@dataclass(frozen=True, eq=False)
class Journey:
    """Motion of a rolling body.

    Attributes
    ----------
    terrain : Terrain
    centres : ndarray of shape (T, 3)
        Centre of the body in each frame.
    rotations : ndarray of shape (T, 3, 3)
    slips : ndarray of shape (T,)
        Speed of the body's surface at the contact, as a share of the set speed; NaN without
        contact.
    speeds : ndarray of shape (T,)
        Speed of the centre.
    overlaps : ndarray of shape (T,)
        Depth of the body in the ground.
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
    return len(body.solids) == 1 and first.kind in ROLLING and not first.centre.any()


def locomotion(
    body: Body,
    n_frames: int,
    options: LocomotionOptions,
    rng: np.random.Generator,
    progress: Progress = no_progress,
) -> ScenarioResult:
    """Simulate a sphere or cylinder that rolls over uneven ground.

    Returns
    -------
    ScenarioResult
        Its facts are ``median_slip`` (as a share of the speed), ``share_moving`` of the frames,
        ``share_touched`` of the sensors, and ``deepest_overlap`` with the ground.

    Raises
    ------
    InputError
        If the body cannot roll, or rolled off the ground.
    MissingExtraError
        If MuJoCo is not installed.

    Warns
    -----
    AnisomapWarning
        If the body slid or stopped too often, or some sensors never touched the ground.
    """
    reach = body.reach
    scaled = options.scaled(1 / reach)
    unit = body.scaled(1 / reach)
    journey = simulate_journey(unit, n_frames, scaled, rng, progress)
    sensors = journey.sensors(unit.positions)
    readings = journey.terrain.readings(sensors.reshape(-1, 3), scaled.detection_radius)
    readings = reach * readings.reshape(n_frames, body.n_sensors)
    measured = {
        "median_slip": float(np.nanmedian(journey.slips)),
        "share_moving": float(np.mean(journey.speeds > _MOVING_SPEED * scaled.speed)),
        "share_touched": float(np.mean((readings > 0).any(axis=0))),
        "deepest_overlap": reach * float(journey.overlaps.max()),
    }
    _warn_about(measured)
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
        facts={"timestep": options.step} | measured,
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
        raise InputError(
            f"the body {body.name} does not roll; locomotion needs a sphere or a cylinder"
        )
    least = _MIN_HALF_WIDTH * body.reach
    if options.half_width < least:
        raise InputError(
            f"half_width must be at least {_MIN_HALF_WIDTH:g} times the reach of the body, got "
            f"{options.half_width / body.reach:g} times"
        )
    mujoco = load_mujoco()
    terrain = bumpy_terrain(
        options.half_width, options.cell, options.roughness, options.correlation, rng
    )
    driver = Driver(mujoco, body, terrain, options, rng)
    for _ in range(math.ceil(_SETTLING_TIME / options.step)):
        driver.step()
    states = [driver.measure()]
    report_interval = max(1, n_frames // 100)
    for frame in range(1, n_frames):
        for _ in range(options.steps_per_frame):
            driver.step()
        states.append(driver.measure())
        if frame % report_interval == 0:
            progress(frame / n_frames)
    return Journey(terrain, *(np.array(column) for column in zip(*states, strict=True)))


def _warn_about(measured: dict[str, float]) -> None:
    problems = []
    if measured["median_slip"] > MAX_MEDIAN_SLIP:
        problems.append(f"it slid at {measured['median_slip']:.0%} of its speed: increase friction")
    if measured["share_moving"] < MIN_SHARE_MOVING:
        problems.append(
            f"it stood still in {1 - measured['share_moving']:.0%} of the frames: reduce roughness"
        )
    if measured["share_touched"] < MIN_SHARE_TOUCHED:
        problems.append(
            f"only {measured['share_touched']:.0%} of the sensors touched the ground: "
            "increase the number of frames"
        )
    if problems:
        warnings.warn(f"the body did not roll well: {'; '.join(problems)}", AnisomapWarning, 3)
