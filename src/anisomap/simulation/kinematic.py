"""Rubbing: a scenario without physics, of a hand that follows strokes over the skin.

It models the hardware experiment of McGregor et al. (2011), section "Experimental Data": "an
irregular rubbing motion ... circular and linear motions in various directions pressing the palm of
the hand against the skin patch". Its runs had 1,054 to 2,128 frames.

Readings are in closed form, in single precision: its seven digits exceed the resolution of real
sensors. Parameters without a source were chosen by hand.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from anisomap.base.scene import Prop
from anisomap.simulation import solids
from anisomap.simulation.body import Body
from anisomap.simulation.options import REACH, ScenarioResult, positive, static_props
from anisomap.simulation.solids import Points
from anisomap.simulation.strokes import (
    Skin,
    StrokeOptions,
    draw_strokes,
    placed,
    sample_skin,
    settle,
    smooth_random,
)

_N_PADS = 7
_PAD_RADIUS = (0.3, 0.6)  # x hand_size
_PAD_HEIGHT_SPREAD = 0.2  # x hand_size
_MAX_TURN_RATE = 0.5  # rad/s
_TURN_PERIOD = 2.0  # seconds between independent turn rates
_LIFT_HEIGHT = 1.5  # of a lifted palm, x detection radius: out of range of all sensors
TRAVEL_FRAMES = 6
"""Frames off the skin before each bout of a guided hand: 0.3 s, as for a lift between strokes."""


def read_balls(
    sensors: Points,
    centres: Points,
    ball_radius: ArrayLike,
    detection_radius: float,
    normals: Points | None = None,
) -> NDArray[np.float32]:
    """Read balls with short-range proximity sensors (McGregor et al. 2011, "Sensor Modelling").

    sensors (N, 3), centres (T, B, 3), ball_radius (B,). With `normals` (N, 3), sensors read only
    balls whose centre is in front of the skin.
    """
    reach = detection_radius + np.asarray(ball_radius, dtype=np.float64)
    heights = None if normals is None else np.einsum("nd,nd->n", sensors, normals)[:, None]
    depths = []
    for balls in centres:
        depth = reach - cdist(sensors, balls)
        if normals is not None:
            depth = np.where(normals @ balls.T > heights, depth, 0)
        depths.append(depth.max(axis=1).astype(np.float32))
    return np.maximum(np.asarray(depths, dtype=np.float32), 0)


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
    """

    hand_size: float = positive(0.35, "m", REACH)
    detection_radius: float = positive(0.3, "m", REACH)

    def __post_init__(self) -> None:
        super().__post_init__()
        thickness = _PAD_RADIUS[0] * self.hand_size
        bound = f"the thickness of the palm ({thickness:g} m)"
        self.at_most("press_depth", thickness, bound, "; reduce it or increase hand_size")


class Palm:
    """A central soft pad surrounded by others of irregular size and position, on a skin.

    centres (P, 3), radii (P,): Of the pads, with the skin at z = 0.
    """

    def __init__(self, skin: Skin, options: RubbingOptions, rng: np.random.Generator) -> None:
        self._skin, self._options, self._rng = skin, options, rng
        n_outer, size = _N_PADS - 1, options.hand_size
        angle = 2 * np.pi * (np.arange(n_outer) + rng.uniform(-0.3, 0.3, n_outer)) / n_outer
        distance = size * rng.uniform(0.5, 1.0, n_outer)
        self.radii = size * rng.uniform(*_PAD_RADIUS, _N_PADS)
        height = self.radii + size * _PAD_HEIGHT_SPREAD * rng.random(_N_PADS)
        flat = np.column_stack([distance * np.cos(angle), distance * np.sin(angle)])
        self.centres = np.column_stack([np.vstack([[0, 0], flat]), height])

    def move(self, n_frames: int, visits: NDArray[np.float64] | None = None) -> tuple[Points, int]:
        """Rub along strokes; visits as in `draw_strokes`. Returns pads (T, P, 3), n_strokes."""
        skin, options, rng = self._skin, self._options, self._rng
        path = draw_strokes(skin, n_frames, options, rng, visits=visits)
        # The hand turns slowly about the normal.
        interval = options.frame_interval
        rate = 2 * smooth_random(n_frames, _TURN_PERIOD / interval, rng) - 1
        angles = rng.uniform(0, 2 * np.pi) + np.cumsum(_MAX_TURN_RATE * interval * rate)
        turned = np.einsum("tij,pj->tpi", path.orientations(angles), self.centres)
        heights = settle(skin, path, turned, self.radii, options.press_depth * path.presses)
        lifted = path.lifts * _LIFT_HEIGHT * options.detection_radius
        return placed(path, turned, heights + lifted), path.n_strokes


def rubbing(
    body: Body, n_frames: int, options: RubbingOptions, rng: np.random.Generator
) -> ScenarioResult:
    """Simulate a palm that rubs the skin along lines and circles."""
    palm = Palm(sample_skin(body, rng), options, rng)
    pads, n_strokes = palm.move(n_frames)
    stimulus = Prop("stimulus", solids.ball(1.0).outline, pads, scales=palm.radii)
    return ScenarioResult(
        read_balls(body.positions, pads, palm.radii, options.detection_radius),
        (*static_props(body), stimulus),
        facts={"n_strokes": n_strokes},
    )


class GuidedHand:
    """A palm that rubs a body in bouts, each of them where it is told."""

    def __init__(self, body: Body, options: RubbingOptions, rng: np.random.Generator) -> None:
        self._body, self._sensing = body, options.detection_radius
        self._palm = Palm(sample_skin(body, rng), options, rng)

    def rub(
        self,
        n_frames: int,
        sensors: Collection[int] = (),
        contacts: NDArray[np.intp] | None = None,
    ) -> NDArray[np.float32]:
        """Rub for some frames. Returns (n_frames, N)."""
        visits = np.zeros(self._body.n_sensors)
        if contacts is not None:
            visits += contacts
        if sensors:
            first = list(sensors)
            visits[first] = np.minimum(visits[first], 0)
            visits[first[0]] = -1  # the hand is set down at the least visited sensor
        n_rubbing = max(1, n_frames - TRAVEL_FRAMES)
        pads, _ = self._palm.move(n_rubbing, visits)
        touched = read_balls(self._body.positions, pads, self._palm.radii, self._sensing)
        return np.pad(touched, ((n_frames - n_rubbing, 0), (0, 0)))
