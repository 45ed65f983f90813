"""Scenarios without physics: hands, a roller, a fingertip, a flat surface and pulses.

Rubbing models the hardware experiment of McGregor et al. (2011), section "Experimental Data": "an
irregular rubbing motion ... circular and linear motions in various directions pressing the palm of
the hand against the skin patch". Its runs had 1,054 to 2,128 frames.

Readings are in closed form, in single precision: its seven digits exceed the resolution of real
sensors. Parameters without a source were chosen by hand.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist
from scipy.spatial.transform import Rotation

from anisomap.base.scene import Prop
from anisomap.errors import InputError
from anisomap.numerics.ranges import COUNT, between
from anisomap.simulation import solids
from anisomap.simulation.bodies import fibonacci_cap, great_circles
from anisomap.simulation.body import Body
from anisomap.simulation.options import (
    REACH,
    ScenarioOptions,
    ScenarioResult,
    option,
    positive,
    static_props,
)
from anisomap.simulation.solids import Points, support
from anisomap.simulation.strokes import (
    Cluster,
    Skin,
    StrokeOptions,
    draw_strokes,
    follow,
    sample_skin,
    smooth_random,
)

_N_PADS = 7
_PAD_RADIUS = (0.3, 0.6)  # x hand_size
_PAD_HEIGHT_SPREAD = 0.2  # x hand_size
_MAX_TURN_RATE = 0.5  # rad/s
_TURN_PERIOD = 2.0  # seconds between independent turn rates
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
    return _positive(depths)


def read_capsules(
    sensors: Points, starts: Points, ends: Points, capsule_radius: float, detection_radius: float
) -> NDArray[np.float32]:
    """Read capsules: all points within a radius of a segment.

    sensors (N, 3), starts, ends (T, B, 3).
    """
    depths = []
    for start, axis in zip(starts, ends - starts, strict=True):
        from_start = sensors[:, None] - start
        along = np.einsum("nbd,bd->nb", from_start, axis) / np.einsum("bd,bd->b", axis, axis)
        distance = np.linalg.norm(from_start - np.clip(along, 0, 1)[..., None] * axis, axis=2)
        depths.append((detection_radius + capsule_radius - distance).max(axis=1))
    return _positive(depths)


def read_half_spaces(
    sensors: Points, directions: Points, offsets: NDArray[np.float64], detection_radius: float
) -> NDArray[np.float32]:
    """Read an infinite flat surface: all points ``x`` with ``x @ direction >= offset``.

    sensors (N, 3), directions (T, 3), offsets (T,).
    """
    gaps = offsets[:, None] - directions @ sensors.T
    return _positive(detection_radius - gaps)


def read_pulses(
    sensors: Points, places: Points, strengths: Points, half_distance: float
) -> NDArray[np.float32]:
    """Read point sources: the sum of the responses to each.

    sensors (N, 3), places (T, S, 3), strengths (T, S).
    """
    return _positive(
        [
            strength @ (1 / (1 + cdist(place, sensors, "sqeuclidean") / half_distance**2))
            for place, strength in zip(places, strengths, strict=True)
        ]
    )


def _positive(depths: ArrayLike) -> NDArray[np.float32]:
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
        cluster = Cluster(turned, self.radii)
        return follow(skin, path, cluster, options, options.detection_radius), path.n_strokes


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
    """Simulate a roller, a capsule, that rolls along the skin."""
    radius, half = options.roller_radius, options.roller_length / 2
    sensing = options.detection_radius
    skin = sample_skin(body, rng)
    path = draw_strokes(skin, n_frames, options, rng)
    across = np.cross(path.normals, path.headings)
    axes = half * across[:, None]
    cluster = Cluster(np.zeros_like(axes), np.array([radius]), axes)
    centres = follow(skin, path, cluster, options, sensing)
    readings = read_capsules(body.positions, centres - axes, centres + axes, radius, sensing)
    shape = solids.capsule(radius, [0, 0, -half], [0, 0, half])
    rotations = np.stack([path.normals, path.headings, across], axis=-1)
    stimulus = Prop("stimulus", shape.outline, centres, rotations[:, None])
    facts = {"n_strokes": path.n_strokes}
    return ScenarioResult(readings, (*static_props(body), stimulus), facts)


# Chosen so that all sensors of the fingertip touch the body.
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

    def directions(self) -> Points:
        """Return unit vectors from the middle of the fingertip to its sensors; shape (M, 3).

        The sensors lie evenly on a spherical cap around +z.
        """
        return fibonacci_cap(self.n_finger_sensors, np.cos(_CAP_ANGLE))


def self_touch(
    body: Body, n_frames: int, options: SelfTouchOptions, rng: np.random.Generator
) -> ScenarioResult:
    """Simulate a fingertip that strokes the body; the sensors of both are recorded."""
    radius, sensing = options.finger_radius, options.detection_radius
    skin = sample_skin(body, rng)
    path = draw_strokes(skin, n_frames, options, rng)
    cluster = Cluster(np.zeros((n_frames, 1, 3)), np.array([radius]))
    furthest = max(sensing, options.finger_detection_radius)
    centres = follow(skin, path, cluster, options, furthest)
    # +z of the fingertip points at the skin, and rocks so that all its sensors touch.
    period = _ROCKING_PERIOD / options.frame_interval
    angles = [2 * smooth_random(n_frames, period, rng) - 1 for _ in range(2)]
    rocking = Rotation.from_rotvec(_ROCKING * np.column_stack([*angles, np.zeros(n_frames)]))
    rotations = (path.orientations(np.zeros(n_frames)) * [1, -1, -1]) @ rocking.as_matrix()
    moving = centres + np.einsum("tij,nj->tni", rotations, radius * options.directions())
    distance = body.distance(moving.reshape(-1, 3)).reshape(n_frames, -1)
    on_body = read_balls(body.positions, centres, radius, sensing)
    on_tip = _positive(options.finger_detection_radius - distance)
    fixed = np.broadcast_to(body.positions, (n_frames, *body.positions.shape))
    finger = Prop("body", solids.ball(radius).outline, centres, rotations[:, None])
    return ScenarioResult(
        np.hstack([on_body, on_tip]),
        (*static_props(body), finger),
        sensors=np.concatenate([fixed, moving], axis=1),
        body=with_fingertip(body, options),
    )


def with_fingertip(body: Body, options: SelfTouchOptions) -> Body:
    """Combine a body and a fingertip beside it into one body."""
    radius, directions = options.finger_radius, options.directions()
    middle = np.array([body.reach + (_CLEARANCE + 1) * radius, 0, 0])
    n_body, geodesic = body.n_sensors, body.geodesic

    def separate_geodesics(positions: Points) -> Points:
        """Compute geodesics of the body and of the fingertip; infinite between the two."""
        distances = np.full((len(positions), len(positions)), np.inf)
        if geodesic is not None:
            distances[:n_body, :n_body] = geodesic(positions[:n_body])
        distances[n_body:, n_body:] = great_circles(positions[n_body:] - middle)
        return distances

    return replace(
        body,
        positions=np.vstack([body.positions, middle + radius * directions]),
        normals=np.vstack([body.normals, directions]),
        solids=[*body.solids, solids.ball(radius, middle)],
        names=(*body.names, *(f"finger{i}" for i in range(len(directions)))),
        geodesic=geodesic and separate_geodesics,
    )


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
    """Simulate a large flat surface that is pressed on the body from all sides.

    The surface is aimed at the normals of all sensors in turn. It does not reach into hollows, and
    touches all sensors along a straight line at once: the length of a cylinder is not observed.
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
    """Draw the direction (T, 3) and depth (T,) of the flat surface in each frame."""
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


_DRAWN_RADIUS = 0.05  # of a source, x reach; for drawing only
_MAX_ROUNDS = 1000  # of rejection sampling


@dataclass(frozen=True)
class PulsesOptions(ScenarioOptions):
    """Options of pulses. Defaults, for a sphere of 1 m, scale with the body.

    Parameters
    ----------
    n_sources : int
        Number of simultaneous sources; each moves to a new place with each pulse. 3: chosen by
        hand.
    strength : float
        Reading of a sensor at the position of a source at the peak of its pulse. 1: arbitrary
        units.
    field_radius : float
        Largest distance of sources from the middle of the body, in m. 1.5: near enough that a pulse
        is stronger on one side of the body.
    half_distance : float
        Distance at which the response is half of that at the source, in m. The response is strength
        / (1 + (distance / half_distance)^2), an inverse square at large distances. 0.4: about the
        spacing of the sensors on the sphere.
    pulse_length : float
        Duration of a pulse with the shape of a squared sine, in s. 0.4: eight frames.
    frame_interval : float
        Time between frames, in s. 0.05: as in bombardment.
    """

    n_sources: int = option(3, COUNT)
    strength: float = positive(1.0)
    field_radius: float = positive(1.5, "m", REACH)
    half_distance: float = positive(0.4, "m", REACH)
    pulse_length: float = positive(0.4, "s")


def pulses(
    body: Body, n_frames: int, options: PulsesOptions, rng: np.random.Generator
) -> ScenarioResult:
    """Simulate point sources around the body that emit pulses; readings fall off with distance.

    The body does not shield its sensors. Follows Modayil (2010), "Discovering sensor space:
    constructing spatial embeddings that explain sensor correlations" (IEEE International Conference
    on Development and Learning), as described by McGregor et al. (2011), who give neither the form
    of the decay nor the number and length of pulses.
    """
    places, strengths = draw_pulses(body, n_frames, options, rng)
    readings = read_pulses(body.positions, places, strengths, options.half_distance)
    shape = solids.ball(_DRAWN_RADIUS * body.reach).outline
    return ScenarioResult(readings, (*static_props(body), Prop("stimulus", shape, places)))


def draw_pulses(
    body: Body, n_frames: int, options: PulsesOptions, rng: np.random.Generator
) -> tuple[Points, NDArray[np.float64]]:
    """Draw places (T, S, 3) and strengths (T, S) of the sources."""
    time = np.arange(n_frames)[:, None] * options.frame_interval / options.pulse_length
    time = time + rng.random(options.n_sources)
    pulse = time.astype(np.intp)
    n_pulses = int(pulse.max()) + 1
    drawn = _draw_outside(body, n_pulses * options.n_sources, options.field_radius, rng)
    places = drawn.reshape(n_pulses, options.n_sources, 3)[pulse, np.arange(options.n_sources)]
    return places, options.strength * np.sin(np.pi * (time - pulse)) ** 2


def _draw_outside(body: Body, n_points: int, radius: float, rng: np.random.Generator) -> Points:
    """Draw points uniformly from a ball about the origin, outside the body; shape (n, 3)."""
    found = np.empty((0, 3))
    for _ in range(_MAX_ROUNDS):
        drawn = rng.uniform(-radius, radius, (math.ceil(2.5 * n_points), 3))
        drawn = drawn[np.linalg.norm(drawn, axis=1) <= radius]
        if len(drawn):
            found = np.vstack([found, drawn[body.distance(drawn) > 0]])
        if len(found) >= n_points:
            return found[:n_points]
    raise InputError(
        f"field_radius must exceed the reach of the body ({body.reach:g} m) to leave space for "
        f"sources, got {radius:g} m"
    )
