"""A simulator of skins that shares no code with `anisomap.simulation`.

Contacts are soft balls on the surface of a body; lengths are in spacings of neighbouring sensors. A
`Case` names body, stimulation, transducer and damage, such as ``poke:reach=2``; parameters that are
not given, or 0, are drawn. Each is drawn by a generator of its own: a case with a damage is the
recording of the case without one, damaged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import astuple, dataclass, replace
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from scipy.signal import lfilter
from scipy.spatial import KDTree

from anisomap import Recording
from benchmarks.skins.readout import DAMAGES, TRANSDUCERS, Floats, Ints, Rng

CLOUD = 40
"""Points on the surface for each sensor, at which contacts can be."""


@dataclass(frozen=True)
class Case:
    """What `make` simulates: names of bodies, `STIMULATIONS`, `TRANSDUCERS` and `DAMAGES`."""

    body: str
    stimulation: str
    transducer: str = "linear"
    damage: str = ""
    n_frames: int = 2000
    seed: int = 0

    def __str__(self) -> str:
        return ", ".join(filter(None, astuple(self)[:4])) + f", {self.n_frames} frames"


class Skin:
    """Places (N, 3) of sensors and normals there, and places (M, 3) on the surface and normals."""

    def __init__(self, at: Floats, normals: Floats, surface: Floats, upright: Floats) -> None:
        self.at, self.normals, self.surface, self.upright = at, normals, surface, upright
        self.middle = at.mean(axis=0)
        self.axes = np.linalg.svd(at - self.middle, full_matrices=False)[2]  # the longest first
        self._tree = KDTree(surface)

    def nearest(self, points: Floats) -> Any:
        """Return the indices of the places on the surface that are nearest to points."""
        return self._tree.query(points)[1]


def _grid(columns: int, rows: int, spacing: float = 1.0) -> Floats:
    x, y = np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij")
    return np.array(spacing * np.column_stack([x.ravel(), y.ravel()]))


def _plate(n: int, hole: float = 0.0) -> Floats:
    side = round(n**0.5)
    points = _grid(side, side)
    return np.asarray(points[np.linalg.norm(points - (side - 1) / 2, axis=1) >= hole * side])


def _hexagonal_plate(n: int) -> Floats:
    reach = max(2, round((n / 3) ** 0.5))
    u, v = (_grid(2 * reach + 1, 2 * reach + 1) - reach).T
    inside = np.abs(u + v) <= reach
    return np.column_stack([u[inside] + v[inside] / 2, v[inside] * 0.75**0.5])


def _two_densities(n: int) -> Floats:
    side = max(3, round((n / 5) ** 0.5))
    shifted = _grid(2 * side, 2 * side, 0.5) + np.array([side - 0.25, -0.25])
    return np.concatenate([_grid(side, side), shifted])


def _irregular(n: int) -> Floats:
    drawn = np.random.default_rng(n).uniform(0, n**0.5, (6 * n, 2))
    return drawn[_spread(drawn, n)]


def _l_shape(n: int) -> Floats:
    side = round((4 / 3 * n) ** 0.5)
    points = _grid(side, side)
    return np.asarray(points[(points < side / 2).any(axis=1)])


def _strip(n: int, rows: float = 0) -> Floats:
    wide = int(rows) or 3 + n % 3
    return _grid(min(36, max(12, n // wide)), wide)


def _triangles(n: int) -> Floats:
    """Place tiles of ten pads in rows; every second tile is turned by 180 degrees."""
    pads = np.array([(i + j / 2, j * 0.75**0.5) for j in range(4) for i in range(4 - j)])
    pads -= pads.mean(axis=0)
    points, across = [], max(2, round((n / 5) ** 0.5))
    for tile in range(max(3, round(n / 10))):
        row, column = divmod(tile, across)
        up = (-1) ** (row + column)
        points.append(up * pads + [2 * column, 4 * 0.75**0.5 * (row - up / 6)])
    return np.concatenate(points)


def _wrapped(n: int) -> Floats:
    """Place a strip that is wrapped around three quarters of a tube, as if it were rolled out."""
    return _grid(max(12, n // 4), 4)


def _flat_hand(_: int) -> Floats:
    fingers = [_grid(1, y) + np.array([x, 6]) for x, y in ((0, 4), (2, 5), (4, 5), (6, 4))]
    return np.concatenate([_grid(7, 6), *fingers, _grid(4, 1) + np.array([7, 1])])


FLAT: Mapping[str, Callable[..., Floats]] = {
    "plate": _plate, "holed-plate": partial(_plate, hole=0.22), "hexagonal-plate": _hexagonal_plate,
    "two-densities": _two_densities, "irregular": _irregular, "l-shape": _l_shape,
    "strip": _strip, "triangles": _triangles, "flat-hand": _flat_hand, "wrapped-strip": _wrapped,
}  # fmt: skip
"""Functions of the number of sensors, which is about met, that return places (N, 2)."""


def _ellipsoid(p: Floats, axes: tuple[float, float, float]) -> Floats:
    inner = np.linalg.norm(p / axes, axis=1)
    return np.asarray(inner * (inner - 1) / np.linalg.norm(p / np.square(axes), axis=1))


def _capsule(p: Floats, start: Any, end: Any, radius: float = 1.0) -> Floats:
    along = np.subtract(end, start)
    share = np.clip((p - start) @ along / (along @ along), 0, 1)
    return np.asarray(np.linalg.norm(p - start - share[:, None] * along, axis=1) - radius)


def _height(p: Floats, x: float, y: float) -> Floats:
    """Distance from a paraboloid whose height is ``x x^2 + y y^2``: a dome, a bowl or a saddle."""
    steepness = np.linalg.norm(p[:, :2] * [2 * x, 2 * y], axis=1)
    return np.asarray((p[:, 2] - np.square(p[:, :2]) @ [x, y]) / np.hypot(1, steepness))


def _tube(p: Floats, patches: int = 0) -> Floats:
    """Distance from a cylinder along z, or from a ring of patches; far away in the gaps."""
    share = np.arctan2(p[:, 1], p[:, 0]) / (2 * np.pi) * patches % 1
    return np.hypot(p[:, 0], p[:, 1]) - np.where(share <= 0.75, 1.0, -9.0)


def _hand(p: Floats) -> Floats:
    """Distance from a palm 2 wide and .5 thick, four fingers and a thumb."""
    palm = np.linalg.norm(np.maximum(np.abs(p) - [0.8, 0.8, 0.05], 0), axis=1) - 0.2
    ends = zip((-0.78, -0.26, 0.26, 0.78), (2.0, 2.4, 2.5, 2.2), strict=True)
    parts = [_capsule(p, (x, 0.8, 0), (1.25 * x, y, -0.25), 0.2) for x, y in ends]
    return np.asarray(
        np.min([palm, *parts, _capsule(p, (0.8, -0.5, 0), (1.7, 0.4, -0.3), 0.22)], 0)
    )


SOLID: Mapping[str, tuple[Callable[[Floats], Floats], Any, Any]] = {
    "hemisphere": (partial(_ellipsoid, axes=(1, 1, 1)), (-1.1, -1.1, 0), 1.1),
    "sphere": (partial(_ellipsoid, axes=(1, 1, 1)), -1.1, 1.1),
    "dome": (partial(_ellipsoid, axes=(1, 0.7, 0.6)), (-1.1, -1.1, 0), 1.1),
    "shallow-dome": (partial(_height, x=-0.35, y=-0.35), -1, 1),
    "bowl": (partial(_height, x=0.8, y=0.8), -1, 1),
    "saddle": (partial(_height, x=0.6, y=-0.6), -1, 1),
    "torus": (lambda p: np.hypot(np.hypot(p[:, 0], p[:, 1]) - 1, p[:, 2]) - 0.4, -1.5, 1.5),
    "cylinder": (_tube, (-1.1, -1.1, -1.5), (1.1, 1.1, 1.5)),
    "ring": (partial(_tube, patches=6), (-1.1, -1.1, -0.4), (1.1, 1.1, 0.4)),
    "finger": (partial(_capsule, start=(0, 0, -9), end=(0, 0, 0)), (-1.1, -1.1, -2.5), 1.1),
    "two-fingers": (
        lambda p: np.minimum(*(_capsule(p, (0, 0, 0), (x, 0, 2), 0.3) for x in (-0.8, 0.8))),
        (-1.2, -0.4, -0.4), (1.2, 0.4, 2.4),
    ),
    "hand": (_hand, (-1.6, -1.1, -0.7), (2.1, 2.8, 0.4)),
    "glove": (_hand, (-1.6, -1.1, -0.7), (2.1, 2.8, 0.4)),
}  # fmt: skip
"""Distances from surfaces, and the bounds of a box; a glove has sensors where a hand faces up."""

RANDOM = "random-"
"""Before the name of a solid body: its sensors are at random places, not evenly spaced."""

BODIES = (*FLAT, *SOLID, *(RANDOM + name for name in ("hemisphere", "sphere", "cylinder")))


def find_body(rng: Rng, name: str, n: float = 0, jitter: float = 0.0, **others: float) -> Skin:
    """Return a body with about n sensors; jitter: Standard deviation of places on flat bodies."""
    n = int(n) or round(float(np.exp(rng.uniform(np.log(25), np.log(250)))))
    if name not in FLAT:
        solid = SOLID[name.removeprefix(RANDOM)]
        cloud = _surface(rng, *solid, CLOUD * n, upper=name == "glove")
        even = cloud[_spread(cloud[:, :3], n)]
        chosen = cloud[:n] if name.startswith(RANDOM) else even
        nearest = np.asarray(KDTree(even[:, :3]).query(even[:, :3], k=2)[0])
        scale = np.median(nearest[:, 1])
        at, surface = chosen[:, :3] / scale, cloud[:, :3] / scale
        return Skin(*_in_order_of_wires(at, chosen[:, 3:]), surface, cloud[:, 3:])
    places = FLAT[name](n, **others)
    at = np.pad(places + jitter * rng.normal(size=places.shape), ((0, 0), (0, 1)))
    surface = np.repeat(at, CLOUD, axis=0) + rng.uniform(-0.5, 0.5, (CLOUD * len(at), 3)) * [
        1,
        1,
        0,
    ]
    up = np.array([0.0, 0.0, 1.0])
    normals, upright = np.tile(up, (len(at), 1)), np.tile(up, (len(surface), 1))
    if name == "wrapped-strip":
        radius = float(np.ptp(at[:, 0])) / (1.5 * np.pi)
        (at, normals), (surface, upright) = _wrap(at, radius), _wrap(surface, radius)
    return Skin(*_in_order_of_wires(at, normals), surface, upright)


def _wrap(at: Floats, radius: float) -> tuple[Floats, Floats]:
    """Wrap flat places around a tube of a radius along y; return places and normals."""
    angle = at[:, 0] / radius - 0.75 * np.pi
    normals = np.stack([np.sin(angle), np.zeros(len(at)), np.cos(angle)], axis=1)
    return radius * normals + at * [0, 1, 0], normals


def _layout(skin: Skin, body: str) -> Floats:
    """Return the true positions of sensors, 2D for flat skins."""
    if body == "wrapped-strip":
        x, y, z = skin.at.T
        return np.column_stack([np.arctan2(x, z) * np.hypot(x, z), y])
    return skin.at[:, :2] if body in FLAT else skin.at


def _surface(
    rng: Rng, distance: Callable[[Floats], Floats], low: Any, high: Any, n: int, *, upper: bool
) -> Floats:
    """Draw n places on a surface, evenly, beside normals: shape (n, 6)."""
    steps, found = 1e-4 * np.eye(3), np.empty((0, 6))

    def slopes(p: Floats) -> Floats:
        return np.stack([(distance(p + s) - distance(p - s)) / 2e-4 for s in steps], axis=1)

    while len(found) < n:
        p = rng.uniform(np.broadcast_to(low, 3), high, (20_000, 3))
        p = p[np.abs(distance(p)) < 0.08]
        for _ in range(4):
            slope = slopes(p)
            p = p - slope * (distance(p) / (slope**2).sum(axis=1))[:, None]
        up = slopes(p)
        up /= np.linalg.norm(up, axis=1, keepdims=True)
        inside = ((p >= low) & (p <= high)).all(axis=1) & ((up[:, 2] > 0.05) | (not upper))
        found = np.concatenate([found, np.hstack([p, up])[inside]])
    return found[:n]


def _spread(points: Floats, n: int) -> Ints:
    """Return the indices of n points, each the farthest from those before it."""
    chosen, apart = [0], np.full(len(points), np.inf)
    while len(chosen) < n:
        apart = np.minimum(apart, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(apart.argmax()))
    return np.array(chosen)


def _in_order_of_wires(at: Floats, normals: Floats) -> tuple[Floats, Floats]:
    """Order sensors by halves, halves of halves, and so on: neighbouring channels lie together."""
    if len(at) > 3:
        order = np.argsort(at[:, np.ptp(at, axis=0).argmax()], kind="stable")
        parts = [_in_order_of_wires(at[h], normals[h]) for h in np.array_split(order, 2)]
        at, normals = (np.concatenate(both) for both in zip(*parts, strict=True))
    return at, normals


@dataclass(frozen=True, eq=False)
class Touch:
    """One contact in each frame: index of its place (T,), depth (T,), and its footprint.

    A sensor at the distance d from the place reads depth - (d / reach)^2, if that is positive;
    stretch: Length over width of the footprint, along an axis of the body, by default the second.
    """

    at: Ints
    depth: Floats
    reach: float
    stretch: float = 1.0
    axis: int = 1

    def onto(self, skin: Skin) -> Floats:
        """Return the loads of all sensors, shape (T, N)."""
        loads = np.zeros((len(self.at), len(skin.at)))
        for active in np.array_split(np.flatnonzero(self.depth), len(self.at) // 500 + 1):
            offsets = skin.at - skin.surface[self.at[active], None]
            along = (1 - self.stretch**-2) * (offsets @ skin.axes[self.axis]) ** 2
            load = self.depth[active, None] - ((offsets**2).sum(axis=2) - along) / self.reach**2
            seen = skin.upright[self.at[active]] @ skin.normals.T > 0
            loads[active] = np.maximum(load, 0) * seen
        return loads


Touches: TypeAlias = list[Touch]


def _events(
    t: int, rng: Rng, frames: tuple[int, int], pauses: tuple[int, int]
) -> Iterator[tuple[slice, Floats]]:
    """Yield frames of contacts, and how deep each presses in them."""
    start = int(rng.integers(pauses[0], pauses[1] + 1))
    while start < t:
        length = int(rng.integers(frames[0], frames[1] + 1))
        part = slice(start, min(start + length, t))
        course = np.sin(np.pi * (np.arange(part.stop - start) + 0.5) / length) ** 0.7
        yield part, rng.uniform(0.5, 1.2) * course
        start = part.stop + int(rng.integers(pauses[0], pauses[1] + 1))


def _poke(
    skin: Skin, t: int, rng: Rng, *, reach: float = 0, uneven: float = 0,
    frames: tuple[int, int] = (3, 10), pauses: tuple[int, int] = (0, 6),
) -> Touches:  # fmt: skip
    apart = np.linalg.norm(skin.surface - rng.choice(skin.surface), axis=1)
    chances = np.exp(-uneven * apart / apart.max()) + 0.02
    at, depth = np.zeros(t, int), np.zeros(t)
    for part, course in _events(t, rng, frames, pauses):
        at[part], depth[part] = rng.choice(len(apart), p=chances / chances.sum()), course
    return [Touch(at, depth, reach or rng.uniform(1.5, 2.8))]


def _few(skin: Skin, t: int, rng: Rng, *, contacts: float = 0) -> Touches:
    each = max(4, t // int(contacts or rng.integers(25, 101)))
    return _poke(skin, t, rng, frames=(each // 2, each // 2), pauses=(0, each))


def _rain(skin: Skin, t: int, rng: Rng, *, drops: float = 4, reach: float = 1.5) -> Touches:
    at = rng.integers(len(skin.surface), size=(int(drops), t))
    depth = rng.uniform(0.4, 1.2, at.shape) * (rng.random(at.shape) < 0.75)
    return [Touch(*both, reach) for both in zip(at, depth, strict=True)]


def _multi(skin: Skin, t: int, rng: Rng, *, reach: float = 0) -> Touches:
    reach = reach or rng.uniform(1.5, 2.8)
    every = ((0, 6), (5, 25), (5, 25))
    return [_poke(skin, t, rng, reach=reach, pauses=pauses)[0] for pauses in every]


def _stroke(
    skin: Skin, t: int, rng: Rng, *, reach: float = 0, bristles: float = 1, line: bool = False
) -> Touches:
    """Slide a contact, or several that move together, or roll a line contact, over the skin."""
    bristles = int(bristles)
    at, depth = np.zeros((bristles, t), int), np.zeros(t)
    for part, course in _events(t, rng, (15, 40), (0, 6)):
        depth[part] = course
        speed, side, offsets = rng.uniform(0.2, 0.6), rng.choice([-9, 9]), np.zeros((bristles, 3))
        offsets[1:] = rng.normal(0, 1.5, (bristles - 1, 3))
        here, target = rng.integers(len(skin.surface), size=2)
        for frame in range(part.start, part.stop):
            normal = skin.upright[here]
            heading = skin.surface[target] - skin.surface[here]
            heading = side * np.cross(normal, skin.axes[1]) if line else heading
            heading = heading - (heading @ normal) * normal
            step = heading * (speed / max(speed, float(np.linalg.norm(heading))))
            at[:, frame] = skin.nearest(skin.surface[here] + step + offsets)
            here = at[0, frame]
    reach, stretch = reach or rng.uniform(1.5, 2.5), rng.uniform(2.5, 3) if line else 1.0
    return [Touch(one, depth, reach, stretch) for one in at]


def _rolling_pin(skin: Skin, t: int, rng: Rng) -> Touches:
    """Roll a long line contact along one axis of the body, then along the other."""
    found = []
    for axis, half in ((1, np.arange(t) < t // 2), (0, np.arange(t) >= t // 2)):
        one = _stroke(skin, t, rng, line=True)[0]
        found.append(replace(one, depth=one.depth * half, stretch=6.0, axis=axis))
    return found


def _sway(skin: Skin, t: int, rng: Rng) -> Touches:
    """Let a wide load that never leaves the skin drift for minutes, as a person who stands."""
    drift = lfilter([1], [1, -0.997], rng.normal(size=(2 * t, 2)), axis=0)[t:]
    drift *= 0.2 * np.ptp((skin.at - skin.middle) @ skin.axes[:2].T, axis=0) / drift.std(axis=0)
    reach = 0.7 * float(np.ptp((skin.at - skin.middle) @ skin.axes[0]))
    return [Touch(skin.nearest(skin.middle + drift @ skin.axes[:2]), np.ones(t), reach)]


def _footsteps(skin: Skin, t: int, rng: Rng) -> Touches:
    """Move a wide load from heel to toe."""
    at, depth = np.zeros(t, int), np.zeros(t)
    along = (skin.at - skin.middle) @ skin.axes[0]
    for part, course in _events(t, rng, (25, 40), (10, 15)):
        share = np.linspace(along.min(), along.max(), len(course))[:, None]
        sway = rng.normal(0, 1.5) * skin.axes[1]
        at[part], depth[part] = skin.nearest(skin.middle + share * skin.axes[0] + sway), course
    return [Touch(at, depth, 0.3 * float(np.ptp(along)))]


def _self_contact(skin: Skin, t: int, rng: Rng) -> Touches:
    """Touch two places at once, each the mirror image of the other."""
    first, places = _poke(skin, t, rng)[0], skin.surface - skin.middle
    mirrored = places - 2 * np.outer(places @ skin.axes[0], skin.axes[0]) + skin.middle
    return [first, replace(first, at=skin.nearest(mirrored)[first.at])]


def _grasp(skin: Skin, t: int, rng: Rng) -> Touches:
    """Take 6 to 14 postures of 2 to 5 contacts, slightly varied."""
    postures = [
        rng.integers(len(skin.surface), size=k) for k in rng.integers(2, 6, rng.integers(6, 15))
    ]
    at, depth = np.zeros((5, t), int), np.zeros((5, t))
    for part, course in _events(t, rng, (10, 25), (2, 8)):
        for finger, place in enumerate(postures[rng.integers(len(postures))]):
            at[finger, part] = skin.nearest(skin.surface[place] + rng.normal(0, 0.4, 3))
            depth[finger, part] = rng.uniform(0.6, 1.2) * course
    reach = rng.uniform(1.8, 3)
    return [Touch(*both, reach) for both in zip(at, depth, strict=True)]


def _hold(skin: Skin, t: int, rng: Rng, *, frames: float = 250) -> Touches:
    """Rest a hand in one place after another, where it shifts its weight a little."""
    at, depth = np.zeros(t, int), np.zeros(t)
    for part, course in _events(t, rng, (int(frames), int(frames)), (0, 10)):
        place, length = skin.surface[rng.integers(len(skin.surface))], len(course)
        sway = np.cumsum(rng.normal(0, 0.05, (length, 3)), axis=0)
        at[part] = skin.nearest(place + sway)
        depth[part] = course * (1 + 0.3 * np.sin(np.arange(length) * rng.uniform(0.05, 0.3)))
    return [Touch(at, depth, rng.uniform(3, 5))]


def _jumps(skin: Skin, t: int, rng: Rng, *, reach: float = 2) -> Touches:
    """Touch another place in each frame."""
    return [Touch(rng.integers(len(skin.surface), size=t), rng.gamma(6, 1 / 6, t), reach)]


STIMULATIONS: Mapping[str, Callable[..., Touches]] = {
    "poke": _poke,
    "stroke": _stroke,
    "palm": lambda skin, t, rng: _poke(skin, t, rng, reach=rng.uniform(3, 5)),
    "grasp": _grasp,
    "rolling": partial(_stroke, line=True),
    "footsteps": _footsteps,
    "self-contact": _self_contact,
    "brush": partial(_stroke, bristles=12, reach=1.3),
    "three-tips": partial(_stroke, bristles=3),
    "rolling-pin": _rolling_pin,
    "taps": partial(_poke, frames=(2, 4), pauses=(3, 12)),
    "two-hands": lambda skin, t, rng: [
        _poke(skin, t, rng, reach=rng.uniform(3, 5), pauses=pauses)[0]
        for pauses in ((0, 6), (5, 25))
    ],
    "slow-press": partial(_poke, frames=(40, 90), pauses=(5, 20)),
    "sway": _sway,
    "rain": _rain,
    "few": _few,
    "multi": _multi,
    "uneven": partial(_poke, uneven=8.0),
    "jumps": _jumps,
    "hold": _hold,
}
"""Functions of a skin, a number of frames, a generator, and parameters."""


def make(case: Case) -> Recording:
    """Simulate a case.

    Positions are true, 2D for flat skins: where wires are exchanged all the time, they are those of
    the sensors on the wires, and those of the case without damage are what a layout would state.
    """
    rngs = np.random.default_rng([case.seed, *case.body.encode()]).spawn(4)
    body, given = _parsed(case.body)
    skin = find_body(rngs[0], body, **given)
    parts, (touch, given) = [(skin, case.n_frames)], _parsed(case.stimulation)
    if case.damage == "posture":
        half = case.n_frames // 2
        parts = [(skin, half), (_bent(skin), case.n_frames - half)]
    touches = ((one, STIMULATIONS[touch](one, t, rngs[1], **given)) for one, t in parts)
    loads = np.concatenate([np.max([c.onto(one) for c in all_], axis=0) for one, all_ in touches])
    loads /= np.quantile(loads[loads > 0], 0.9)
    transducer, given = _parsed(case.transducer)
    sound = Recording(
        TRANSDUCERS[transducer](loads, rngs[2], skin.at, **given).astype(np.float32),
        positions=_layout(skin, body),
        units="spacings",
        source=str(case),
        metadata={"seed": case.seed, "faulty": ""},
    )
    return damaged(sound, case.damage, rngs[3]) if case.damage else sound


def damaged(recording: Recording, damage: str, rng: Rng) -> Recording:
    """Damage a recording, as named in `DAMAGES`; the metadata name the sensors at fault."""
    name, given = _parsed(damage)
    found = DAMAGES[name](recording.readings.astype(np.float64), rng, **given)
    positions = recording.positions
    if positions is not None and found.wires is not None:
        positions = positions[found.wires]
    return Recording(
        found.readings.astype(np.float32),
        recording.names,
        positions=positions,
        units=recording.units,
        source=f"{recording.source}, {damage}",
        metadata={"faulty": ",".join(recording.names[i] for i in found.faulty)},
    )


def _parsed(text: str) -> tuple[str, dict[str, float]]:
    """Return the name and the parameters in a text such as ``name:parameter=2``."""
    name, _, rest = text.partition(":")
    pairs = (pair.split("=") for pair in rest.split(",") if pair)
    return name, {key: float(value) for key, value in pairs}


def _bent(skin: Skin) -> Skin:
    """Return the skin with one half turned by 100 degrees about its middle."""
    along, across, _ = skin.axes
    up, angle = np.cross(along, across), np.deg2rad(100)
    turned = np.stack([np.cos(angle) * along + np.sin(angle) * up, across,
                       np.cos(angle) * up - np.sin(angle) * along])  # fmt: skip
    turn = np.stack([along, across, up]).T @ turned
    halves = ((at - skin.middle) @ along > 0 for at in (skin.at, skin.surface))
    here, there = (half[:, None] for half in halves)

    def moved(at: Floats, half: Any) -> Floats:
        return np.where(half, (at - skin.middle) @ turn + skin.middle, at)

    return Skin(
        moved(skin.at, here), np.where(here, skin.normals @ turn, skin.normals),
        moved(skin.surface, there), np.where(there, skin.upright @ turn, skin.upright),
    )  # fmt: skip


def drawn(seed: int, *, body: str = "", damage: str = "", longest: int = 20_000) -> Case:
    """Draw a case of 500 frames or more."""
    rng = np.random.default_rng([seed, *body.encode()])
    body = body or str(rng.choice(BODIES))
    touches = {*STIMULATIONS} - {"jumps", "hold"}
    if body not in FLAT and body not in ("hemisphere", "dome", "shallow-dome", "glove"):
        touches -= {"footsteps", "sway"}  # which load one side
    n_frames = int(np.exp(rng.uniform(np.log(500), np.log(longest))))
    transducer = str(rng.choice([*TRANSDUCERS, "white:level=0.3"]))
    return Case(body, str(rng.choice(sorted(touches))), transducer, damage, n_frames, seed)
