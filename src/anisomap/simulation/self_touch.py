"""Self-touch: a fingertip with sensors strokes the body, and the sensors of both respond."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anisomap.scene import Prop
from anisomap.simulation import solids
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.bodies.lattice import fibonacci_cap, great_circles
from anisomap.simulation.checks import COUNT
from anisomap.simulation.options import REACH, ScenarioResult, option, positive, static_props
from anisomap.simulation.sensing import read_balls
from anisomap.simulation.solids import Points
from anisomap.simulation.strokes import (
    Cluster,
    StrokeOptions,
    StrokePath,
    draw_strokes,
    follow,
    sample_skin,
    smooth_random,
)

# Chosen by hand, so that all sensors of the fingertip touch the body.
_CAP_ANGLE = np.radians(75)  # of the cap with sensors, from the pole of the fingertip
_ROCKING = np.radians(50)  # largest rotation about each of two axes
_ROCKING_PERIOD = 1.0  # seconds between independent rotations

_CLEARANCE = 2.0  # x finger radius, between the body and the fingertip in the true positions


@dataclass(frozen=True)
class SelfTouchOptions(StrokeOptions):
    """Options of self-touch, in addition to those of `StrokeOptions`.

    Parameters
    ----------
    finger_radius : float
        Radius of the fingertip, a ball, in m. 0.3: that of a ball in `BombardmentOptions`.
    n_finger_sensors : int
        Number of sensors on the fingertip. 16: a usual density on robot fingers.
    detection_radius : float
        Detection radius of the body's sensors, in m. 0.4: close to that of bombardment, which has
        a similar stimulus.
    finger_detection_radius : float
        Detection radius of the fingertip's sensors, in m. 0.15: half of the finger radius, so that
        readings depend on the orientation of the fingertip.
    """

    press_depth: float = positive(0.1, "m", REACH, below="finger_radius")
    finger_radius: float = positive(0.3, "m", REACH)
    n_finger_sensors: int = option(16, COUNT)
    detection_radius: float = positive(0.4, "m", REACH)
    finger_detection_radius: float = positive(0.15, "m", REACH)


def self_touch(
    body: Body, n_frames: int, options: SelfTouchOptions, rng: np.random.Generator
) -> ScenarioResult:
    """Simulate a fingertip that strokes a body."""
    centres, rotations = move_fingertip(body, n_frames, options, rng)
    tip = options.finger_radius * fingertip_directions(options)
    moving = centres + np.einsum("tij,nj->tni", rotations, tip)
    on_body = read_balls(body.positions, centres, options.finger_radius, options.detection_radius)
    distance = body.distance(moving.reshape(-1, 3)).reshape(n_frames, -1)
    on_tip = np.maximum(options.finger_detection_radius - distance, 0).astype(np.float32)
    fixed = np.broadcast_to(body.positions, (n_frames, *body.positions.shape))
    finger = Prop("body", solids.ball(options.finger_radius).outline, centres, rotations[:, None])
    return ScenarioResult(
        np.hstack([on_body, on_tip]),
        (*static_props(body), finger),
        sensors=np.concatenate([fixed, moving], axis=1),
        body=with_fingertip(body, options),
    )


def fingertip_directions(options: SelfTouchOptions) -> Points:
    """Return unit vectors from the middle of the fingertip to its sensors; shape (M, 3).

    The sensors lie evenly on a spherical cap around +z.
    """
    return fibonacci_cap(options.n_finger_sensors, np.cos(_CAP_ANGLE))


def with_fingertip(body: Body, options: SelfTouchOptions) -> Body:
    """Combine a body and a fingertip beside it into one body."""
    radius, directions = options.finger_radius, fingertip_directions(options)
    middle = np.array([body.reach + (_CLEARANCE + 1) * radius, 0, 0])
    return Body(
        body.name,
        np.vstack([body.positions, middle + radius * directions]),
        np.vstack([body.normals, directions]),
        [*body.solids, solids.ball(radius, middle)],
        names=(*body.names, *(f"finger{i}" for i in range(len(directions)))),
        units=body.units,
        origin=body.origin,
        is_whole=body.is_whole,
        geodesic=body.geodesic and _separate_geodesics(body.geodesic, body.n_sensors, middle),
    )


def move_fingertip(
    body: Body, n_frames: int, options: SelfTouchOptions, rng: np.random.Generator
) -> tuple[Points, NDArray[np.float64]]:
    """Move a fingertip over a body: its centres (T, 1, 3) and rotations (T, 3, 3)."""
    skin = sample_skin(body, rng)
    path = draw_strokes(body, skin, n_frames, options, rng)
    cluster = Cluster(np.zeros((n_frames, 1, 3)), np.array([options.finger_radius]))
    detection_radius = max(options.detection_radius, options.finger_detection_radius)
    centres = follow(body, skin, path, cluster, options, detection_radius=detection_radius)
    return centres, _draw_rotations(path, options.frame_interval, rng)


def _draw_rotations(
    path: StrokePath, interval: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Point +z of the fingertip at the skin and rock it, so that all its sensors touch."""
    n_frames = len(path.points)
    period = _ROCKING_PERIOD / interval
    angles = [2 * smooth_random(n_frames, period, rng) - 1 for _ in range(2)]
    rocking = Rotation.from_rotvec(_ROCKING * np.column_stack([*angles, np.zeros(n_frames)]))
    facing = path.orientations(np.zeros(n_frames)) * [1, -1, -1]
    return np.asarray(facing @ rocking.as_matrix())


def _separate_geodesics(
    geodesic: Callable[[Points], Points], n_body: int, middle: Points
) -> Callable[[Points], Points]:
    """Combine geodesics of the body and of the fingertip; infinite between the two."""

    def measure(positions: Points) -> Points:
        distances = np.full((len(positions), len(positions)), np.inf)
        distances[:n_body, :n_body] = geodesic(positions[:n_body])
        distances[n_body:, n_body:] = great_circles(positions[n_body:] - middle)
        return distances

    return measure
