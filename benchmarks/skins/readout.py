"""What lies between skin and file in `benchmarks.skins.independent`: transducers and damages.

Loads are in units of the 90 % quantile of loads above 0; boards read 12 channels each.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter
from scipy.spatial.distance import cdist

Floats: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.intp]
Rng: TypeAlias = np.random.Generator

BOARD = 12

# Functions of loads (T, N), a generator, the places of sensors (N, 3), and parameters.


def _linear(x: Floats, rng: Rng, _: Any = None, gains: float = 0.2, noise: float = 0.01) -> Floats:
    n = x.shape[1]
    gained = x * np.maximum(1 + gains * rng.normal(size=n), 0.3) + rng.uniform(0, 0.5, n)
    return np.asarray(gained + noise * rng.normal(size=x.shape))


def _hysteresis(x: Floats, rng: Rng, _: Any, slower: float = 0) -> Floats:
    slower, felt = slower or rng.uniform(4, 6), x.copy()
    for before, after in pairwise(felt):
        after[:] = before + (after - before) / np.where(after > before, 1.5, 1.5 * slower)
    return _linear(felt, rng)


def _bits(x: Floats, rng: Rng, _: Any, bits: float = 8, sign: float = 1) -> Floats:
    levels, x = 2**bits - 1, sign * _linear(x, rng)
    return np.asarray(np.round((x - x.min()) / np.ptp(x) * levels))


def _pink(x: Floats, rng: Rng, _: Any, level: float = 0.1) -> Floats:
    spectrum = np.fft.rfft(rng.normal(size=x.shape), axis=0)
    noise = np.fft.irfft(spectrum / np.sqrt(np.arange(1, len(spectrum) + 1))[:, None], len(x), 0)
    return np.asarray(_linear(x, rng) + level * noise / noise.std())


def _hum(x: Floats, rng: Rng, _: Any, level: float = 0.08) -> Floats:
    phases = rng.uniform(0, 2 * np.pi, x.shape[1])
    course = rng.uniform(0.5, 1.5) * np.arange(len(x))[:, None]
    return np.asarray(_linear(x, rng) + level * 2**0.5 * np.sin(course + phases))


def _three_axes(x: Floats, rng: Rng, _: Any, noise: float = 0.03) -> Floats:
    shear = 0.3 * x * rng.normal(size=(2, *x.shape))
    return np.asarray(np.linalg.norm([x, *shear] + noise * rng.normal(size=(3, *x.shape)), axis=0))


TRANSDUCERS: Mapping[str, Callable[..., Floats]] = {
    "linear": _linear,
    "exact": lambda x, rng, _, gains=0.2: _linear(x, rng, gains=gains, noise=0) * (x > 0),
    "saturating": lambda x, rng, _, at=0.6: _linear(np.minimum(x, at), rng),
    "tanh": lambda x, rng, _: _linear(np.tanh(1.5 * x), rng),
    "logarithmic": lambda x, rng, _: _linear(np.log1p(20 * x) / 3, rng),
    "hysteresis": _hysteresis,
    "8-bits": _bits,
    "12-bits": lambda x, rng, _: _bits(x, rng, _, 12),
    "four-levels": lambda x, rng, _: _bits(x, rng, _, 2),
    "bouncing": lambda x, rng, _, share=0.1: _linear(x * (rng.random(x.shape) > share), rng),
    "inverted": lambda x, rng, _: _bits(x, rng, _, 8, -1),
    "drift": lambda x, rng, _, level=0.25: _linear(x, rng) + level * _walks(x.shape, rng),
    "white": lambda x, rng, _, level=0.1, gains=0.2: _linear(x, rng, _, gains, level),
    "pink": _pink,
    "hum": _hum,
    "crosstalk": lambda x, rng, at, share=0.15: _linear(x + share * x @ _beside(at), rng),
    "on-off": lambda x, rng, _, at=0.25: (x > at).astype(float),
    "ac-coupled": lambda x, rng, _, frames=10: np.asarray(
        lfilter([1, -1], [1, 1 / frames - 1], _linear(x, rng, gains=0.2), axis=0)
    ),
    "three-axes": _three_axes,
}


def _walks(shape: tuple[int, ...], rng: Rng) -> Floats:
    """Return random walks from 0 with a standard deviation of 1 at the end."""
    return np.asarray(np.cumsum(rng.normal(size=shape), axis=0) / shape[0] ** 0.5)


def _beside(places: Floats) -> Floats:
    apart = cdist(places, places)
    return ((apart > 0) & (apart < 1.3)).astype(float)


@dataclass(frozen=True, eq=False)
class Damaged:
    """Damaged readings; the sensors that are at fault, and the sensor on each wire all the time."""

    readings: Floats
    faulty: Any = ()
    wires: Ints | None = None


Damage = Callable[..., Damaged]


def _of_sensors(change: Callable[[Floats, Rng], Floats]) -> Damage:
    """Make a damage of some sensors from a change of the readings of one."""

    def damage(x: Floats, rng: Rng, share: float = 0.08) -> Damaged:
        x, n = x.copy(), x.shape[1]
        some = np.sort(rng.choice(n, max(1, round(share * n)), replace=False))
        for sensor in some:
            x[:, sensor] = change(x[:, sensor], rng)
        return Damaged(x, some)

    return damage


def _dropping(x: Floats, rng: Rng) -> Floats:
    """Hold a constant, such as the end of the range, in spells that make up 6 to 30 %."""
    course = uniform_filter1d(rng.normal(size=len(x)), 40)
    constant = rng.choice([x.min(), x.max(), x.min() - np.ptp(x) / 2, rng.choice(x)])
    return np.where(course > np.quantile(course, rng.uniform(0.7, 0.94)), constant, x)


def _copied(
    x: Floats, rng: Rng, share: float = 0.05, mixed: float = 0, noise: float = 0
) -> Damaged:
    """Copy some sensors to others, with noise; mixed: Both read the mean, as if shorted."""
    n, x = x.shape[1], x.copy()
    pairs = rng.permutation(n)[: 2 * max(1, round(share * n))].reshape(2, -1)
    if mixed:
        x[:, pairs[0]] = x[:, pairs[1]] = (x[:, pairs[0]] + x[:, pairs[1]]) / 2
        return Damaged(x, pairs.ravel())
    x[:, pairs[0]] = x[:, pairs[1]] * rng.uniform(0.8, 1.2, pairs.shape[1])
    if noise:
        x[:, pairs[0]] += (
            noise * x[:, pairs[0]].std(axis=0) * rng.normal(size=(len(x), len(pairs[0])))
        )
    return Damaged(x, pairs.ravel())


def _wired(rewire: Callable[..., Ints]) -> Damage:
    """Make a damage from an order of sensors; start: When, as a share of frames."""

    def damage(x: Floats, rng: Rng, start: float = 0, **parameters: float) -> Damaged:
        wires, first = rewire(x.shape[1], rng, **parameters), round(start * len(x))
        moved = np.flatnonzero(wires != np.arange(len(wires)))
        rewired = np.concatenate([x[:first], x[first:, wires]])
        return Damaged(rewired, moved, None if first else wires)

    return damage


def _swapped(n: int, rng: Rng, wires: float = 0) -> Ints:
    order, some = np.arange(n), rng.permutation(n)[: int(wires) or rng.integers(2, 7)]
    order[some] = np.roll(some, 1)
    return order


def _shifted(n: int, rng: Rng, share: float = 0.33) -> Ints:
    order, width = np.arange(n), max(3, round(share * n))
    part = slice(first := rng.integers(n - width + 1), first + width)
    order[part] = np.roll(order[part], 1)
    return order


def _modules(n: int, rng: Rng, size: float = 10) -> Ints:
    order, size = np.arange(n), min(int(size), n // 2)
    one, other = size * rng.permutation(n // size)[:2]
    order[one : one + size], order[other : other + size] = (
        np.arange(other, other + size), np.arange(one, one + size))  # fmt: skip
    return order


def _boards(n: int) -> Ints:
    return np.arange(n) // BOARD


def _spikes(x: Floats, rng: Rng, of_boards: float = 0, share: float = 0.01) -> Damaged:
    boards = _boards(x.shape[1]) if of_boards else np.arange(x.shape[1])
    struck = rng.random((len(x), boards[-1] + 1)) < share
    sizes = struck * rng.normal(0, 6 * x.std(), struck.shape)
    return Damaged(x + sizes[:, boards])


def _common_noise(x: Floats, rng: Rng, level: float = 0.3, of_boards: float = 0) -> Damaged:
    boards = _boards(x.shape[1]) if of_boards else np.zeros(x.shape[1], int)
    noise = rng.normal(size=(len(x), boards[-1] + 1))
    return Damaged(x + level * x.std() * noise[:, boards])


def _regions(x: Floats, _: Rng) -> Damaged:
    """Touch half of the sensors in the first half of the frames, the others in the second."""
    late = np.arange(len(x))[:, None] >= len(x) // 2
    second = np.arange(x.shape[1]) >= x.shape[1] // 2
    return Damaged(np.where(late == second, x, np.median(x, axis=0)))


def _lags(x: Floats, _: Rng, frames: float = 3) -> Damaged:
    lags = int(frames) * (_boards(x.shape[1]) % 2)
    return Damaged(
        np.stack([np.roll(c, d) for c, d in zip(x.T, lags, strict=True)], 1)[max(lags) :]
    )


def _frozen(x: Floats, rng: Rng, share: float = 0.1, frames: float = 25) -> Damaged:
    x = x.copy()
    for start in rng.integers(1, len(x), round(share * len(x) / frames)):
        x[start : start + int(frames)] = x[start - 1]
    return Damaged(x)


def _lost(
    x: Floats, rng: Rng, share: float = 0.1, frames: float = 8, gaps: bool = False
) -> Damaged:
    hit, x = np.zeros(len(x), bool), x.copy()
    for start in rng.integers(0, len(x), round(share * len(x) / frames)):
        hit[start : start + int(frames)] = True
    x[hit] = np.nan
    return Damaged(x if gaps else x[~hit])


def _steps(
    x: Floats, rng: Rng, steps: float = 3, *, share: float = 0.2, boards: float = 0,
    sensors: float = 0,
) -> Damaged:  # fmt: skip
    """Let the baselines of some sensors step, of some boards, or of a number of sensors."""
    x, numbers = x.copy(), _boards(x.shape[1])
    some = np.flatnonzero(rng.random(x.shape[1]) < share)
    if boards:
        some = np.flatnonzero(np.isin(numbers, rng.permutation(numbers[-1] + 1)[: int(boards)]))
    if sensors:
        some = np.sort(rng.permutation(x.shape[1])[: int(sensors)])
    for start in rng.integers(0, len(x), int(steps)):
        x[start:, some] += 0.2 * _deep(x) * rng.normal(size=len(some))
    return Damaged(x, some)


def _mounted(x: Floats, rng: Rng, start: float = 0.5) -> Damaged:
    """Mount the skin again: gains and baselines change."""
    first, n, rest = round(start * len(x)), x.shape[1], np.median(x, axis=0)
    preload = 0.03 * _deep(x) * rng.normal(size=n)
    after = rest + (x[first:] - rest) * rng.lognormal(0, 0.3, n) + preload
    return Damaged(np.concatenate([x[:first], after]))


def _deep(x: Floats) -> float:
    return float(np.quantile(x, 0.99) - np.median(x))


DAMAGES: Mapping[str, Damage] = {
    "swapped": _wired(_swapped),
    "shifted": _wired(_shifted),
    "modules": _wired(_modules),
    "dead": _of_sensors(lambda c, rng: np.zeros_like(c)),
    "stuck": _of_sensors(lambda c, rng: np.full_like(c, rng.choice(c))),
    "intermittent": _of_sensors(
        lambda c, rng: np.where(uniform_filter1d(rng.normal(size=len(c)), 40) > 0, c, c.min())
    ),
    "dropping": _of_sensors(_dropping),
    "inverted": _of_sensors(lambda c, rng: c.max() + c.min() - c),
    "saturating": _of_sensors(lambda c, rng: np.minimum(c, c.min() + 0.3 * np.ptp(c))),
    "copied": _copied,
    "shorted": lambda x, rng, share=0.05: _copied(x, rng, share, 1),
    "leak": lambda x, rng, share=0.05: Damaged(x + share * np.pad(x, ((0, 0), (1, 0)))[:, :-1]),
    "gain-drift": lambda x, rng, level=0.3: Damaged(x * np.exp(level * _walks(x.shape, rng))),
    "common-noise": _common_noise,
    "humming": lambda x, rng, level=1: Damaged(
        x + level * x.std() * 2**0.5 * np.sin(rng.uniform(0.5, 1.5) * np.arange(len(x)))[:, None]
    ),
    "regions": _regions,
    "spikes": _spikes,
    "frozen": _frozen,
    "stuck-bit": _of_sensors(
        lambda c, rng: (np.round((c - c.min()) / np.ptp(c) * 255).astype(int) | 16).astype(float)
        / 255 * np.ptp(c) + c.min()
    ),
    "steps": _steps,
    "lost-frames": _lost,
    "gaps": lambda x, rng, share=0.1: Damaged(_lost(x, rng, share, gaps=True).readings),
    "lags": _lags,
    "mounting": _mounted,
    "posture": lambda x, rng: Damaged(x),  # `independent.make` bends the skin half-way
}  # fmt: skip
"""Functions of readings (T, N), a generator, and parameters."""


def _autoregressive(rng: Rng, shape: tuple[int, int], a: float) -> Floats:
    return np.asarray(lfilter([(1 - a * a) ** 0.5], [1, -a], rng.normal(size=shape), axis=0))


def noise(kind: str, n_sensors: int = 16, n_frames: int = 1500, seed: int = 0) -> Floats:
    """Return readings of a kind in `NOISES`, of sensors that are nowhere."""
    rng = np.random.default_rng(seed)
    return np.asarray(NOISES[kind](rng, (n_frames, n_sensors)))


def _bursts(rng: Rng, n_frames: int) -> Floats:
    on = rng.random(n_frames // 75 + 1) < 0.05
    on[rng.integers(len(on) - 1)] = True
    return np.repeat(on, 75)[:n_frames, None].astype(float)


NOISES: Mapping[str, Callable[[Rng, tuple[int, int]], Floats]] = {
    "common-amplitude": lambda rng, shape: (
        rng.normal(size=shape) * np.exp(1.5 * _autoregressive(rng, (shape[0], 1), 0.99))
    ),
    "bursts": lambda rng, shape: rng.normal(size=shape) * (1 + 19 * _bursts(rng, shape[0])),
    "whole-hand": lambda rng, shape: abs(rng.normal(size=shape)) * _bursts(rng, shape[0]),
    "rare-frames": lambda rng, shape: (
        rng.normal(size=shape) * np.where(rng.random((shape[0], 1)) < 0.02, 50, 1)
    ),
    "common-drift": lambda rng, shape: (
        rng.normal(size=shape)
        + _autoregressive(rng, (shape[0], 1), 0.999) * rng.uniform(0.2, 2, shape[1])
    ),
    "white": lambda rng, shape: rng.normal(size=shape),
    "autoregressive": lambda rng, shape: _autoregressive(rng, shape, 0.95),
    "sparse": lambda rng, shape: rng.gamma(1, size=shape) * (rng.random(shape) < 0.03),
    "sinusoidal": lambda rng, shape: (
        np.sin(
            rng.uniform(0.02, 0.5, shape[1]) * np.arange(shape[0])[:, None]
            + rng.uniform(0, 2 * np.pi, shape[1])
        )
        + 0.1 * rng.normal(size=shape)
    ),
}
"""Independent noises that share amplitude, bursts or drift, or nothing."""
