"""Copies: channels that read one wire, exactly or with another gain and noise."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from anisomap.numerics.graph.neighbour_graphs import NO_SENSOR, most_similar
from anisomap.numerics.signals import (
    MAX_FRAMES,
    middle_frames,
    some_sensors,
    standardised,
)

FALSE_ALARMS = 0.01
"""Expected number of false findings in a recording."""

_MANY_SENSORS = 512  # above, fewer frames are compared, for speed
_MAX_CONFIRMED = 1 << 15  # frames in which copies are confirmed
_N_PARTNERS = 2  # most similar sensors that are tested
_MIN_CORRELATION = 0.5  # of a copy: with noise as strong as the signal, r is 0.7
_MIN_CHANGES = 10  # of a sensor's value, 5 contacts: fewer agree by chance; chosen by hand
_ROUNDING = 1e-5  # share of the range of a sensor, about 100 steps of float32
_MIN_POWER = (
    2.0  # limits by which a tenth of the pairs may fail at least; simulated and real: 3 to 9
)
_SCREENED = 512  # frames of which the agreement of pairs is examined first; chosen by hand
_PAIRS_AT_ONCE = 64  # whose misfits are computed; arrays of 2,048 frames stay in the cache
_MIN_LEVELS = 32  # distinct values of noise
_NOISIER, _LEAST_NOISE = 2.0, 0.003  # by which copies are noisier than their source
_MIN_SOUND = 10  # sensors from which it is seen whether channels follow the skin
_MIN_TOLD_APART = 0.85  # share of these whose own channels can be told from others
_MIN_FAILED = 5  # pairs from which this is estimated
_MAX_BEST_SHARE = 0.9  # a neighbour that is noisy disagrees at least so rarely; chosen by hand


@dataclass(frozen=True)
class Copies:
    """Sensors that read one wire.

    sensors: In increasing order.
    kept: The sensor whose wire it is: the one with less noise, or the one that resembles the
        channels beside it. None if nothing tells them apart.
    noise: Greatest share of noise in the variance of a sensor.
    """

    sensors: tuple[int, ...]
    kept: int | None
    noise: float


def find_copies(
    readings: NDArray[Any], lowest: NDArray[np.floating], highest: NDArray[np.floating]
) -> tuple[Copies, ...]:
    """Find groups of sensors that read one wire.

    readings (T, N), lowest, highest (N,).

    Neighbours on a skin are similar, too, but each is closer to other sensors, so their difference
    correlates with a third sensor. If x_j = g x_i + noise, then the covariances of j with all
    third sensors are g times those of i, and x_j - g x_i is white, independent of third sensors and
    of the height of the contact. Each of these is tested so that 1 % of the recordings with copies
    fail. In 2,000 frames of simulated skins (seeds 1 and 2), neighbours failed at 4 to 10 times the
    limits. Recordings in which many pairs fail by little are not judged.

    Readings that agree in every frame are copies if they change often enough. Of the pairs that
    disagree, the most similar one gives the smallest probability p of a disagreement at a change; n
    changes agree by chance with probability (1 - p)^n.
    """
    varying = np.flatnonzero(highest > lowest)
    if len(readings) < 3 or varying.size < 3:
        return ()
    most = MAX_FRAMES if varying.size <= _MANY_SENSORS else MAX_FRAMES // 2
    excerpt = _Excerpt(readings, varying, most)
    pairs = list(excerpt.similar_pairs())
    units = _UnitRange(readings, lowest.astype(np.float64), highest.astype(np.float64))
    found = [*_identical(units, pairs), *_noisy(readings, excerpt, pairs)]
    if not found:
        return ()
    noise: dict[int, float] = {}
    for i, j in found:
        for sensor, share in zip((i, j), excerpt.noise_shares(i, j), strict=True):
            noise[sensor] = max(noise.get(sensor, 0.0), share)
    return tuple(
        Copies(
            tuple(members),
            _true_sensor(excerpt, members, noise, set(noise)),
            max(noise[i] for i in members),
        )
        for members in _joined(found)
    )


def _joined(pairs: Sequence[tuple[int, int]]) -> Iterator[list[int]]:
    """Yield the sensors of each group that pairs join, both in increasing order."""
    sensors, number = np.unique(np.array(pairs), return_inverse=True)
    first, second = number.reshape(-1, 2).T
    graph = coo_array((np.ones(first.size), (first, second)), shape=(sensors.size, sensors.size))
    n_groups, group = connected_components(graph, directed=False)
    for k in range(n_groups):
        yield sensors[group == k].tolist()


class _Excerpt:
    """Standardised readings of some frames, and their covariances with some sensors."""

    def __init__(self, readings: NDArray[Any], varying: NDArray[np.intp], most: int) -> None:
        part = readings[middle_frames(len(readings), most)]
        some = part if varying.size == part.shape[1] else part[:, varying]
        self.rows = np.ascontiguousarray(standardised(some).T)
        self.varying = varying
        self.number = {int(i): k for k, i in enumerate(varying)}
        self.others = some_sensors(varying.size)
        self.covariance = self.rows @ self.rows[self.others].T / self.rows.shape[1]

    def similar_pairs(self) -> Iterator[tuple[int, int]]:
        """Yield pairs of similar sensors, each once, the lower index first."""
        n_sensors, n_frames = self.rows.shape
        found, products = most_similar(self.rows, min(_N_PARTNERS, n_sensors - 1))
        close = (products >= _MIN_CORRELATION * n_frames) & (found != NO_SENSOR)
        first, which = np.nonzero(close)
        ordered = np.sort(np.column_stack([first, found[first, which]]), axis=1)
        for i, j in np.unique(ordered, axis=0).tolist():
            yield int(self.varying[i]), int(self.varying[j])

    def gain(self, i: int, j: int) -> float:
        """Return the ratio of the covariances of j and i with other sensors.

        Noise of i would lower the slope of j on i.
        """
        third, first, second = self._third(i, j)
        square = float(first @ first)
        if not square or not third.any():
            return 0.0
        return float(np.sum(first * second, dtype=np.float64)) / square

    def misfits(self, pairs: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
        """Return by how much j differs from i times a gain plus noise, in units of the limits.

        Shape (P,); inf where nothing speaks for a copy.
        """
        numbers = np.array([(self.number[i], self.number[j]) for i, j in pairs], dtype=np.intp)
        parts = [
            self._misfits(*numbers[begin : begin + _PAIRS_AT_ONCE].T)
            for begin in range(0, len(numbers), _PAIRS_AT_ONCE)
        ]
        return np.concatenate(parts) if parts else np.empty(0)

    def _misfits(self, a: NDArray[np.intp], b: NDArray[np.intp]) -> NDArray[np.float64]:
        n_frames = self.rows.shape[1]
        third = (self.others != a[:, None]) & (self.others != b[:, None])
        first, second = (np.where(third, self.covariance[k], 0) for k in (a, b))
        square = np.einsum("pk,pk->p", first, first)
        product = np.einsum("pk,pk->p", first, second, dtype=np.float64)
        gain = np.divide(product, square, out=np.zeros(a.size), where=square > 0)
        rest = self.rows[b] - gain.astype(np.float32)[:, None] * self.rows[a]
        size = rest.std(axis=1).astype(np.float64)
        deviations = math.sqrt(n_frames)
        counts = np.count_nonzero(third, axis=1)
        limit = _normal_maximum(len(self.varying) * counts)
        nearest = np.abs(first).argmax(axis=1)
        related = np.abs(first).max(axis=1)
        ordered = np.sort(rest[:, : _MIN_LEVELS**2], axis=1)
        levels = 1 + np.count_nonzero(ordered[:, 1:] > ordered[:, :-1], axis=1)
        possible = (
            (gain > 0)
            & (size > _ROUNDING)
            & (levels >= _MIN_LEVELS)  # sensors with few values have no noise of their own
            # Without a signal in common with others, nothing speaks for a copy.
            & (related * deviations >= 2 * limit)
        )
        found = np.full(a.size, math.inf)
        rest, size, limit = rest[possible], size[possible], limit[possible]
        apart = np.abs(second[possible] - gain[possible, None] * first[possible]).max(axis=1)
        with_others = apart / size * deviations / limit
        products = [np.einsum("pt,pt->p", rest[:, lag:], rest[:, :-lag]) for lag in (1, 2)]
        white = np.abs(products).max(axis=0) / n_frames / size**2
        strength = np.abs(rest)
        strength -= strength.mean(axis=1, keepdims=True)
        # The height of contact, without the noise of the pair.
        height = np.abs(self.rows[self.others[nearest[possible]]])
        height -= height.mean(axis=1, keepdims=True)
        spread = strength.std(axis=1).astype(np.float64) * height.std(axis=1) * n_frames
        even = np.abs(np.einsum("pt,pt->p", strength, height)).astype(np.float64)
        even = np.divide(even, spread, out=np.full(even.size, math.inf), where=spread > 0)
        overall = _normal_maximum(3 * len(self.varying))
        found[possible] = np.maximum(with_others, np.maximum(white, even) * (deviations / overall))
        return found

    def noise_shares(self, i: int, j: int) -> tuple[float, float]:
        """Return the shares of the variances of two copies that they do not have in common."""
        gain = self.gain(i, j)
        r = float(self.rows[self.number[i]] @ self.rows[self.number[j]]) / self.rows.shape[1]
        return (max(0.0, 1 - r / gain), max(0.0, 1 - r * gain)) if gain > 0 else (0.0, 0.0)

    def similarity_beside(self, i: int, at: int | None = None) -> float:
        """Return the mean correlation of i with the channels beside it, or beside another."""
        place = self.number[i if at is None else int(at)]
        beside = [k for k in range(place - 2, place + 3) if 0 <= k < len(self.rows) and k != place]
        mine = self.rows[self.number[i]]
        r = [float(mine @ self.rows[k]) / mine.size for k in beside if k != self.number[i]]
        return float(np.mean(r)) if r else 0.0

    def _third(
        self, i: int, j: int
    ) -> tuple[NDArray[np.bool_], NDArray[np.float32], NDArray[np.float32]]:
        a, b = self.number[i], self.number[j]
        third = (self.others != a) & (self.others != b)
        return third, self.covariance[a, third], self.covariance[b, third]


@dataclass(frozen=True, eq=False)
class _UnitRange:
    """Readings of sensors that vary, scaled to their range: 0 to 1."""

    readings: NDArray[Any]
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]

    def of(self, sensors: NDArray[np.intp] | int, step: int = 1) -> NDArray[np.float64]:
        """Return each `step`-th frame of some sensors, or of one."""
        extent = self.highest[sensors] - self.lowest[sensors]
        return np.asarray((self.readings[::step, sensors] - self.lowest[sensors]) / extent)

    def agreeing_in_excerpt(self, pairs: list[tuple[int, int]]) -> Iterator[tuple[int, int]]:
        """Yield pairs that agree in evenly spaced frames."""
        step = -(-len(self.readings) // _SCREENED)
        sensors, place = np.unique(np.array(pairs, dtype=np.intp), return_inverse=True)
        rows = np.ascontiguousarray(self.of(sensors, step).T)
        for pair, (a, b) in zip(pairs, place.reshape(-1, 2).tolist(), strict=True):
            if (np.abs(rows[a] - rows[b]) <= _ROUNDING).all():
                yield pair

    def disagreements(self, i: int, j: int) -> int:
        """Count the frames in which two sensors disagree."""
        return int(np.count_nonzero(np.abs(self.of(i) - self.of(j)) > _ROUNDING))

    def changes(self, i: int) -> int:
        """Count the changes of a sensor."""
        return int(np.count_nonzero(np.abs(np.diff(self.of(i))) > _ROUNDING))


def _identical(units: _UnitRange, pairs: list[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Yield pairs that agree in all frames, up to gain and offset, and change often enough."""
    # Only if some pair agrees, it matters how rarely others disagree.
    if not any(units.disagreements(i, j) == 0 for i, j in units.agreeing_in_excerpt(pairs)):
        return
    shares, agreeing = [], []
    for i, j in pairs:
        disagreements, changes = units.disagreements(i, j), units.changes(i)
        if not disagreements:
            agreeing.append((i, j, changes))
        elif changes >= _MIN_CHANGES:
            shares.append(min(_MAX_BEST_SHARE, disagreements / changes))
    best = min(shares, default=_MAX_BEST_SHARE)
    enough = math.log(max(2, units.readings.shape[1]) / FALSE_ALARMS) / -math.log1p(-best)
    for i, j, changes in agreeing:
        if changes >= max(_MIN_CHANGES, enough):
            yield i, j


def _noisy(
    readings: NDArray[Any], excerpt: _Excerpt, pairs: list[tuple[int, int]]
) -> Iterator[tuple[int, int]]:
    """Yield pairs of which one is the other times a gain, plus white noise."""
    misfits = excerpt.misfits(pairs)
    failed = misfits[(misfits > 1) & np.isfinite(misfits)]
    if failed.size >= _MIN_FAILED and np.quantile(failed, 0.1) < _MIN_POWER:
        return
    passed = [pair for pair, misfit in zip(pairs, misfits.tolist(), strict=True) if misfit <= 1]
    if passed and excerpt.rows.shape[1] < len(readings):
        others = excerpt.varying[excerpt.others]
        sensors = np.union1d(others, np.array(passed, dtype=np.intp).ravel())
        longer = _Excerpt(readings, sensors, _MAX_CONFIRMED)
        passed = [
            pair for pair, one in zip(passed, longer.misfits(passed), strict=True) if one <= 1
        ]
    yield from passed


def _normal_maximum(count: ArrayLike) -> NDArray[np.float64]:
    """Return the value that the largest of `count` normal variables exceeds with probability 1 %.

    Bonferroni's bound, with the tail of the normal distribution approximated by exp(-z^2 / 2) / 2.
    """
    return np.asarray(np.sqrt(2 * np.log(np.maximum(1, count) / FALSE_ALARMS)))


def _true_sensor(
    excerpt: _Excerpt, members: list[int], noise: dict[int, float], copied: set[int]
) -> int | None:
    """Return the sensor of a group whose wire it is; None if that cannot be told.

    Where channels follow the skin, a sensor resembles the channels beside it.
    """
    quietest, *others = sorted(members, key=lambda i: noise[i])
    if all(noise[i] > _NOISIER * noise[quietest] + _LEAST_NOISE for i in others):
        return quietest
    own = sorted(members, key=excerpt.similarity_beside, reverse=True)
    sound = [int(i) for i in excerpt.varying[excerpt.others] if int(i) not in copied]
    if len(sound) < _MIN_SOUND:
        return None
    right = [excerpt.similarity_beside(i) for i in sound]
    wrong = [
        excerpt.similarity_beside(i, at=j)
        for i, j in zip(sound, np.roll(sound, len(sound) // 2), strict=True)
    ]
    middle = (np.median(right) + np.median(wrong)) / 2
    told_apart = np.mean(np.array(right) > middle) + np.mean(np.array(wrong) < middle)
    first, second = (excerpt.similarity_beside(i) for i in own[:2])
    clear = told_apart >= 2 * _MIN_TOLD_APART and second < middle < first
    return own[0] if clear else None
