"""Pulses: point sources around the body, to which all sensors respond by distance.

Follows Modayil (2010), "Discovering sensor space: constructing spatial embeddings that explain
sensor correlations" (IEEE International Conference on Development and Learning), as described by
McGregor et al. (2011): "sensors were stimulated by multiple point source pulses, with the response
at each sensor depending on the Euclidean distances of the sensor from the point sources". The body
does not shield its sensors. The form of the decay and the number and length of pulses are not given
there; those here were chosen by hand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from anisomap.errors import InputError
from anisomap.scene import Prop
from anisomap.simulation import solids
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.checks import COUNT
from anisomap.simulation.options import (
    REACH,
    ScenarioOptions,
    ScenarioResult,
    option,
    positive,
    static_props,
)
from anisomap.simulation.solids import Points

_DRAWN_RADIUS = 0.05  # x reach; for drawing only
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
    """Simulate point sources around a body.

    All sensors respond to all pulses. Unlike readings of touch, readings are rarely zero.
    """
    places, strengths = draw_pulses(body, n_frames, options, rng)
    readings = read_pulses(body.positions, places, strengths, options.half_distance)
    shape = solids.ball(_DRAWN_RADIUS * body.reach).outline
    return ScenarioResult(readings, (*static_props(body), Prop("stimulus", shape, places)))


def read_pulses(
    sensors: ArrayLike, places: ArrayLike, strengths: ArrayLike, half_distance: float
) -> NDArray[np.float32]:
    """Read point sources: the sum of the responses to each.

    sensors (N, 3), places (T, S, 3), strengths (T, S).
    """
    sensors = np.asarray(sensors, dtype=np.float64)
    frames = zip(np.asarray(places, dtype=np.float64), np.asarray(strengths), strict=True)
    responses = [
        strength @ (1 / (1 + cdist(place, sensors, "sqeuclidean") / half_distance**2))
        for place, strength in frames
    ]
    return np.array(responses, dtype=np.float32)


def draw_pulses(
    body: Body, n_frames: int, options: PulsesOptions, rng: np.random.Generator
) -> tuple[Points, NDArray[np.float64]]:
    """Draw positions and strengths of the sources. Returns places (T, S, 3), strengths (T, S)."""
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
