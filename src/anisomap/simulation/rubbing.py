"""Rubbing: a palm moves over the skin along lines and circles with varying pressure.

Models the hardware experiment of McGregor et al. (2011), section "Experimental Data": "an irregular
rubbing motion ... circular and linear motions in various directions pressing the palm of the hand
against the skin patch". Its runs had 1,054 to 2,128 frames. A coach can tell the hand where to rub.
A roller moves along the skin, too, and touches whole lines of sensors.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.scene import Prop
from anisomap.simulation import solids
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.checks import COUNT
from anisomap.simulation.options import REACH, ScenarioResult, option, positive, static_props
from anisomap.simulation.sensing import read_balls, read_capsules
from anisomap.simulation.solids import Points
from anisomap.simulation.strokes import (
    Cluster,
    StrokeOptions,
    SurfaceSample,
    draw_strokes,
    follow,
    sample_skin,
    smooth_random,
)

# The shape and rotation of the palm were chosen by hand.
_N_PADS = 7
_PAD_RADIUS = (0.3, 0.6)  # x hand_size
_PAD_HEIGHT_SPREAD = 0.2  # x hand_size
_MAX_TURN_RATE = 0.5  # rad/s
_TURN_PERIOD = 2.0  # seconds between independent turn rates


@dataclass(frozen=True)
class RubbingOptions(StrokeOptions):
    """Options of rubbing, in addition to those of `StrokeOptions`.

    Parameters
    ----------
    hand_size : float
        Distance from the middle of the palm to its furthest soft pad, in m. 0.35: the palm is
        smaller than the body and touches a few sensors of the sphere at once. At 0.6 it covers the
        length of the cylinder, and the map is worse (Mantel r .71 instead of .88).
    detection_radius : float
        Detection radius of the sensors, in m. 0.3: below that of `BombardmentOptions`, since the
        pads of a palm already touch several sensors. r-ANISOMAP reaches a Mantel r of .98 on the
        hexagon for any value (in 2D), .95, .97, .98, .99 on the sphere for 0.15, 0.2, 0.3, 0.44,
        and .85, .88, .88, .85 on the cylinder (means of 3 to 5 seeds).
    n_hands : int
        Number of hands, which move independently. 1: as in the paper.
    """

    hand_size: float = positive(0.35, "m", REACH)
    detection_radius: float = positive(0.3, "m", REACH)
    n_hands: int = option(1, COUNT)

    def __post_init__(self) -> None:
        super().__post_init__()
        thickness = _PAD_RADIUS[0] * self.hand_size
        if self.press_depth > thickness:
            raise InputError(
                f"press_depth must be at most the thickness of the palm ({thickness:g} m), "
                f"got {self.press_depth:g} m; reduce it or increase hand_size"
            )


@dataclass(frozen=True, eq=False)
class HandMotion:
    """Motion of one hand.

    centres (T, P, 3): Centres of the pads of the palm in each frame.
    radii (P,): Radii of the pads.
    """

    centres: Points
    radii: NDArray[np.float64]
    n_strokes: int


def rubbing(
    body: Body, n_frames: int, options: RubbingOptions, rng: np.random.Generator
) -> ScenarioResult:
    """Simulate hands that rub a body."""
    skin = sample_skin(body, rng)
    hands = [move_hand(body, skin, n_frames, options, rng) for _ in range(options.n_hands)]
    pads = np.concatenate([hand.centres for hand in hands], axis=1)
    radii = np.concatenate([hand.radii for hand in hands])
    return ScenarioResult(
        read_balls(body.positions, pads, radii, options.detection_radius),
        (*static_props(body), Prop("stimulus", solids.ball(1.0).outline, pads, scales=radii)),
        facts={"n_strokes": sum(hand.n_strokes for hand in hands)},
    )


def move_hand(
    body: Body,
    skin: SurfaceSample,
    n_frames: int,
    options: RubbingOptions,
    rng: np.random.Generator,
    *,
    palm: tuple[Points, NDArray[np.float64]] | None = None,
    visits: NDArray[np.float64] | None = None,
) -> HandMotion:
    """Move a palm over a body; it is drawn if none is given. visits (N,): see `draw_strokes`."""
    pads, radii = palm or draw_palm(options.hand_size, rng)
    path = draw_strokes(body, skin, n_frames, options, rng, visits=visits)
    angles = draw_angles(n_frames, options.frame_interval, rng)
    cluster = Cluster(np.einsum("tij,pj->tpi", path.orientations(angles), pads), radii)
    centres = follow(body, skin, path, cluster, options, detection_radius=options.detection_radius)
    return HandMotion(centres, radii, path.n_strokes)


def draw_palm(size: float, rng: np.random.Generator) -> tuple[Points, NDArray[np.float64]]:
    """Draw a palm: a central pad surrounded by others of irregular size and position.

    Returns centres (P, 3), radii (P,).
    """
    n_outer = _N_PADS - 1
    angle = 2 * np.pi * (np.arange(n_outer) + rng.uniform(-0.3, 0.3, n_outer)) / n_outer
    distance = size * rng.uniform(0.5, 1.0, n_outer)
    radii = size * rng.uniform(*_PAD_RADIUS, _N_PADS)
    height = radii + size * _PAD_HEIGHT_SPREAD * rng.random(_N_PADS)
    flat = np.column_stack([distance * np.cos(angle), distance * np.sin(angle)])
    return np.column_stack([np.vstack([[0, 0], flat]), height]), radii


def draw_angles(n_frames: int, interval: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw the slowly varying angle of a hand about the normal, in rad; shape (T,)."""
    rate = 2 * smooth_random(n_frames, _TURN_PERIOD / interval, rng) - 1
    return np.asarray(rng.uniform(0, 2 * np.pi) + np.cumsum(_MAX_TURN_RATE * interval * rate))


TRAVEL_FRAMES = 6
"""Frames off the skin before each bout: 0.3 s, as for a lift between strokes."""


@dataclass
class GuidedHand:
    """A palm that rubs a body in bouts, each of them where it is told."""

    body: Body
    options: RubbingOptions
    rng: np.random.Generator

    def __post_init__(self) -> None:
        self._skin = sample_skin(self.body, self.rng)
        self._palm = draw_palm(self.options.hand_size, self.rng)

    def rub(
        self,
        n_frames: int,
        sensors: Collection[int] = (),
        contacts: NDArray[np.intp] | None = None,
    ) -> NDArray[np.float32]:
        """Rub for some frames. Returns (n_frames, N)."""
        n_sensors, options = self.body.n_sensors, self.options
        visits = np.zeros(n_sensors)
        if contacts is not None:
            visits += contacts
        if sensors:
            first = list(sensors)
            visits[first] = np.minimum(visits[first], 0)
            visits[first[0]] = -1  # the hand is set down at the least visited sensor
        n_rubbing = max(1, n_frames - TRAVEL_FRAMES)
        hand = move_hand(
            self.body, self._skin, n_rubbing, options, self.rng, palm=self._palm, visits=visits
        )
        touched = read_balls(
            self.body.positions, hand.centres, hand.radii, options.detection_radius
        )
        travel = np.zeros((n_frames - n_rubbing, n_sensors), dtype=np.float32)
        return np.concatenate([travel, touched])


@dataclass(frozen=True)
class RollerOptions(StrokeOptions):
    """Options of rolling, in addition to those of `StrokeOptions`.

    Parameters
    ----------
    roller_radius : float
        In m. 0.2: thin, so that the roller touches a line of sensors instead of an area.
    roller_length : float
        Length without the round caps, in m. 1.2: a few sensor spacings of the sphere.
    detection_radius : float
        Detection radius of the sensors, in m. 0.3: as in `RubbingOptions`.
    """

    press_depth: float = positive(0.1, "m", REACH, below="roller_radius")
    roller_radius: float = positive(0.2, "m", REACH)
    roller_length: float = positive(1.2, "m", REACH)
    detection_radius: float = positive(0.3, "m", REACH)


def roller(
    body: Body, n_frames: int, options: RollerOptions, rng: np.random.Generator
) -> ScenarioResult:
    """Simulate a roller that moves along the skin of a body.

    The roller is a capsule across its direction of motion. At the start of a stroke it turns to the
    new direction from one frame to the next.
    """
    skin = sample_skin(body, rng)
    path = draw_strokes(body, skin, n_frames, options, rng)
    across = np.cross(path.normals, path.headings)
    axes = options.roller_length / 2 * across[:, None]
    cluster = Cluster(np.zeros_like(axes), np.array([options.roller_radius]), axes)
    centres = follow(body, skin, path, cluster, options, detection_radius=options.detection_radius)
    readings = read_capsules(
        body.positions,
        centres - axes,
        centres + axes,
        options.roller_radius,
        options.detection_radius,
    )
    half = options.roller_length / 2
    shape = solids.capsule(options.roller_radius, [0, 0, -half], [0, 0, half])
    rotations = np.stack([path.normals, path.headings, across], axis=-1)
    stimulus = Prop("stimulus", shape.outline, centres, rotations[:, None])
    return ScenarioResult(
        readings, (*static_props(body), stimulus), facts={"n_strokes": path.n_strokes}
    )
