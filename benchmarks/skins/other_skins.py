"""A second simulator, for verdicts on skins that the package's own does not make.

Contacts are balls of many sizes and profiles that are pressed smoothly, one after the other or at
once, or swept along the skin. A seed draws the surface, the number and spacing of sensors, the way
of touching, noise, quantisation and, in 3 of 10 recordings, a fault.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

import anisomap
from anisomap.evaluation import median_spacing
from benchmarks.skins.inputs import Press, sphere
from benchmarks.verdicts.trust_recordings import Case

Floats = NDArray[np.float64]

TOUCHES = ("round", "round", "growing", "long", "several", "mirrored", "swept")
"""Ways of touching; in mirrored ones each contact comes with its mirror image."""

FAULTY = 0.3
"""Share of the recordings with a fault."""

MOST_FRAMES = 12_000


def lattice(n: int, rng: np.random.Generator, jitter: float = 0.0) -> Floats:
    """Place sensors on a flat triangular lattice, or beside it."""
    width = int(np.sqrt(n * rng.uniform(0.6, 1.6)))
    x, y = np.meshgrid(np.arange(width), np.arange(max(3, n // width)))
    places = np.column_stack([(x + 0.5 * (y % 2)).ravel(), 0.866 * y.ravel(), np.zeros(x.size)])
    places[:, :2] += rng.uniform(-jitter, jitter, (len(places), 2))
    return places


def cylinder(n: int, rng: np.random.Generator, angle: float = 2 * np.pi) -> Floats:
    """Place sensors on an open cylinder, or on a part of it."""
    length = rng.uniform(2, 5)
    columns = max(4, int(np.sqrt(n * angle / length)))
    rows = max(3, n // columns)
    u, v = np.meshgrid(np.arange(columns), np.arange(rows))
    turn = ((u + 0.5 * (v % 2)) * angle / columns).ravel()
    return np.column_stack([np.cos(turn), np.sin(turn), v.ravel() * length / rows])


def torus(n: int, rng: np.random.Generator) -> Floats:
    """Place sensors on a torus."""
    radius = rng.uniform(2, 3)
    around = max(5, int(np.sqrt(n / radius)))
    along = max(8, n // around)
    u, v = np.meshgrid(np.arange(along), np.arange(around))
    turn = ((u + 0.5 * (v % 2)) * 2 * np.pi / along).ravel()
    tilt = (v * 2 * np.pi / around).ravel()
    out = radius + np.cos(tilt)
    return np.column_stack([out * np.cos(turn), out * np.sin(turn), np.sin(tilt)])


def hand(_: int, rng: np.random.Generator) -> Floats:
    """Place sensors on a palm, four fingers and a thumb."""
    palm = [(x, y, 0.0) for x in range(7) for y in range(7)]
    fingers = [
        (1.75 * f + 0.75 * x, y, 0.25 * np.sin(y - 7))
        for f in range(4)
        for y in range(7, 13)
        for x in (0, 1)
    ]
    thumb = [(7.5 + 0.7 * k - 0.2 * s, 2 + 0.6 * k + s, 0.0) for k in range(6) for s in (0, 1)]
    places = np.array([*palm, *fingers, *thumb])
    return places + rng.uniform(-0.1, 0.1, places.shape)


def saddle(n: int, rng: np.random.Generator) -> Floats:
    """Place sensors on a saddle."""
    ends = np.linspace(-1, 1, int(np.sqrt(n)))
    x, y = (one.ravel() for one in np.meshgrid(ends, ends))
    return np.column_stack([x, y, rng.uniform(0.3, 0.7) * (x**2 - y**2)])


SURFACES: dict[str, Callable[[int, np.random.Generator], Floats]] = {
    "sphere": sphere,
    "uneven-sphere": partial(sphere, power=1.5),
    "plane": partial(lattice, jitter=0.25),
    "lattice": lattice,
    "cylinder": cylinder,
    "half-cylinder": partial(cylinder, angle=np.pi),
    "torus": torus,
    "hand": hand,
    "saddle": saddle,
}
FLAT = ("plane", "lattice")


def touched(places: Floats, touch: str, flat: bool, rng: np.random.Generator) -> Floats:
    """Simulate the readings of sensors at places, shape (N, 3), without noise."""
    n_sensors, spacing = len(places), median_spacing(places)
    radius = spacing * rng.uniform(1.4, 3.5)
    growth = rng.uniform(1.1, 2.2) if touch == "growing" else 1.0
    press = Press(
        int(rng.integers(3, 15)),
        rng.uniform(1.1, 2.5) if touch == "long" else 1.0,
        int(rng.integers(3)),
    )
    near = np.linalg.norm(places[:, None] - places[None], axis=2) < radius
    per_sensor = np.exp(rng.uniform(np.log(4), np.log(60)))
    n_contacts = max(8, int(per_sensor * n_sensors / near.sum(axis=1).mean()))
    at_once = {"several": 2.5, "mirrored": 1.0}.get(touch, float(rng.choice([0.6, 1.0, 1.6])))
    n_frames = int(min(MOST_FRAMES, max(120, n_contacts * 2 * press.width / at_once)))
    readings = np.zeros((n_frames, n_sensors))
    if touch == "swept":
        return swept(places, n_frames, radius, rng)
    along = places[:, 0] - places[:, 0].min()
    for _ in range(n_contacts):
        i = rng.integers(n_sensors)
        centre = places[i] + 0.5 * spacing * rng.normal(size=3) * [1, 1, 0 if flat else 1]
        size = radius * rng.uniform(0.75, 1.25) * (1 + (growth - 1) * along[i] / along.max())
        at, height = int(rng.uniform(0, n_frames)), rng.uniform(0.5, 1.5)
        press.onto(readings, places - centre, at, height, size)
        if touch == "mirrored":
            mirror = centre * [-1, 1, 1] + [places[:, 0].max() + places[:, 0].min(), 0, 0]
            press.onto(readings, places - mirror, at, height, size)
    return readings


def swept(places: Floats, n_frames: int, radius: float, rng: np.random.Generator) -> Floats:
    """Move one contact from sensor to neighbouring sensor, and sometimes elsewhere."""
    spacing = median_spacing(places)
    apart = np.linalg.norm(places[:, None] - places[None], axis=2)
    neighbours = np.argsort(apart, axis=1, kind="stable")[:, 1:7]
    place, target = places[rng.integers(len(places))].copy(), int(rng.integers(len(places)))
    speed, offset = spacing * rng.uniform(0.1, 0.5), 0.3 * spacing * rng.uniform(-1, 1, 3)
    readings = np.empty((n_frames, len(places)))
    for frame in range(n_frames):
        step = places[target] - place
        if (length := float(np.linalg.norm(step))) < speed:
            place = places[target].copy()
            stays = rng.random() < 0.97
            target = int(rng.choice(neighbours[target]) if stays else rng.integers(len(places)))
        else:
            place += step * (speed / length)
        away = np.linalg.norm(places - place - offset, axis=1) / radius
        readings[frame] = np.maximum(0, 1 - away**2) * (1 + 0.3 * np.sin(frame / 50))
        if rng.random() < 0.01:
            offset = 0.3 * spacing * rng.uniform(-1, 1, 3)
    return readings


def halfway(readings: Floats, rng: np.random.Generator) -> Floats:
    """Exchange the wires of 5 to 40 % of the sensors half-way."""
    n_frames, n_sensors = readings.shape
    some = rng.choice(n_sensors, max(4, int(n_sensors * rng.uniform(0.05, 0.4))), replace=False)
    found = readings.copy()
    found[n_frames // 2 :, some] = found[n_frames // 2 :, np.roll(some, 1)]
    return found


def common_walk(readings: Floats, rng: np.random.Generator) -> Floats:
    """Add a random walk to all sensors."""
    walk = np.cumsum(rng.normal(size=len(readings))) / np.sqrt(len(readings))
    return np.asarray(readings + walk[:, None] * readings.std() * rng.uniform(0.5, 3))


def hum(readings: Floats, rng: np.random.Generator) -> Floats:
    """Add a hum, of one phase or of random ones."""
    phases = rng.uniform(0, 2 * np.pi, readings.shape[1]) * (rng.random() < 0.5)
    course = np.arange(len(readings))[:, None] * rng.uniform(0.2, 2)
    return np.asarray(readings + np.sin(course + phases) * readings.std() * rng.uniform(0.3, 1.5))


def gains(readings: Floats, rng: np.random.Generator) -> Floats:
    """Give every sensor a gain of its own."""
    return np.asarray(readings * np.exp(0.5 * rng.normal(size=readings.shape[1])))


def silent(readings: Floats, rng: np.random.Generator) -> Floats:
    """Silence one of 20 sensors."""
    n_sensors = readings.shape[1]
    found = readings.copy()
    found[:, rng.choice(n_sensors, max(1, n_sensors // 20), replace=False)] = 0
    return found


def drift(readings: Floats, rng: np.random.Generator) -> Floats:
    """Let every sensor drift by itself."""
    slopes = rng.normal(size=readings.shape[1]) * readings.std() * rng.uniform(0.5, 3)
    return np.asarray(readings + np.linspace(0, 1, len(readings))[:, None] * slopes)


def drowned(readings: Floats, rng: np.random.Generator) -> Floats:
    """Add so much noise that little else is left."""
    noise = rng.uniform(1, 20) * readings.std() * rng.normal(size=readings.shape)
    return np.asarray(readings + noise)


FAULTS = {one.__name__: one for one in (halfway, common_walk, hum, gains, silent, drift, drowned)}


def cases_of_other(seed: int) -> list[Case]:
    """Return the recording of a seed, with its true positions."""
    rng = np.random.default_rng([seed, 2])
    surface = list(SURFACES)[seed % len(SURFACES)]
    places = SURFACES[surface](int(np.exp(rng.uniform(np.log(36), np.log(160)))), rng)
    touch, flat = TOUCHES[rng.integers(len(TOUCHES))], surface in FLAT
    readings = touched(places, touch, flat, rng)
    fault = str(rng.choice(list(FAULTS))) if rng.random() < FAULTY else ""
    if fault:
        readings = FAULTS[fault](readings, rng)
    readings = readings + rng.choice([0, 0.01, 0.01, 0.05]) * rng.normal(size=readings.shape)
    kind = rng.random()
    if kind < 0.12:
        readings = (readings > 0.15).astype(np.float64)
    elif kind < 0.25:
        readings = np.round(readings * 16) / 16
    recording = anisomap.Recording(readings.astype(np.float32), positions=places)
    name = f"other-{seed} {surface} {touch}, {len(readings)} frames"
    return [Case(name, recording, 2 if flat else 3, fault, kind=surface, group="other")]
