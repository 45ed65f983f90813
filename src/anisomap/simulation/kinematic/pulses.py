"""Pulses: point sources flash around the body, and sensors receive them as radios would.

The setting of Modayil (2010), "Discovering sensor space: constructing spatial embeddings that
explain sensor correlations" (IEEE International Conference on Development and Learning), as
McGregor et al. (2011) describe it: "sensors were stimulated by multiple point source pulses, with
the response at each sensor depending on the Euclidean distances of the sensor from the point
sources". The body stands in nothing's way: no side of it is in the shade. How the response falls
off, how many pulses there are and how long they last is our choice.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import cdist

from anisomap.errors import InputError
from anisomap.scene import Prop
from anisomap.simulation.bodies.body import Body
from anisomap.simulation.checks import check_count, check_positive
from anisomap.simulation.geometry import solids
from anisomap.simulation.geometry.solids import Points
from anisomap.simulation.options import REACH, parameter
from anisomap.simulation.world import Progress, Run, still_life

_SEEN = 0.05  # radius of a drawn source, x reach
_ROUNDS = 1000


@dataclass(frozen=True)
class PulsesOptions:
    """Parameters of pulses; defaults are for the paper's sphere, see `simulation.options`.

    Parameters
    ----------
    n_sources : int
        3: how many flash at any time, each at a new place with each pulse.
    strength : float
        Reading of a sensor right at a source at the top of its pulse. 1: any unit will do.
    field_radius : float
        Metres from the middle of the body within which sources are. 1.5: near enough that each
        pulse is felt more on one side than on the other.
    half_distance : float
        Metres at which the response is half of that at the source; it is strength / (1 + (distance
        / half_distance)^2), which far off is the inverse square. 0.4: about the distance between
        neighbouring sensors of the sphere.
    pulse_length : float
        Seconds that a pulse lasts; it rises and falls as the square of a sine. 0.4: eight frames.
    frame_interval : float
        Seconds between frames. 0.05: as in bombardment.

    Raises
    ------
    InputError
        If one is not positive, or there is no source.
    """

    n_sources: int = 3
    strength: float = 1.0
    field_radius: float = parameter(1.5, "m", REACH)
    half_distance: float = parameter(0.4, "m", REACH)
    pulse_length: float = 0.4
    frame_interval: float = 0.05

    def __post_init__(self) -> None:
        check_count("n_sources", self.n_sources)
        check_positive("strength", self.strength)
        check_positive("field_radius", self.field_radius, "m")
        check_positive("half_distance", self.half_distance, "m")
        check_positive("pulse_length", self.pulse_length, "s")
        check_positive("frame_interval", self.frame_interval, "s")


def pulses(
    body: Body,
    n_frames: int,
    options: PulsesOptions,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Run:
    """Record what a body's sensors receive from point sources around it.

    Parameters
    ----------
    body : Body
    n_frames : int
    options : PulsesOptions
    rng : numpy.random.Generator
        Draws places and times.
    progress : callable, optional
        Told the share done, from 0 to 1.

    Returns
    -------
    Run
        Every sensor hears every pulse, if only faintly: unlike touch, readings are hardly ever 0.

    Raises
    ------
    InputError
        If there is no room for sources outside the body within `field_radius`.
    """
    places, strengths = draw_pulses(body, n_frames, options, rng)
    readings = read_pulses(body.positions, places, strengths, options.half_distance)
    if progress is not None:
        progress(1.0)
    speck = solids.ball(_SEEN * body.reach).outline
    return Run(
        readings,
        rate_hz=1 / options.frame_interval,
        facts=asdict(options),
        props=(*still_life(body), Prop("stimulus", speck, places)),
        sensors=body.positions[None],
    )


def read_pulses(
    sensors: ArrayLike, places: ArrayLike, strengths: ArrayLike, half_distance: float
) -> NDArray[np.float32]:
    """Read point sources: the sum of what comes from each.

    Parameters
    ----------
    sensors : array_like of shape (N, 3)
    places : array_like of shape (T, S, 3)
        Of S sources in each of T frames.
    strengths : array_like of shape (T, S)
    half_distance : float
        Where the response is half of the strength.

    Returns
    -------
    ndarray of shape (T, N)
        Sum over sources of ``strength / (1 + (distance / half_distance) ** 2)``.
    """
    sensors = np.asarray(sensors, dtype=np.float64)
    frames = zip(np.asarray(places, dtype=np.float64), np.asarray(strengths), strict=True)
    falloff = [
        strength @ (1 / (1 + cdist(place, sensors, "sqeuclidean") / half_distance**2))
        for place, strength in frames
    ]
    return np.array(falloff, dtype=np.float32)


def draw_pulses(
    body: Body, n_frames: int, options: PulsesOptions, rng: np.random.Generator
) -> tuple[Points, NDArray[np.float64]]:
    """Draw where sources are, and how strong each is.

    Returns
    -------
    places : ndarray of shape (T, S, 3)
        Uniformly in a ball about the body, and outside the body.
    strengths : ndarray of shape (T, S)
        From 0, between pulses, to `options.strength`. Each source starts somewhere in a pulse.
    """
    time = np.arange(n_frames)[:, None] * options.frame_interval / options.pulse_length
    time = time + rng.random(options.n_sources)
    pulse = time.astype(np.intp)
    n_pulses = int(pulse.max()) + 1
    drawn = _around(body, n_pulses * options.n_sources, options.field_radius, rng)
    places = drawn.reshape(n_pulses, options.n_sources, 3)[pulse, np.arange(options.n_sources)]
    return places, options.strength * np.sin(np.pi * (time - pulse)) ** 2


def _around(body: Body, n_points: int, radius: float, rng: np.random.Generator) -> Points:
    """Draw points outside the body, uniformly in a ball about the origin; (n, 3)."""
    found = np.empty((0, 3))
    for _ in range(_ROUNDS):
        drawn = rng.uniform(-radius, radius, (math.ceil(2.5 * n_points), 3))
        drawn = drawn[np.linalg.norm(drawn, axis=1) <= radius]
        if len(drawn):
            found = np.vstack([found, drawn[body.distance(drawn) > 0]])
        if len(found) >= n_points:
            return found[:n_points]
    raise InputError(
        f"field_radius is {radius:g} m, which leaves no room outside the body; take more than "
        f"{body.reach:g} m"
    )
