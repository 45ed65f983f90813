"""Rubbing: a palm moves over the skin along lines and circles, pressing more and less.

The hardware experiment of McGregor et al. (2011), section "Experimental Data": "an irregular
rubbing motion ... circular and linear motions in various directions pressing the palm of the hand
against the skin patch". Its runs had 1,054 to 2,128 frames.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.scene import Prop
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.checks import check_count, check_positive
from anisomap.simulation.geometry import solids
from anisomap.simulation.geometry.solids import Points
from anisomap.simulation.kinematic.paths import (
    Skin,
    StrokeOptions,
    find_skin,
    wander,
    wandering_values,
)
from anisomap.simulation.kinematic.settling import CLEAR, Cluster, settle
from anisomap.simulation.options import REACH, parameter
from anisomap.simulation.sensing import read_balls
from anisomap.simulation.world import Progress, Run, still_life

_PADS = 7
_THICK = (0.3, 0.6)  # radius of a pad, x hand size
_UNEVEN = 0.2  # x hand size, how much higher one pad may lie than another
_TURNING = 0.5  # radians a second, at most
_TURN_CHANGES = 2.0  # seconds


@dataclass(frozen=True)
class RubbingOptions(StrokeOptions):
    """Parameters of rubbing, beside those of `StrokeOptions`.

    Parameters
    ----------
    hand_size : float
        Metres from the middle of the palm to the furthest of its soft pads. 0.35: the palm is
        smaller than what it rubs, and it touches a few sensors of the sphere at once. With 0.6 it
        lies along the cylinder as a whole, and the map is worse (Mantel r .71 for .88).
    detection_radius : float
        Metres. 0.3: less than in `BombardmentOptions`, as the pads of a palm touch several sensors
        as it is. r-ANISOMAP reaches a Mantel r of .98 on the hexagon whatever it is (in 2D), .95,
        .97, .98, .99 on the sphere with 0.15, 0.2, 0.3, 0.44, and .85, .88, .88, .85 on the
        cylinder (means of 3 to 5 seeds).
    n_hands : int
        1; with 2, there are two contacts at once. Hands take no notice of each other.

    Raises
    ------
    InputError
        As `StrokeOptions`; or if there is no hand, or the palm is too thin to press that deep.
    """

    hand_size: float = parameter(0.35, "m", REACH)
    detection_radius: float = parameter(0.3, "m", REACH)
    n_hands: int = 1

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive("hand_size", self.hand_size, "m")
        check_positive("detection_radius", self.detection_radius, "m")
        check_count("n_hands", self.n_hands)
        deepest = _THICK[0] * self.hand_size
        if self.press_depth > deepest:
            raise InputError(
                f"press_depth is {self.press_depth:g} m, deeper than the palm is thick; take at "
                f"most {deepest:g} m, or a larger hand_size"
            )


@dataclass(frozen=True, eq=False)
class Rub:
    """Where a hand was.

    Attributes
    ----------
    centres : ndarray of shape (T, P, 3)
        Of the pads of its palm, in each frame.
    radii : ndarray of shape (P,)
        Of the pads.
    n_strokes : int
    """

    centres: Points
    radii: NDArray[np.float64]
    n_strokes: int


def rubbing(
    body: Body,
    n_frames: int,
    options: RubbingOptions,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Run:
    """Record what a body's sensors read while hands rub it.

    Parameters
    ----------
    body : Body
    n_frames : int
    options : RubbingOptions
    rng : numpy.random.Generator
        Draws hands and their ways.
    progress : callable, optional
        Told the share done, from 0 to 1.

    Returns
    -------
    Run
    """
    skin = find_skin(body, rng)
    hands = []
    for done in range(options.n_hands):
        if progress is not None:
            progress(done / options.n_hands)
        hands.append(rub(body, skin, n_frames, options, rng))
    pads = np.concatenate([hand.centres for hand in hands], axis=1)
    sizes = np.concatenate([hand.radii for hand in hands])
    readings = read_balls(body.positions, pads, sizes, options.detection_radius)
    if progress is not None:
        progress(1.0)
    return Run(
        readings,
        rate_hz=1 / options.frame_interval,
        facts=asdict(options) | {"n_strokes": sum(hand.n_strokes for hand in hands)},
        props=(
            *still_life(body),
            Prop("stimulus", solids.ball(1.0).outline, pads, scales=sizes),
        ),
        sensors=body.positions[None],
    )


def rub(
    body: Body, skin: Skin, n_frames: int, options: RubbingOptions, rng: np.random.Generator
) -> Rub:
    """Move a hand of its own shape over a body."""
    pads, radii = draw_palm(options.hand_size, rng)
    path = wander(body, skin, n_frames, options, rng)
    angles = _turning(n_frames, options.frame_interval, rng)
    cluster = Cluster(np.einsum("tij,pj->tpi", path.frames(angles), pads), radii)
    heights = settle(body, skin, path, cluster, options.press_depth * path.presses)
    heights += path.lifts * CLEAR * options.detection_radius
    return Rub(cluster.placed(path, heights), radii, path.n_strokes)


def draw_palm(size: float, rng: np.random.Generator) -> tuple[Points, NDArray[np.float64]]:
    """Draw a palm: a pad in the middle, and others about it, none like another.

    Returns
    -------
    centres : ndarray of shape (P, 3)
        x and y along the palm, z out of it; all pads are above z = 0.
    radii : ndarray of shape (P,)
    """
    angle = 2 * np.pi * (np.arange(_PADS - 1) + rng.uniform(-0.3, 0.3, _PADS - 1)) / (_PADS - 1)
    away = size * rng.uniform(0.5, 1.0, _PADS - 1)
    radii = size * rng.uniform(*_THICK, _PADS)
    height = radii + size * _UNEVEN * rng.random(_PADS)
    flat = np.column_stack([away * np.cos(angle), away * np.sin(angle)])
    return np.column_stack([np.vstack([[0, 0], flat]), height]), radii


def _turning(n_frames: int, interval: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw how a hand is turned in each frame, slowly this way and that; radians, (T,)."""
    rate = 2 * wandering_values(n_frames, _TURN_CHANGES / interval, rng) - 1
    return np.asarray(rng.uniform(0, 2 * np.pi) + np.cumsum(_TURNING * interval * rate))
