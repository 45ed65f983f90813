"""Pressing: a large flat surface is repeatedly pressed against the body from all sides."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.scene import Prop
from anisomap.simulation import solids
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.checks import between
from anisomap.simulation.options import (
    REACH,
    ScenarioOptions,
    ScenarioResult,
    option,
    positive,
    static_props,
)
from anisomap.simulation.sensing import read_half_spaces
from anisomap.simulation.solids import Points
from anisomap.simulation.strokes import support

_SLAB_HALF_THICKNESS = 0.02  # x reach; for drawing only


@dataclass(frozen=True)
class PressingOptions(ScenarioOptions):
    """Options of pressing. Defaults, for a sphere of 1 m, scale with the body.

    Parameters
    ----------
    press_depth : float
        Largest depth to which the surface presses into the body, in m. The depth of each press is
        between half and all of it. 0.1: as in rubbing.
    press_interval : float
        Time between presses, in s. 0.5: ten frames per press and 200 presses in 2,000 frames, at
        least one per sensor of the paper's bodies.
    tilt : float
        Deviation of a press from the normal of the targeted sensor: root mean square angle along
        each axis, in rad, while small. 0.3: about 20 degrees on flat skin.
    rocking : float
        Rotation of the surface during a press, in rad. 0.3: the contact rolls over the skin.
    detection_radius : float
        Detection radius of the sensors, in m. 0.3: as in rubbing.
    frame_interval : float
        Time between frames, in s. 0.05: as in bombardment.
    """

    press_depth: float = positive(0.1, "m", REACH)
    press_interval: float = positive(0.5, "s")
    tilt: float = option(0.3, between(0, math.pi))
    rocking: float = option(0.3, between(0, math.pi))
    detection_radius: float = positive(0.3, "m", REACH)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.press_interval < 2 * self.frame_interval:
            raise InputError(
                f"press_interval must be at least two frames ({2 * self.frame_interval:g} s), "
                f"got {self.press_interval:g} s"
            )


def pressing(
    body: Body, n_frames: int, options: PressingOptions, rng: np.random.Generator
) -> ScenarioResult:
    """Simulate a flat surface that is pressed against a body.

    The surface is aimed at the normals of all sensors in turn. It does not reach into hollows (the
    inside of a ring, a crotch); sensors there respond only within `detection_radius`. All sensors
    along a straight line are touched at once, so the length of a cylinder cannot be observed:
    r-ANISOMAP reaches a Mantel r of .99 on the sphere and the plane, but .57 on the cylinder.
    """
    directions, depths = draw_presses(body, n_frames, options, rng)
    offsets = support(body.solids, directions) - depths
    readings = read_half_spaces(body.positions, directions, offsets, options.detection_radius)
    half = _SLAB_HALF_THICKNESS * body.reach
    slab = solids.box((body.reach, body.reach, half))
    rotations = np.array([solids.rotation_to(direction) for direction in directions])
    centres = (offsets + half)[:, None] * directions
    stimulus = Prop("stimulus", slab.outline, centres[:, None], rotations[:, None])
    return ScenarioResult(readings, (*static_props(body), stimulus))


def draw_presses(
    body: Body, n_frames: int, options: PressingOptions, rng: np.random.Generator
) -> tuple[Points, NDArray[np.float64]]:
    """Draw the direction and depth of the flat surface in each frame.

    Returns directions (T, 3), depths (T,).
    """
    time = np.arange(n_frames) * options.frame_interval / options.press_interval
    press = time.astype(np.intp)
    n_presses = int(press[-1]) + 1
    rounds = -(-n_presses // body.n_sensors)
    aimed = np.concatenate([rng.permutation(body.n_sensors) for _ in range(rounds)])[:n_presses]
    middle = body.normals[aimed] + options.tilt * rng.standard_normal((n_presses, 3))
    rock = rng.standard_normal((n_presses, 3))
    rock *= options.rocking / np.linalg.norm(rock, axis=1, keepdims=True)
    share = time - press
    directions = middle[press] + (share - 0.5)[:, None] * rock[press]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    strokes = options.detection_radius + options.press_depth * rng.uniform(0.5, 1, n_presses)
    depths = strokes[press] * np.sin(np.pi * share) ** 2 - options.detection_radius
    return directions, depths
