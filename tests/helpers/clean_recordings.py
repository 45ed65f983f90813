"""Recordings of sound skins, from few sensors and frames to many, in which nothing is faulty.

Contacts are round. Whatever a check finds here is a false alarm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product, starmap
from typing import NamedTuple

import numpy as np
from benchmarks.skins.inputs import directions, sphere, sphere_radius
from numpy.typing import NDArray

from anisomap import Recording

Floats = NDArray[np.float64]

_RADIUS = 1.8  # of contacts, in spacings
_FRAMES_PER_STROKE = 25
_N_PRESSES = 12


def _plane(n: int, _: np.random.Generator) -> Floats:
    side = round(n**0.5)
    return np.array([[x, y, 0.0] for x, y in product(range(side), repeat=2)])


BODIES: Mapping[str, Callable[[int, np.random.Generator], Floats]] = {
    "sphere": lambda n, rng: sphere(n, rng) * sphere_radius(n),
    "plane": _plane,
    "scattered": lambda n, rng: directions(n, rng) * sphere_radius(n),
}
"""Positions of n sensors, (n, 3), in spacings."""


def _jumps(places: Floats, t: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return contacts that last a frame: their centres (t, 3), and their forces (t,)."""
    at = places[rng.integers(len(places), size=t)]
    return at + rng.normal(0, 0.3, at.shape), rng.uniform(0.7, 1.3, t)


def _strokes(places: Floats, t: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    n = max(3, t // _FRAMES_PER_STROKE)
    ends = places[rng.integers(len(places), size=n + 1)]
    along = np.linspace(0, n, t, endpoint=False)
    share, first = (along % 1)[:, None], along.astype(int)
    force = 0.3 + 1.7 / (1 + np.exp(-np.cumsum(rng.normal(0, 0.2, t))))
    return ends[first] * (1 - share) + ends[first + 1] * share, force


def _presses(places: Floats, t: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return contacts that an indenter makes: equally long, one place after the other."""
    frames = max(5, t // _N_PRESSES)
    at = places[rng.integers(len(places), size=-(-t // frames))]
    return np.repeat(at, frames, axis=0)[:t], np.sin(np.pi * (np.arange(t) % frames) / frames)


def _one_place(places: Floats, t: int, rng: np.random.Generator) -> tuple[Floats, Floats]:
    at = places[rng.integers(len(places))]
    force = np.convolve(rng.uniform(-1, 2, t), np.ones(5) / 5, mode="same")
    return np.tile(at, (t, 1)), np.maximum(force, 0)


COURSES: Mapping[str, Callable[[Floats, int, np.random.Generator], tuple[Floats, Floats]]] = {
    "jumps": _jumps,
    "strokes": _strokes,
    "presses": _presses,
    "one place": _one_place,
}


def _gained(x: Floats, rng: np.random.Generator) -> Floats:
    """Give sensors different gains and values at rest."""
    n = x.shape[1]
    return x * rng.lognormal(0, 0.3, n) + rng.normal(0, 0.01, x.shape) + rng.uniform(0, 5, n)


FORMS: Mapping[str, Callable[[Floats, np.random.Generator], Floats]] = {
    "exact": lambda x, _: x,
    "noise of 1 %": lambda x, rng: x + rng.normal(0, 0.01, x.shape),
    "noise of 10 %": lambda x, rng: x + rng.normal(0, 0.1, x.shape),
    "8 bits": lambda x, _: np.round(x * 255),
    "integers with noise": lambda x, rng: np.round(100 * x + rng.normal(200, 1, x.shape)),
    "binary": lambda x, _: np.asarray(x > 0.3, dtype=np.float64),
    "gains, noise of 1 %": _gained,
}


class Case(NamedTuple):
    """A kind of clean recording; `draw` makes one."""

    body: str
    course: str
    form: str
    n_sensors: int
    n_frames: int

    def draw(self, seed: int) -> Recording:
        """Draw a recording of this kind."""
        rng = np.random.default_rng([seed, *"".join(map(str, self)).encode()])
        places = BODIES[self.body](self.n_sensors, rng)
        centres, force = COURSES[self.course](places, self.n_frames, rng)
        apart = np.linalg.norm(places - centres[:, None], axis=2) / _RADIUS
        readings = np.maximum(force[:, None] - apart**2, 0)
        return Recording(FORMS[self.form](readings, rng).astype(np.float32), positions=places)


def cases(
    sizes: Sequence[int] = (20, 60, 200), frames: Sequence[int] = (30, 100, 300, 1000)
) -> Iterator[Case]:
    """Yield all cases."""
    return starmap(Case, product(BODIES, COURSES, FORMS, sizes, frames))


TRUE_OF_CLEAN = frozenset({"separate-regions", "one-period"})
"""Findings about the contacts, not about the read-out, that may be true of a clean recording."""
