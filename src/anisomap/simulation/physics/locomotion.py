"""Locomotion: a sphere or cylinder that rolls over uneven ground under gravity.

McGregor et al. (2011), section "Scenarios". The paper's values are lost with its Text S1; those
here are ours. Lengths are in metres, and the paper's sphere has a radius of 1 m.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.scene import Prop
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.engine import load_mujoco
from anisomap.simulation.physics.driving import Driver, LocomotionOptions
from anisomap.simulation.physics.terrain import Terrain, bumpy_terrain
from anisomap.simulation.world import Progress, Run

ROLLING = ("sphere", "cylinder")
"""Kinds of the one solid that a body must be made of to roll."""

MOST_SLIP = 0.1
LEAST_MOTION = 0.9  # a cylinder that turns back stands still for a moment
LEAST_TOUCHED = 1.0
"""Limits of what is told without a warning: see `Journey`."""

_SETTLING = 1.0  # seconds
_MOVING = 0.1  # of the speed
_LEAST_ROOM = 4.0  # reaches from the middle of the ground to its edge


@dataclass(frozen=True, eq=False)
class Journey:
    """Where the body was, and whether it rolled.

    Attributes
    ----------
    terrain : Terrain
    centres : ndarray of shape (T, 3)
        Of the body in each frame.
    rotations : ndarray of shape (T, 3, 3)
    slips : ndarray of shape (T,)
        How fast the body's surface slid over the ground where they touched, as a share of the
        drive's speed; NaN where they did not touch.
    speeds : ndarray of shape (T,)
        Of the body's middle.
    overlaps : ndarray of shape (T,)
        How deep the body was in the ground.
    """

    terrain: Terrain
    centres: NDArray[np.float64]
    rotations: NDArray[np.float64]
    slips: NDArray[np.float64]
    speeds: NDArray[np.float64]
    overlaps: NDArray[np.float64]

    def sensors(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Give where sensors were in each frame, shape (T, N, 3)."""
        turned = np.einsum("tij,nj->tni", self.rotations, positions)
        return np.asarray(turned + self.centres[:, None])


def rolls(body: Body) -> bool:
    """Tell whether a body is one sphere or cylinder about its own middle."""
    first = body.solids[0]
    return len(body.solids) == 1 and first.kind in ROLLING and not first.centre.any()


def locomotion(
    body: Body,
    n_frames: int,
    options: LocomotionOptions,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Run:
    """Record what a body's sensors read while it rolls over uneven ground.

    Parameters
    ----------
    body : Body
        A sphere or a cylinder.
    n_frames : int
    options : LocomotionOptions
    rng : numpy.random.Generator
        Makes the ground, and chooses where to roll.
    progress : callable, optional
        Told the share done, from 0 to 1.

    Returns
    -------
    Run
        Its facts tell ``median_slip`` (as a share of the speed), ``share_moving`` of the frames,
        ``share_touched`` of the sensors and ``deepest_overlap`` with the ground.

    Raises
    ------
    InputError
        If the body does not roll, or rolled off the ground.
    MissingExtraError
        If MuJoCo is not installed.

    Warns
    -----
    AnisomapWarning
        If the body slid or stood still too much, or sensors never touched the ground.
    """
    reach = body.reach
    scaled = options.scaled(1 / reach)
    unit = body.scaled(1 / reach)
    journey = roll(unit, n_frames, scaled, rng, progress)
    sensors = journey.sensors(unit.positions)
    readings = journey.terrain.readings(sensors.reshape(-1, 3), scaled.detection_radius)
    readings = reach * readings.reshape(n_frames, body.n_sensors)
    measured = {
        "median_slip": float(np.nanmedian(journey.slips)),
        "share_moving": float(np.mean(journey.speeds > _MOVING * scaled.speed)),
        "share_touched": float(np.mean((readings > 0).any(axis=0))),
        "deepest_overlap": reach * float(journey.overlaps.max()),
    }
    _warn_of(measured, n_frames)
    if np.abs(journey.centres[:, :2]).max() > scaled.half_width:
        raise InputError(
            "the body rolled off the ground: take a lower speed, or a larger half_width"
        )
    ground = journey.terrain.mesh
    return Run(
        readings,
        rate_hz=1 / options.frame_interval,
        facts=asdict(options) | {"timestep": options.step} | measured,
        props=(
            Prop("ground", replace(ground, vertices=reach * ground.vertices), np.zeros((1, 1, 3))),
            *(
                Prop(
                    "body",
                    solid.outline,
                    reach * journey.centres[:, None],
                    journey.rotations[:, None],
                )
                for solid in body.solids
            ),
        ),
        sensors=reach * sensors,
    )


def roll(
    body: Body,
    n_frames: int,
    options: LocomotionOptions,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Journey:
    """Roll a body over ground; see `locomotion`."""
    if not rolls(body):
        raise InputError(
            f"the body {body.name} does not roll; locomotion takes bodies that are a sphere or a "
            "cylinder"
        )
    least = _LEAST_ROOM * body.reach
    if options.half_width < least:
        raise InputError(
            f"half_width is {options.half_width / body.reach:g} times the reach of the body, which "
            f"has no room to turn; take at least {_LEAST_ROOM:g} times its reach"
        )
    mujoco = load_mujoco()
    terrain = bumpy_terrain(
        options.half_width, options.cell, options.roughness, options.correlation, rng
    )
    driver = Driver(mujoco, body, terrain, options, rng)
    for _ in range(math.ceil(_SETTLING / options.step)):
        driver.step()
    record = [driver.look()]
    for frame in range(1, n_frames):
        for _ in range(options.steps_a_frame):
            driver.step()
        record.append(driver.look())
        if progress is not None and frame % max(1, n_frames // 100) == 0:
            progress(frame / n_frames)
    if progress is not None:
        progress(1.0)
    return Journey(terrain, *(np.array(column) for column in zip(*record, strict=True)))


def _warn_of(measured: dict[str, float], n_frames: int) -> None:
    doubts = []
    if measured["median_slip"] > MOST_SLIP:
        doubts.append(f"it slid at {measured['median_slip']:.0%} of its speed: take more friction")
    if measured["share_moving"] < LEAST_MOTION:
        doubts.append(
            f"it stood still in {1 - measured['share_moving']:.0%} of the frames: take smoother "
            "ground"
        )
    if measured["share_touched"] < LEAST_TOUCHED:
        doubts.append(
            f"only {measured['share_touched']:.0%} of the sensors touched the ground: take more "
            f"frames than {n_frames}"
        )
    if doubts:
        warnings.warn(f"the body did not roll well: {'; '.join(doubts)}", AnisomapWarning, 3)
