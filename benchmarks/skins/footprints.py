"""Stimuli beyond the scenarios of the package: how bodies, hands, feet and tissue touch sensors.

Each function returns readings, shape (T, N), of sensors at given places. All are kinematic and
fast; lengths are in spacings of neighbouring sensors. The recordings that were kept aside from the
development of the methods are of these kinds: long contacts, contacts of unlike sizes, a grasping
hand, walking feet, regions touched in turn, waves in tissue, sources seen through a conductor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter
from scipy.spatial.distance import cdist

from anisomap.evaluation.scoring import median_spacing

Floats = NDArray[np.float64]

CONTACT_FRAMES = 10
"""Frames of a contact, which is pressed and released."""

_PRESS = np.sin(np.pi * (np.arange(CONTACT_FRAMES) + 0.5) / CONTACT_FRAMES)


def bars(places: Floats, n_frames: int, rng: np.random.Generator) -> Floats:
    """Contacts three times as long as wide, all along one direction."""
    return _pressed(places, n_frames, _centres(places, n_frames, rng), rng, stretch=3.0)


def bars_of_all_directions(places: Floats, n_frames: int, rng: np.random.Generator) -> Floats:
    """Contacts three times as long as wide, each along a direction of its own."""
    centres = _centres(places, n_frames, rng)
    directions = rng.standard_normal((len(centres), 3))
    return _pressed(places, n_frames, centres, rng, stretch=3.0, directions=directions)


def unlike_sizes(places: Floats, n_frames: int, rng: np.random.Generator) -> Floats:
    """Contacts of 1.5 spacings at one end of the skin and of 6 at the other."""
    centres = _centres(places, n_frames, rng)
    share = _along(centres, places)
    return _pressed(places, n_frames, centres, rng, radius=1.5 * 4.0**share)


def grasp(places: Floats, n_frames: int, rng: np.random.Generator) -> Floats:
    """Two contacts at a time, at mirrored places, as of a thumb and fingers."""
    centres = _centres(places, n_frames, rng)
    axis = _axes(places)[1]
    middle = places.mean(axis=0)
    opposite = centres - 2 * np.outer((centres - middle) @ axis, axis)
    return np.maximum(
        _pressed(places, n_frames, centres, rng), _pressed(places, n_frames, opposite, rng)
    )


def regions_in_turn(places: Floats, n_frames: int, rng: np.random.Generator) -> Floats:
    """Five runs, each of which touches one slice of the skin."""
    centres = _centres(places, n_frames, rng)
    centres = centres[np.argsort(np.floor(5 * _along(centres, places)), kind="stable")]
    return _pressed(places, n_frames, centres, rng)


def walking(places: Floats, n_frames: int, rng: np.random.Generator) -> Floats:
    """Press in steps of 40 frames, from heel to toe, each with a sway of its own."""
    frames = np.arange(n_frames)
    step, phase = np.divmod(frames, 40)
    phase = phase / 28  # the foot is in the air after 28 frames
    n_steps = int(step[-1]) + 1
    long, wide = (_along(places, places, axis) for axis in (0, 1))
    sway, load = rng.normal(0.5, 0.2, n_steps)[step], rng.uniform(0.7, 1.3, n_steps)[step]
    centre = phase + rng.normal(0, 0.05, n_steps)[step]
    pressure = 1 - ((long - centre[:, None]) / 0.35) ** 2 - ((wide - sway[:, None]) / 0.9) ** 2
    gains = rng.uniform(0.6, 1.4, len(places))
    return np.asarray(
        np.where(phase[:, None] < 1, load[:, None] * np.maximum(0, pressure), 0) * gains
    )


def waves(places: Floats, n_frames: int, rng: np.random.Generator) -> Floats:
    """Waves, much wider than the spacing, that spread from random places."""
    scale = median_spacing(places)
    readings = np.zeros((n_frames, len(places)))
    for start in range(0, n_frames, 30):
        origin = places[rng.integers(len(places))]
        distance = np.linalg.norm(places - origin, axis=1) / scale
        reach, speed = rng.uniform(4, 15), rng.uniform(0.3, 1.0)
        time = np.arange(min(30, n_frames - start))[:, None]
        front = np.exp(-(((distance - speed * time) / 3) ** 2)) * (distance < reach)
        readings[start : start + len(time)] += front
    return rng.poisson(2 * readings).astype(np.float64)


def conducted_sources(places: Floats, n_frames: int, rng: np.random.Generator) -> Floats:
    """Slow sources seen through a conductor by all sensors, with noise, as in an EEG."""
    n_sources = 40
    size = np.linalg.norm(places - places.mean(axis=0), axis=1).max()
    sources = places.mean(axis=0) + rng.standard_normal((n_sources, places.shape[1])) * size / 2
    weights = 1 / (0.2 + (cdist(places, sources) / size) ** 2) * rng.choice([-1, 1], n_sources)
    activity = lfilter([1.0], [1.0, -0.9], rng.standard_normal((n_frames, n_sources)), axis=0)
    signal = activity @ weights.T
    return np.asarray(signal + 0.1 * signal.std() * rng.standard_normal(signal.shape))


FOOTPRINTS: Mapping[str, Callable[[Floats, int, np.random.Generator], Floats]] = {
    "bars": bars,
    "bars-of-all-directions": bars_of_all_directions,
    "unlike-sizes": unlike_sizes,
    "grasp": grasp,
    "regions-in-turn": regions_in_turn,
    "walking": walking,
    "waves": waves,
    "conducted-sources": conducted_sources,
}
"""Functions ``readings(places, n_frames, rng)`` of places, shape (N, 3)."""


def _centres(places: Floats, n_frames: int, rng: np.random.Generator) -> Floats:
    """Draw the centre of each contact, near a sensor."""
    n_contacts = -(-n_frames // CONTACT_FRAMES)
    jitter = 0.5 * median_spacing(places) * rng.standard_normal((n_contacts, places.shape[1]))
    return np.asarray(places[rng.integers(len(places), size=n_contacts)] + jitter)


def _pressed(
    places: Floats,
    n_frames: int,
    centres: Floats,
    rng: np.random.Generator,
    *,
    radius: float | Floats = 2.5,
    stretch: float = 1.0,
    directions: Floats | None = None,
) -> Floats:
    """Press contacts one after the other; each is an ellipsoid, long along its direction."""
    scale = median_spacing(places)
    if directions is None:
        directions = np.broadcast_to(_axes(places)[0], centres.shape)
    unit = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    offsets = (places - centres[:, None]) / scale
    along = np.einsum("cnd,cd->cn", offsets, unit)
    squared = (offsets**2).sum(axis=2) - (1 - 1 / stretch**2) * along**2
    radii = np.broadcast_to(radius, len(centres))[:, None]
    depth = rng.uniform(0.5, 1.0, len(centres))[:, None] - squared / radii**2
    pressed = np.maximum(0, depth[:, None, :] - 1 + _PRESS[None, :, None])
    return np.asarray(pressed.reshape(-1, len(places))[:n_frames])


def _axes(places: Floats) -> Floats:
    """Return the principal axes of the skin, the longest first."""
    return np.asarray(np.linalg.svd(places - places.mean(axis=0), full_matrices=False)[2])


def _along(points: Floats, places: Floats, axis: int = 0) -> Floats:
    """Return where points lie along an axis of the skin, from 0 to 1."""
    direction = _axes(places)[axis]
    ends = places @ direction
    return np.asarray(np.clip((points @ direction - ends.min()) / np.ptp(ends), 0, 1))
