"""Self-touch: a fingertip of the same skin moves over the body, and both sides feel it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anisomap.errors import InputError
from anisomap.scene import Prop
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.bodies.lattice import great_circles
from anisomap.simulation.checks import check_count, check_positive
from anisomap.simulation.geometry import solids
from anisomap.simulation.geometry.solids import Points
from anisomap.simulation.kinematic.paths import (
    StrokeOptions,
    Wandering,
    find_skin,
    wander,
    wandering_values,
)
from anisomap.simulation.kinematic.settling import CLEAR, Cluster, settle
from anisomap.simulation.options import REACH, parameter
from anisomap.simulation.sensing import read_balls
from anisomap.simulation.world import Progress, Run, still_life

_PAD = np.radians(75)  # how far the sensors reach from the tip's pole
_ROCKING = np.radians(50)  # how far it tips about each of two axes
_ROCK_CHANGES = 1.0  # seconds
_ASIDE = 2.0  # x finger radius: free room between the body and the fingertip, in the truth


@dataclass(frozen=True)
class SelfTouchOptions(StrokeOptions):
    """Parameters of self-touch, beside those of `StrokeOptions`.

    Parameters
    ----------
    finger_radius : float
        Metres: the fingertip is a ball. 0.3: as large as a ball of `BombardmentOptions`.
    n_finger_sensors : int
        16: about as dense on the tip as is usual on a robot's finger.
    detection_radius : float
        Metres, of the body's sensors. 0.4: about that of bombardment, as the stimulus is alike.
    finger_detection_radius : float
        Metres, of the fingertip's. 0.15: half of its radius, so that it feels with which part of
        it it touches.

    Raises
    ------
    InputError
        As `StrokeOptions`; or if there are no sensors, or the tip is too small to press that deep.
    """

    finger_radius: float = parameter(0.3, "m", REACH)
    n_finger_sensors: int = 16
    detection_radius: float = parameter(0.4, "m", REACH)
    finger_detection_radius: float = parameter(0.15, "m", REACH)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("finger_radius", "detection_radius", "finger_detection_radius"):
            check_positive(name, getattr(self, name), "m")
        check_count("n_finger_sensors", self.n_finger_sensors)
        if self.press_depth >= self.finger_radius:
            raise InputError(
                f"press_depth is {self.press_depth:g} m; it must be less than the fingertip's "
                f"radius, which is {self.finger_radius:g} m"
            )


def self_touch(
    body: Body,
    n_frames: int,
    options: SelfTouchOptions,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Run:
    """Record what a body and a fingertip read while the one strokes the other.

    Parameters
    ----------
    body : Body
    n_frames : int
    options : SelfTouchOptions
    rng : numpy.random.Generator
        Draws the way.
    progress : callable, optional
        Told the share done, from 0 to 1.

    Returns
    -------
    Run
        Of the body's sensors, then the fingertip's, ``finger0, finger1, ...``. The fingertip is
        moved about, so that it has no one place: in the truth it stands beside the body, see
        `with_fingertip`.
    """
    both = with_fingertip(body, options)
    centres, turns = touch(body, n_frames, options, rng)
    tip = fingertip(options)
    moved = centres + np.einsum("tij,nj->tni", turns, options.finger_radius * tip)
    felt = read_balls(body.positions, centres, options.finger_radius, options.detection_radius)
    away = body.distance(moved.reshape(-1, 3)).reshape(n_frames, -1)
    feels = np.maximum(options.finger_detection_radius - away, 0).astype(np.float32)
    if progress is not None:
        progress(1.0)
    still = np.broadcast_to(body.positions, (n_frames, *body.positions.shape))
    ball = solids.ball(options.finger_radius).outline
    return Run(
        np.hstack([felt, feels]),
        rate_hz=1 / options.frame_interval,
        facts=asdict(options),
        props=(*still_life(body), Prop("body", ball, centres, turns[:, None])),
        sensors=np.concatenate([still, moved], axis=1),
        body=both,
    )


def fingertip(options: SelfTouchOptions) -> Points:
    """Give the directions from the middle of the tip to its sensors, about +z; shape (M, 3)."""
    turns = np.arange(options.n_finger_sensors)
    # Equal areas of the cap, as on the paper's sphere.
    height = 1 - (1 - np.cos(_PAD)) * (turns + 0.5) / options.n_finger_sensors
    angle = np.pi * (3 - np.sqrt(5)) * turns
    ring = np.sqrt(1 - height**2)
    return np.column_stack([ring * np.cos(angle), ring * np.sin(angle), height])


def with_fingertip(body: Body, options: SelfTouchOptions) -> Body:
    """Set a fingertip beside a body, and take both for one.

    Returns
    -------
    Body
        The sensors of the body where they are, then those of the fingertip: its middle on the x
        axis, a diameter free between it and the ball that holds the body, its tip towards +z. What
        is between the two parts means nothing; distances along the skin are infinite there.
    """
    radius, tip = options.finger_radius, fingertip(options)
    middle = np.array([body.reach + (_ASIDE + 1) * radius, 0, 0])
    return Body(
        body.name,
        np.vstack([body.positions, middle + radius * tip]),
        np.vstack([body.normals, tip]),
        [*body.solids, solids.ball(radius, middle)],
        names=(*body.names, *(f"finger{i}" for i in range(len(tip)))),
        units=body.units,
        origin=body.origin,
        is_whole=body.is_whole,
        geodesic=body.geodesic and _apart(body.geodesic, body.n_sensors, middle),
    )


def touch(
    body: Body, n_frames: int, options: SelfTouchOptions, rng: np.random.Generator
) -> tuple[Points, NDArray[np.float64]]:
    """Move a fingertip over a body: its centres (T, 1, 3), and how it is turned (T, 3, 3)."""
    path = wander(body, skin := find_skin(body, rng), n_frames, options, rng)
    cluster = Cluster(np.zeros((n_frames, 1, 3)), np.array([options.finger_radius]))
    heights = settle(body, skin, path, cluster, options.press_depth * path.presses)
    heights += path.lifts * CLEAR * max(options.detection_radius, options.finger_detection_radius)
    return cluster.placed(path, heights), _rocked(path, options.frame_interval, rng)


def _rocked(path: Wandering, interval: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Point the tip's +z at the skin, and rock it to and fro, so that all of it comes to touch."""
    n_frames = len(path.points)
    changes = _ROCK_CHANGES / interval
    tips = [2 * wandering_values(n_frames, changes, rng) - 1 for _ in range(2)]
    rocks = Rotation.from_rotvec(_ROCKING * np.column_stack([*tips, np.zeros(n_frames)]))
    facing = path.frames(np.zeros(n_frames)) * [1, -1, -1]
    return np.asarray(facing @ rocks.as_matrix())


def _apart(
    geodesic: Callable[[Points], Points], n_body: int, middle: Points
) -> Callable[[Points], Points]:
    """Measure along the body and along the fingertip, and not between them."""

    def measured(positions: Points) -> Points:
        distances = np.full((len(positions), len(positions)), np.inf)
        distances[:n_body, :n_body] = geodesic(positions[:n_body])
        distances[n_body:, n_body:] = great_circles(positions[n_body:] - middle)
        return distances

    return measured
