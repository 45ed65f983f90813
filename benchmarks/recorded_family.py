"""A family of recordings of one skin that differ in what makes recordings plain or awkward.

Contacts are smooth pulses at random places of a sphere. Each member is drawn from a seed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap import Recording
from benchmarks.inputs import Press, directions

Readings = NDArray[np.float32]

_SPACINGS = 2.2  # radius of the touched caps, in spacings of the sensors
_WIDE = 0.6  # radius of the caps that touch a tenth of the skin
_PULSE = Press(width=20, length=1.0, profile=0)  # contacts may begin before the first frame
_FRAMES_PER_CONTACT = 10
_NOISE = 0.01  # standard deviation; peaks of contacts are .5 to 1.5
_PARTS = 8  # separate skins
_MISSING = 0.3


def touched(
    n_sensors: int,
    n_frames: int,
    rng: np.random.Generator,
    *,
    radius: float | None = None,
    contacts: int | None = None,
) -> Readings:
    """Simulate a sphere touched at random places; readings are 0 at rest, shape (T, N)."""
    sensors = directions(n_sensors, rng)
    count = contacts or max(5, n_frames // _FRAMES_PER_CONTACT)
    typical = _SPACINGS * np.sqrt(4 * np.pi / n_sensors) if radius is None else radius
    readings = np.zeros((n_frames, n_sensors), np.float32)
    for place, at, height, reach in zip(
        directions(count, rng),
        rng.integers(n_frames, size=count).tolist(),
        rng.uniform(0.5, 1.5, count),
        typical * rng.uniform(0.7, 1.3, count),
        strict=True,
    ):
        _PULSE.onto(readings, sensors - place, at, height, reach)
    return readings


def _noise(n: int, t: int, rng: np.random.Generator) -> Readings:
    return rng.standard_normal((t, n), np.float32) * np.float32(_NOISE)


def _noisy(n: int, t: int, rng: np.random.Generator, **contacts: Any) -> Readings:
    return touched(n, t, rng, **contacts) + _noise(n, t, rng)


def _drifting(n: int, t: int, rng: np.random.Generator) -> Readings:
    slow = np.sin(np.linspace(0, 3, t)[:, None] + rng.uniform(0, 6, n)) * rng.uniform(0, 0.5, n)
    return _noisy(n, t, rng) + slow.astype(np.float32)


def _components(n: int, t: int, rng: np.random.Generator) -> Readings:
    sizes = [len(part) for part in np.array_split(np.arange(n), _PARTS)]
    return np.hstack([touched(size, t, rng) for size in sizes]) + _noise(n, t, rng)


def _incomplete(n: int, t: int, rng: np.random.Generator) -> Readings:
    readings = _noisy(n, t, rng)
    readings[rng.uniform(size=readings.shape) < _MISSING] = np.nan
    return Recording(readings).complete("interpolate").readings.astype(np.float32)


def _ramps(n: int, t: int, rng: np.random.Generator) -> Readings:
    return np.outer(np.arange(t), rng.uniform(0.1, 1, n)).astype(np.float32) + _noisy(n, t, rng)


MEMBERS: Mapping[str, Callable[[int, int, np.random.Generator], Readings]] = {
    "noise in every reading": _noisy,
    "8 bits, exact rest": lambda n, t, rng: np.round(255 / 1.5 * touched(n, t, rng)),
    "binary": lambda n, t, rng: (touched(n, t, rng) > 0).astype(np.float32),
    "100,000 levels": lambda n, t, rng: np.round(1e5 * _noisy(n, t, rng)),
    "wide contacts": partial(_noisy, radius=_WIDE),
    "rare contacts": lambda n, t, rng: _noisy(n, t, rng, contacts=max(20, n // 2)),
    "drifting rest": _drifting,
    "eight skins": _components,
    "30 % missing, interpolated": _incomplete,
    "every sensor twice": lambda n, t, rng: np.repeat(_noisy(-(-n // 2), t, rng), 2, axis=1)[:, :n],
    "pure noise": _noise,
    "ramps": _ramps,
}
"""Function of each member: takes numbers of sensors and frames and a generator, returns (T, N)."""


def draw(name: str, n_sensors: int, n_frames: int, seed: int) -> Recording:
    """Draw a member of the family."""
    rng = np.random.default_rng([seed, list(MEMBERS).index(name), n_sensors, n_frames])
    return Recording(MEMBERS[name](n_sensors, n_frames, rng))
