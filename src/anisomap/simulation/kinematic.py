"""Rubbing: a scenario without physics; a hand follows strokes over the skin.

It models the hardware experiment of McGregor et al. (2011), section "Experimental Data": "an
irregular rubbing motion ... circular and linear motions in various directions pressing the palm of
the hand against the skin patch". Its runs had 1,054 to 2,128 frames.

Readings are in closed form, in single precision, whose seven digits exceed the resolution of real
sensors. The pads of the palm move together in contact with the body. Pressure varies slowly. After
some strokes, the palm is lifted off and set down elsewhere. Parameters without a source were chosen
by hand.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from anisomap.numerics.neighbours import nearest_distances
from anisomap.numerics.ranges import between
from anisomap.numerics.surfaces import frames_along
from anisomap.simulation import solids
from anisomap.simulation.body import ON_SURFACE, Body
from anisomap.simulation.options import (
    REACH,
    Prop,
    ScenarioOptions,
    ScenarioResult,
    count_steps,
    option,
    positive,
    static_props,
)
from anisomap.simulation.solids import Points, sample_surface

_N_SAMPLES = 4000
_MIN_FACING = 0.5  # cosine between the normals of a surface point and of its nearest sensor
_MAX_HOLE = 4.0  # x median gap between surface points: larger than any gap of a random sample
_MAX_STEP = 0.02  # x reach
_MIN_TARGET_DISTANCE = 0.2  # x stroke length
_AIM_SPREAD = 0.3  # standard deviation of the direction of a stroke, in rad
_MAX_FAILURES = 3  # successive strokes that leave the skin immediately
_MIN_SLOPE = 0.1  # sine of the angle between heading and normal; smaller at steep walls
_LINE_LENGTH = (0.5, 1.5)  # x stroke length
_CIRCLE_RADIUS = (0.15, 0.35)  # x stroke length
_CIRCLE_TURNS = (1.0, 2.0)
_PRESSURE_PERIOD = 0.5  # seconds between independent pressures
_LIFT_PROFILE = (1 / 3, 2 / 3, 1.0)
_TOLERANCE = 1e-9  # x radius


@dataclass(frozen=True)
class StrokeOptions(ScenarioOptions):
    """Options of strokes. Defaults, for a sphere of 1 m, scale with the body.

    Parameters
    ----------
    speed : float
        Speed along the skin, in m/s. 2: once around the sphere in 3 s, like a hand that rubs a ball
        or a patch of the size of the hand.
    stroke_length : float
        Mean length of a stroke, in m; lengths vary from 0.5 to 1.5 times the mean. 1.2: about
        three sensor spacings of the sphere, or most of the width of a patch.
    circle_share : float
        Share of strokes that are circles, from 0 to 1. 0.4: the paper's experimenters made lines
        and circles.
    lift_share : float
        Share of strokes after which the stimulus is set down elsewhere, from 0 to 1. 0.25: the
        stimulus also reaches parts of the skin to which no stroke leads.
    press_depth : float
        Largest depth to which the stimulus presses into the skin, in m. Depth varies between 0 and
        this within half a second. 0.1: as for silicone a few millimetres thick on a patch of a few
        centimetres.
    frame_interval : float
        Time between frames, in s. 0.05: the stimulus moves by a quarter of the sensor spacing of
        the sphere.
    """

    speed: float = positive(2.0, "m/s", REACH)
    stroke_length: float = positive(1.2, "m", REACH)
    circle_share: float = option(0.4, between(0, 1))
    lift_share: float = option(0.25, between(0, 1))
    press_depth: float = positive(0.1, "m", REACH)

    def __post_init__(self) -> None:
        super().__post_init__()
        fastest = self.stroke_length / self.frame_interval
        self.at_most("speed", fastest, f"stroke_length / frame_interval ({fastest:g} m/s)")


@dataclass(frozen=True, eq=False)
class Skin:
    """A body and a dense sample of its surface: points and normals (P, 3), sensors first.

    covered: Indices of the points that belong to the skin: no further from the nearest sensor than
        the neighbours of this sensor are, and with a similar normal.
    """

    body: Body
    points: Points
    normals: Points
    covered: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class StrokePath:
    """A path over the skin.

    points, normals, headings (T, 3): Points on the surface, unit normals, directions of motion.
    lifts (T,): Height above the skin, from 0 (in contact) to 1, where the position jumps.
    presses (T,): Pressure from 0 to 1, continuous in time.
    """

    points: Points
    normals: Points
    headings: Points
    lifts: NDArray[np.float64]
    presses: NDArray[np.float64]
    n_strokes: int

    def orientations(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return orientations that do not follow the headings of strokes.

        angles (T,) -> (T, 3, 3).
        """
        x_axes = np.empty_like(self.points)
        carried = self.headings[0]
        for t, normal in enumerate(self.normals):
            x_axes[t] = carried = tangent(carried, normal)
        x_axes = rotate_about(x_axes, self.normals, angles[:, None])
        return np.stack([x_axes, np.cross(self.normals, x_axes), self.normals], axis=-1)


def sample_skin(body: Body, rng: np.random.Generator) -> Skin:
    """Sample the surface of a body, and find the part covered by sensors."""
    drawn, outward = sample_surface(body.solids, _N_SAMPLES, rng)
    points, normals = np.vstack([body.positions, drawn]), np.vstack([body.normals, outward])
    distance, sensor = map(np.asarray, KDTree(body.positions).query(points))
    radius = np.full(body.n_sensors, body.spacing)
    if body.n_sensors > 1:
        radius = np.maximum(radius, nearest_distances(body.positions))
    facing = np.einsum("pd,pd->p", normals, body.normals[sensor])
    covered = np.flatnonzero((distance <= radius[sensor]) & (facing > _MIN_FACING))
    return Skin(body, points, normals, covered)


def draw_strokes(
    skin: Skin,
    n_frames: int,
    options: StrokeOptions,
    rng: np.random.Generator,
    *,
    visits: NDArray[np.float64] | None = None,
) -> StrokePath:
    """Draw strokes over the skin of a body, towards the least visited sensors. visits (N,)."""
    body, walk = skin.body, _Walk(skin, options, rng)
    if visits is not None:
        walk.visits += visits
    state = walk.set_down()
    frames: list[Points] = []
    lifts: list[float] = []
    n_strokes = failures = 0
    while len(lifts) < n_frames:
        stroke = walk.draw_stroke(state, n_frames - len(lifts))
        frames += stroke
        lifts += [0.0] * len(stroke)
        failures += 1
        if stroke:
            state, failures, n_strokes = stroke[-1], 0, n_strokes + 1
            walk.visit(stroke)
        if failures == _MAX_FAILURES or rng.random() < options.lift_share:
            landing = walk.set_down()
            frames += [state] * len(_LIFT_PROFILE) + [landing] * len(_LIFT_PROFILE)
            lifts += [*_LIFT_PROFILE, *_LIFT_PROFILE[::-1]]
            state, failures = landing, 0
    places, headings, _ = np.array(frames[:n_frames]).swapaxes(0, 1)
    presses = smooth_random(n_frames, _PRESSURE_PERIOD / options.frame_interval, rng)
    # One step along the gradient of the distance is exact, except near edges between solids.
    normals = body.normals_at(places)
    points = places - body.distance(places)[:, None] * normals
    off = np.abs(body.distance(points)) > ON_SURFACE * body.reach
    if off.any():
        points[off] = body.project(points[off])
        normals[off] = body.normals_at(points[off])
    heights = np.array(lifts[:n_frames])
    return StrokePath(points, normals, tangent(headings, normals), heights, presses, n_strokes)


def smooth_random(n_frames: int, period: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw uniform values in [0, 1], one per `period` frames, with cosine interpolation; (T,)."""
    time = np.arange(n_frames) / period
    drawn = rng.random(int(time[-1]) + 2)
    before = time.astype(np.intp)
    share = (1 - np.cos(np.pi * (time - before))) / 2
    return np.asarray(drawn[before] * (1 - share) + drawn[before + 1] * share)


class _Walk:
    """Skin and visit counts of a walk. A state is (point, heading, normal), shape (3, 3)."""

    def __init__(self, skin: Skin, options: StrokeOptions, rng: np.random.Generator) -> None:
        self._body, self._options, self._rng = skin.body, options, rng
        self.visits = np.zeros(skin.body.n_sensors)
        self._stride = options.speed * options.frame_interval
        self._n_steps = count_steps(self._stride, _MAX_STEP * skin.body.reach)
        self._points, self._normals = skin.points[skin.covered], skin.normals[skin.covered]
        self._sensor_tree, self._point_tree = KDTree(skin.body.positions), KDTree(self._points)
        gaps = nearest_distances(self._points) if len(self._points) > 1 else [skin.body.reach]
        self._max_distance = _MAX_HOLE * float(np.median(gaps)) + self._stride / self._n_steps

    def visit(self, stroke: list[Points]) -> None:
        """Count the visits of a stroke to the nearest sensors."""
        _, nearest = self._sensor_tree.query(np.array(stroke)[:, 0])
        self.visits += np.bincount(np.asarray(nearest), minlength=len(self.visits))

    def set_down(self) -> Points:
        """Start at the least visited sensor, in a random direction."""
        sensor = int(np.argmin(self.visits + self._rng.random(len(self.visits))))
        normal = self._body.normals[sensor]
        heading = tangent(self._rng.standard_normal(3), normal)
        return np.array([self._body.positions[sensor], heading, normal])

    def draw_stroke(self, state: Points, max_frames: int) -> list[Points]:
        """Draw the states of a stroke; it ends early if it leaves the skin."""
        rng, length, stride = self._rng, self._options.stroke_length, self._stride
        if rng.random() < self._options.circle_share:
            radius = length * rng.uniform(*_CIRCLE_RADIUS)
            n_frames = math.ceil(2 * np.pi * radius * rng.uniform(*_CIRCLE_TURNS) / stride)
            turn = rng.choice([-1, 1]) * stride / radius / self._n_steps
        else:
            n_frames, turn = math.ceil(length * rng.uniform(*_LINE_LENGTH) / stride), 0.0
            state = np.array([state[0], self._aim(state), state[2]])
        frames: list[Points] = []
        for _ in range(min(n_frames, max_frames)):
            for _ in range(self._n_steps):
                following = self._step(state, turn)
                if following is None:
                    return frames
                state = following
            frames.append(state)
        return frames

    def _aim(self, state: Points) -> Points:
        """Draw a direction, roughly to the least visited sensor within a stroke length; (3,)."""
        (point, _, normal), rng, sensors = state, self._rng, self._body.positions
        length = self._options.stroke_length
        distance = np.linalg.norm(sensors - point, axis=1)
        candidates = np.flatnonzero(
            (distance > _MIN_TARGET_DISTANCE * length) & (distance < _LINE_LENGTH[1] * length)
        )
        if not candidates.size:
            return tangent(rng.standard_normal(3), normal)
        chosen = candidates[np.argmin(self.visits[candidates] + rng.random(candidates.size))]
        aimed = tangent(sensors[chosen] - point, normal)
        return rotate_about(aimed, normal, _AIM_SPREAD * rng.standard_normal())

    def _step(self, state: Points, turn: float) -> Points | None:
        """Take one step; return None if it leaves the skin."""
        point, heading, normal = state
        if turn:
            heading = rotate_about(heading, normal, turn)
        point = point + self._stride / self._n_steps * heading
        distance, nearest = self._point_tree.query(point)
        if distance > self._max_distance:
            return None
        normal = self._normals[nearest]
        across = heading - (heading @ normal) * normal
        length = math.sqrt(across @ across)
        if length < _MIN_SLOPE:
            return None
        height = (point - self._points[nearest]) @ normal
        return np.array([point - height * normal, across / length, normal])


def tangent(directions: Points, normals: Points) -> Points:
    """Project directions onto tangent planes and normalise them; both of shape (..., 3)."""
    across = directions - np.sum(directions * normals, axis=-1, keepdims=True) * normals
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    # Directions along the normal have no projection; any tangent is valid.
    fallback = frames_along(normals)[..., 0]
    return np.asarray(np.where(length > 1e-9, across / np.maximum(length, 1e-9), fallback))


def rotate_about(
    tangents: Points, normals: Points, angle: float | NDArray[np.float64]
) -> NDArray[np.float64]:
    """Rotate tangents about normals, both of shape (..., 3), by angles in rad."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.asarray(cosine * tangents + sine * np.cross(normals, tangents))


def placed(path: StrokePath, offsets: Points, heights: NDArray[np.float64]) -> Points:
    """Return the centre of each ball at heights (T,) above a path; (T, B, 3)."""
    middle = path.points + heights[:, None] * path.normals
    return np.asarray(middle[:, None] + offsets)


def settle(
    skin: Skin,
    path: StrokePath,
    offsets: Points,
    radii: NDArray[np.float64],
    depths: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Lower balls that move together along the normals of a path until they touch the body.

    offsets (T, B, 3): Centres of the balls relative to the point of the path, in each frame.
    radii (B,), depths (T,) -> heights (T,).
    """
    surface = KDTree(skin.points)
    extents = (np.linalg.norm(offsets, axis=2) + radii).max(axis=1)
    lowest = (radii - np.einsum("tbd,td->tb", offsets, path.normals)).min(axis=1)
    heights = np.asarray(lowest - depths, dtype=np.float64)
    for t, (point, normal) in enumerate(zip(path.points, path.normals, strict=True)):
        rise, may_sink = np.inf, True
        while may_sink or rise > _TOLERANCE * extents[t]:
            middle = point + heights[t] * normal
            near = surface.query_ball_point(middle, extents[t])
            around = np.vstack([skin.points[near], point]) - middle
            rise = _required_rise(offsets[t], radii, around, normal, depths[t])
            heights[t] += rise if may_sink else max(rise, 0.0)
            may_sink = False
    # The depth beyond `depths` by exact distances.
    points = placed(path, offsets, heights)
    clear = skin.body.distance(points.reshape(-1, 3)).reshape(points.shape[:2])
    return np.asarray(heights + np.maximum((radii - clear).max(axis=1) - depths, 0))


def _required_rise(
    offsets: Points, radii: NDArray[np.float64], points: Points, normal: Points, depth: float
) -> float:
    """Return the rise at which balls rest on points, which are relative to the centres."""
    from_middle = points[:, None] - offsets
    up = from_middle @ normal
    across = from_middle - up[..., None] * normal
    squared = (radii - depth) ** 2 - np.einsum("sbd,sbd->sb", across, across)
    half = np.sqrt(np.maximum(squared, 0))
    tops = (up + half)[up < half - _TOLERANCE * radii]
    return float(tops.max()) if tops.size else 0.0


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
        Detection radius of the sensors, in m. 0.3: less than in the scenario bombardment, since the
        pads of a palm already touch several sensors. The Mantel r of r-ANISOMAP with 0.15, 0.2, 0.3
        and 0.44 is .95, .97, .98, .99 on the sphere, .85, .88, .88, .85 on the cylinder, and always
        .98 on the hexagon in 2D (means of 3 to 5 seeds).
    """

    hand_size: float = positive(0.35, "m", REACH)
    detection_radius: float = positive(0.3, "m", REACH)

    def __post_init__(self) -> None:
        super().__post_init__()
        thickness = _PAD_RADIUS[0] * self.hand_size
        bound = f"the thickness of the palm ({thickness:g} m)"
        self.at_most("press_depth", thickness, bound, "; reduce it or increase hand_size")


class Palm:
    """A central soft pad surrounded by pads of irregular size and position, on a skin.

    centres (P, 3), radii (P,): Balls that form the pads, with the skin at z = 0.
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
    """A palm that rubs a body in bouts, each at given places."""

    def __init__(self, body: Body, options: RubbingOptions, rng: np.random.Generator) -> None:
        self._body, self._sensing = body, options.detection_radius
        self._palm = Palm(sample_skin(body, rng), options, rng)

    def rub(
        self, n_frames: int, sensors: Collection[int] = (), contacts: NDArray[np.intp] | None = None
    ) -> NDArray[np.float32]:
        """Rub for `n_frames` frames. Returns (n_frames, N)."""
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
