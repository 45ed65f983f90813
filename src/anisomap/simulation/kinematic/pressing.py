"""Pressing: a large flat surface comes down on the body again and again, from all sides."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.scene import Prop
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.checks import check_positive
from anisomap.simulation.geometry import solids
from anisomap.simulation.geometry.solids import Points
from anisomap.simulation.kinematic.settling import support
from anisomap.simulation.options import REACH, parameter
from anisomap.simulation.sensing import read_half_spaces
from anisomap.simulation.world import Progress, Run, still_life

_THICKNESS = 0.02  # of the drawn slab, x reach


@dataclass(frozen=True)
class PressingOptions:
    """Parameters of pressing; defaults are for the paper's sphere, see `simulation.options`.

    Parameters
    ----------
    press_depth : float
        Metres that the surface presses into the body at most; each press reaches between half of
        it and all. 0.1: as in rubbing.
    press_interval : float
        Seconds from one press to the next. 0.5: 200 presses in 2,000 frames, at least one for each
        sensor of the paper's bodies, and ten frames each.
    tilt : float
        By how much a press strays from the normal of the sensor at which it is aimed. Radians, root
        mean square along each axis, while small. 0.3: on a flat skin it tips by some 20 degrees.
    rocking : float
        By how much it tips while it presses. Radians. 0.3: the contact rolls over the skin.
    detection_radius : float
        Metres. 0.3: as in rubbing.
    frame_interval : float
        Seconds between frames. 0.05: as in bombardment.

    Raises
    ------
    InputError
        If one is not positive (tilt and rocking may be 0), or a press is over within a frame.
    """

    press_depth: float = parameter(0.1, "m", REACH)
    press_interval: float = 0.5
    tilt: float = 0.3
    rocking: float = 0.3
    detection_radius: float = parameter(0.3, "m", REACH)
    frame_interval: float = 0.05

    def __post_init__(self) -> None:
        check_positive("press_depth", self.press_depth, "m")
        check_positive("detection_radius", self.detection_radius, "m")
        check_positive("press_interval", self.press_interval, "s")
        check_positive("frame_interval", self.frame_interval, "s")
        for name in ("tilt", "rocking"):
            if not 0 <= getattr(self, name) <= math.pi:
                raise InputError(f"{name} is {getattr(self, name):g}; it must be from 0 to pi")
        if self.press_interval < 2 * self.frame_interval:
            raise InputError(
                f"press_interval is {self.press_interval:g} s; it must be at least two frames, "
                f"{2 * self.frame_interval:g} s"
            )


def pressing(
    body: Body,
    n_frames: int,
    options: PressingOptions,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Run:
    """Record what a body's sensors read while a flat surface is pressed against it.

    Parameters
    ----------
    body : Body
    n_frames : int
    options : PressingOptions
    rng : numpy.random.Generator
        Draws the presses. Each is aimed at the normal of a sensor, all sensors in turn.
    progress : callable, optional
        Told the share done, from 0 to 1.

    Returns
    -------
    Run
        What lies in a hollow (the inside of a ring, a crotch) is in range only as far as
        `detection_radius` bridges it: nothing flat gets there. And all of a straight line is
        touched at once: r-ANISOMAP reaches a Mantel r of .99 on sphere and plane, but of .57 on
        the cylinder, whose length it cannot see.
    """
    directions, depths = draw_presses(body, n_frames, options, rng)
    offsets = support(body.solids, directions) - depths
    readings = read_half_spaces(body.positions, directions, offsets, options.detection_radius)
    if progress is not None:
        progress(1.0)
    half = _THICKNESS * body.reach
    slab = solids.box((body.reach, body.reach, half))
    turns = np.array([solids.turned_to(direction) for direction in directions])
    centres = (offsets + half)[:, None] * directions
    return Run(
        readings,
        rate_hz=1 / options.frame_interval,
        facts=asdict(options),
        props=(
            *still_life(body),
            Prop("stimulus", slab.outline, centres[:, None], turns[:, None]),
        ),
        sensors=body.positions[None],
    )


def draw_presses(
    body: Body, n_frames: int, options: PressingOptions, rng: np.random.Generator
) -> tuple[Points, NDArray[np.float64]]:
    """Draw from where, and how deep, a flat surface presses in each frame.

    Returns
    -------
    directions : ndarray of shape (T, 3)
        Unit vectors out of the body, across the surface.
    depths : ndarray of shape (T,)
        How deep it is in the body; negative above it. Between presses nothing is in range.
    """
    time = np.arange(n_frames) * options.frame_interval / options.press_interval
    press = time.astype(np.intp)
    n_presses = int(press[-1]) + 1
    turns = -(-n_presses // body.n_sensors)
    aimed = np.concatenate([rng.permutation(body.n_sensors) for _ in range(turns)])[:n_presses]
    middle = body.normals[aimed] + options.tilt * rng.standard_normal((n_presses, 3))
    tip = rng.standard_normal((n_presses, 3))
    tip *= options.rocking / np.linalg.norm(tip, axis=1, keepdims=True)
    share = time - press
    directions = middle[press] + (share - 0.5)[:, None] * tip[press]
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    strokes = options.detection_radius + options.press_depth * rng.uniform(0.5, 1, n_presses)
    depths = strokes[press] * np.sin(np.pi * share) ** 2 - options.detection_radius
    return directions, depths
