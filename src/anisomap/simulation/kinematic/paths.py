"""Paths over a body's skin: strokes along lines and circles, in changing directions.

Whatever is moved over a skin by hand follows one: a palm, a roller, a fingertip. The pressure on
the way varies slowly, and now and then the hand lifts off and comes down elsewhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from anisomap.errors import InputError
from anisomap.simulation.bodies.body import ON_SURFACE, Body, nearest_neighbours
from anisomap.simulation.checks import check_positive
from anisomap.simulation.geometry.solids import Points
from anisomap.simulation.geometry.spreading import sample_surface
from anisomap.simulation.options import REACH, parameter

_STONES = 4000
_FACING = 0.5  # cosine: a stone that faces further away than this is no part of a sensor's skin
_HOLE = 4.0  # typical gaps between stones: the largest hole that chance leaves in them
_STEP = 0.02  # of the reach
_FREE = 0.2  # of a stroke's length: nearer than that there is nowhere to head for
_STRAY = 0.3  # radians by which a stroke misses what it heads for
_ATTEMPTS = 3
_STEEPEST = 0.1  # sine between heading and normal: a wall
_LINE = (0.5, 1.5)  # x stroke length
_CIRCLE = (0.15, 0.35)  # radius, x stroke length
_TURNS = (1.0, 2.0)
_PRESS_CHANGES = 0.5  # seconds from one random pressure to the next
_RISE = np.array([1, 2, 3]) / 3


@dataclass(frozen=True)
class StrokeOptions:
    """Parameters of strokes; defaults are for the paper's sphere, see `simulation.options`.

    Parameters
    ----------
    speed : float
        Metres a second along the skin. 2: a way around the sphere takes 3 s, as a hand that rubs
        a ball or a patch of its own size takes it.
    stroke_length : float
        Metres. 1.2: some three sensors of the sphere, or across most of a patch; each stroke
        takes half of it to one and a half.
    circle_share : float
        Which share of strokes are circles, from 0 to 1. 0.4: the paper's experimenters made both.
    lift_share : float
        After which share of strokes the hand comes down elsewhere, from 0 to 1. 0.25: so that it
        comes to parts that no stroke leads to.
    press_depth : float
        Metres that it presses into the skin at most; how much wanders between 0 and that within
        half a second. 0.1: a skin of silicone is some millimetres thick on a patch of some
        centimetres.
    frame_interval : float
        Seconds between frames. 0.05: from one to the next, it moves by a quarter of the distance
        between neighbouring sensors of the sphere.

    Raises
    ------
    InputError
        If a length, the speed or the interval is not positive, a share is not in [0, 1], or a
        stroke is over within a frame.
    """

    speed: float = parameter(2.0, "m/s", REACH)
    stroke_length: float = parameter(1.2, "m", REACH)
    circle_share: float = 0.4
    lift_share: float = 0.25
    press_depth: float = parameter(0.1, "m", REACH)
    frame_interval: float = 0.05

    def __post_init__(self) -> None:
        check_positive("speed", self.speed, "m/s")
        check_positive("stroke_length", self.stroke_length, "m")
        check_positive("press_depth", self.press_depth, "m")
        check_positive("frame_interval", self.frame_interval, "s")
        for name in ("circle_share", "lift_share"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name} is {getattr(self, name):g}; it must be from 0 to 1")
        if self.speed * self.frame_interval > self.stroke_length:
            raise InputError(
                f"at {self.speed:g} m/s a stroke of {self.stroke_length:g} m is over within a "
                f"frame of {self.frame_interval:g} s; take a speed of at most "
                f"{self.stroke_length / self.frame_interval:g} m/s, or shorter frames"
            )


@dataclass(frozen=True, eq=False)
class Skin:
    """A body's surface as points that stand densely on it.

    Attributes
    ----------
    points, normals : ndarray of shape (P, 3)
        All of the surface, the sensors first.
    near : ndarray of shape (Q,)
        Which of them belong to a sensor: no further from it than its neighbours are, and facing
        the same way.
    """

    points: Points
    normals: Points
    near: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Wandering:
    """A path over a skin.

    Attributes
    ----------
    points, normals, headings : ndarray of shape (T, 3)
        Where it is on the surface in each frame, the unit normal there, and the unit direction in
        which it moves.
    lifts : ndarray of shape (T,)
        How far it is lifted off, from 0 on the skin to 1 at the top. At the top it is somewhere
        else from one frame to the next.
    presses : ndarray of shape (T,)
        How hard it presses, from 0 to 1; continuous in time.
    n_strokes : int
    """

    points: Points
    normals: Points
    headings: Points
    lifts: NDArray[np.float64]
    presses: NDArray[np.float64]
    n_strokes: int

    def frames(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """Give the orientation of what moves along without turning with its strokes.

        Parameters
        ----------
        angles : ndarray of shape (T,)
            By how much it is turned about the normal. Radians.

        Returns
        -------
        ndarray of shape (T, 3, 3)
            Columns are its x, y and z; z is the normal, and x is carried along the surface as
            straight as that allows (parallel transport).
        """
        ahead = np.empty_like(self.points)
        carried = self.headings[0]
        for t, normal in enumerate(self.normals):
            ahead[t] = carried = tangent(carried, normal)
        ahead = turned(ahead, self.normals, angles[:, None])
        return np.stack([ahead, np.cross(self.normals, ahead), self.normals], axis=-1)


def find_skin(body: Body, rng: np.random.Generator) -> Skin:
    """Sample a body's surface, and tell which part of it bears sensors."""
    stones, outward = sample_surface(body.solids, _STONES, rng)
    points, normals = np.vstack([body.positions, stones]), np.vstack([body.normals, outward])
    away, owner = map(np.asarray, KDTree(body.positions).query(points))
    room = np.full(body.n_sensors, body.spacing)
    if body.n_sensors > 1:
        room = np.maximum(room, nearest_neighbours(body.positions, 1)[0][:, 0])
    facing = np.einsum("pd,pd->p", normals, body.normals[owner])
    return Skin(points, normals, np.flatnonzero((away <= room[owner]) & (facing > _FACING)))


def wander(
    body: Body, skin: Skin, n_frames: int, options: StrokeOptions, rng: np.random.Generator
) -> Wandering:
    """Stroke a body's skin, heading for where it has been least.

    Parameters
    ----------
    body : Body
    skin : Skin
        Of that body.
    n_frames : int
    options : StrokeOptions
    rng : numpy.random.Generator

    Returns
    -------
    Wandering
    """
    walk = _Walk(body, skin, options)
    where = _set_down(walk, rng)
    frames: list[Points] = []
    lifts: list[NDArray[np.float64]] = []
    n_done = n_strokes = failures = 0
    while n_done < n_frames:
        stroke = _stroke(walk, where, n_frames - n_done, rng)
        n_strokes += bool(len(stroke))
        failures = 0 if len(stroke) else failures + 1
        parts, heights = [stroke], [np.zeros(len(stroke))]
        if len(stroke):
            where = stroke[-1]
            walk.count(stroke[:, 0])
        if failures == _ATTEMPTS or rng.random() < options.lift_share:
            landing = _set_down(walk, rng)
            parts += [np.repeat(place[None], len(_RISE), axis=0) for place in (where, landing)]
            heights += [_RISE, _RISE[::-1]]
            where, failures = landing, 0
        frames += parts
        lifts += heights
        n_done += sum(len(part) for part in parts)
    return _on_surface(
        body,
        np.concatenate(frames)[:n_frames],
        np.concatenate(lifts)[:n_frames],
        wandering_values(n_frames, _PRESS_CHANGES / options.frame_interval, rng),
        n_strokes,
    )


def wandering_values(
    n_frames: int, frames_a_change: float, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Draw a value from 0 to 1 every so many frames, and glide from one to the next; (T,)."""
    time = np.arange(n_frames) / frames_a_change
    drawn = rng.random(int(time[-1]) + 2)
    before = time.astype(np.intp)
    share = (1 - np.cos(np.pi * (time - before))) / 2
    return np.asarray(drawn[before] * (1 - share) + drawn[before + 1] * share)


class _Walk:
    """What a walk over a skin keeps in mind: the ground, and how often it was at each sensor."""

    def __init__(self, body: Body, skin: Skin, options: StrokeOptions) -> None:
        self.options = options
        self.stride = options.speed * options.frame_interval
        self.steps = max(1, math.ceil(self.stride / (_STEP * body.reach)))
        self.sensors, self.facing = body.positions, body.normals
        self.visits = np.zeros(body.n_sensors)
        self._nearest_sensor = KDTree(body.positions)
        self._points, self._normals = skin.points[skin.near], skin.normals[skin.near]
        self._ground = KDTree(self._points)
        gaps = nearest_neighbours(self._points, 1)[0] if len(self._points) > 1 else [[body.reach]]
        self._hole = _HOLE * float(np.median(gaps)) + self.stride / self.steps

    def count(self, points: Points) -> None:
        """Count visits of the sensors that are nearest to points."""
        nearest = np.asarray(self._nearest_sensor.query(points)[1])
        self.visits += np.bincount(nearest, minlength=len(self.visits))

    def step(self, place: Points, turn: float) -> Points | None:
        """Take one step; None where that leaves the skin.

        A place is a point, the heading there, and the normal: shape (3, 3).
        """
        point, heading, normal = place
        if turn:
            heading = turned(heading, normal, turn)
        point = point + self.stride / self.steps * heading
        away, stone = self._ground.query(point)
        if away > self._hole:
            return None
        normal = self._normals[stone]
        across = heading - (heading @ normal) * normal
        length = math.sqrt(across @ across)
        if length < _STEEPEST:
            return None
        return np.array(
            [point - ((point - self._points[stone]) @ normal) * normal, across / length, normal]
        )


def _set_down(walk: _Walk, rng: np.random.Generator) -> Points:
    """Come down where the walk has been least; gives a place, shape (3, 3)."""
    sensor = int(np.argmin(walk.visits + rng.random(len(walk.visits))))
    normal = walk.facing[sensor]
    return np.array([walk.sensors[sensor], tangent(rng.standard_normal(3), normal), normal])


def _stroke(walk: _Walk, place: Points, most: int, rng: np.random.Generator) -> Points:
    """Make one stroke, until it is done or leaves the skin; places, shape (<= most, 3, 3)."""
    length, stride = walk.options.stroke_length, walk.stride
    if rng.random() < walk.options.circle_share:
        radius = length * rng.uniform(*_CIRCLE)
        n_frames = math.ceil(2 * np.pi * radius * rng.uniform(*_TURNS) / stride)
        turn = rng.choice([-1, 1]) * stride / radius / walk.steps
    else:
        n_frames, turn = math.ceil(length * rng.uniform(*_LINE) / stride), 0.0
        place = np.array([place[0], _aim(walk, place, rng), place[2]])
    frames: list[Points] = []
    for _ in range(min(n_frames, most)):
        for _ in range(walk.steps):
            taken = walk.step(place, turn)
            if taken is None:
                return np.array(frames).reshape(-1, 3, 3)
            place = taken
        frames.append(place)
    return np.array(frames)


def _aim(walk: _Walk, place: Points, rng: np.random.Generator) -> Points:
    """Choose a direction, towards a sensor within a stroke that was visited least; (3,)."""
    point, _, normal = place
    length = walk.options.stroke_length
    away = np.linalg.norm(walk.sensors - point, axis=1)
    candidates = np.flatnonzero((away > _FREE * length) & (away < _LINE[1] * length))
    if not candidates.size:
        return tangent(rng.standard_normal(3), normal)
    chosen = candidates[np.argmin(walk.visits[candidates] + rng.random(candidates.size))]
    aimed = tangent(walk.sensors[chosen] - point, normal)
    return turned(aimed, normal, _STRAY * rng.standard_normal())


def tangent(direction: Points, normal: Points) -> Points:
    """Turn directions into the plane across normals; both (..., 3), unit vectors come back."""
    across = direction - np.sum(direction * normal, axis=-1, keepdims=True) * normal
    length = np.linalg.norm(across, axis=-1, keepdims=True)
    # Straight down there is no way but any.
    any_way = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=-1)])
    any_way = any_way / np.linalg.norm(any_way, axis=-1, keepdims=True)
    return np.asarray(np.where(length > 1e-9, across / np.maximum(length, 1e-9), any_way))


def turned(
    direction: Points, normal: Points, angle: float | NDArray[np.float64]
) -> NDArray[np.float64]:
    """Turn tangents about normals; both (..., 3), angles in radians."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.asarray(cosine * direction + sine * np.cross(normal, direction))


def _on_surface(
    body: Body,
    frames: Points,
    lifts: NDArray[np.float64],
    presses: NDArray[np.float64],
    n_strokes: int,
) -> Wandering:
    # So near the surface, the slope of the distance leads to it in one step, save where parts meet.
    points = frames[:, 0]
    normals = body.outward(points)
    points = points - body.distance(points)[:, None] * normals
    off = np.abs(body.distance(points)) > ON_SURFACE * body.reach
    if off.any():
        points[off] = body.projected(points[off])
        normals[off] = body.outward(points[off])
    headings = tangent(frames[:, 1], normals)
    return Wandering(points, normals, headings, lifts, presses, n_strokes)
