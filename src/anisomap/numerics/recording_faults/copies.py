"""Copies: channels that read one wire, exactly or with another gain and noise."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet

from anisomap.numerics.recording_faults.excerpt import (
    MAX_FRAMES,
    middle_frames,
    some_sensors,
    standardised,
)
from anisomap.numerics.similarity.search import NO_SENSOR, most_similar

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
_MIN_LEVELS = 32  # distinct values of noise
_NOISIER, _LEAST_NOISE = 2.0, 0.003  # by which copies are noisier than their source
_MIN_SOUND = 10  # sensors from which it is seen whether channels follow the skin
_MIN_TOLD_APART = 0.85  # share of these whose own channels can be told from others
_MIN_FAILED = 5  # pairs from which this is estimated
_MAX_BEST_SHARE = 0.9  # a neighbour that is noisy disagrees at least so rarely; chosen by hand


@dataclass(frozen=True)
class Copies:
    """Sensors that read one wire.

    Attributes
    ----------
    sensors : tuple of int
        In increasing order.
    kept : int or None
        The sensor whose wire it is: the one with less noise, or the one that resembles the channels
        beside it. None if nothing tells them apart.
    noise : float
        Greatest share of noise in the variance of a sensor.
    """

    sensors: tuple[int, ...]
    kept: int | None
    noise: float


def find_copies(readings: NDArray[Any]) -> tuple[Copies, ...]:
    """Find groups of sensors that read one wire.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
        Finite.

    Returns
    -------
    tuple of Copies

    Notes
    -----
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
    varying = np.flatnonzero(readings.max(axis=0) > readings.min(axis=0))
    if len(readings) < 3 or varying.size < 3:
        return ()
    most = MAX_FRAMES if varying.size <= _MANY_SENSORS else MAX_FRAMES // 2
    excerpt = _Excerpt(readings, varying, most)
    pairs = list(excerpt.similar_pairs())
    groups = DisjointSet(varying.tolist())
    noise: dict[int, float] = {}
    for i, j in [*_identical(readings, pairs), *_noisy(readings, excerpt, pairs)]:
        groups.merge(i, j)
        for sensor, share in zip((i, j), excerpt.noise_shares(i, j), strict=True):
            noise[sensor] = max(noise.get(sensor, 0.0), share)
    return tuple(
        Copies(
            tuple(sorted(members)),
            _true_sensor(excerpt, sorted(members), noise, set(noise)),
            max(noise[i] for i in members),
        )
        for members in groups.subsets()
        if len(members) > 1
    )


class _Excerpt:
    """Standardised readings of some frames, and their covariances with some sensors."""

    def __init__(self, readings: NDArray[Any], varying: NDArray[np.intp], most: int) -> None:
        values = standardised(readings[middle_frames(len(readings), most)][:, varying])
        self.rows = np.ascontiguousarray(values.T)
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

    def misfit(self, i: int, j: int) -> float:
        """Return by how much j differs from i times a gain plus noise, in units of the limits."""
        gain = self.gain(i, j)
        mine, other = self.rows[self.number[i]], self.rows[self.number[j]]
        rest = other - gain * mine
        size, n_frames = float(rest.std()), rest.size
        third, first, second = self._third(i, j)
        if gain <= 0 or size <= _ROUNDING or not third.any():
            return math.inf
        if np.unique(rest[: _MIN_LEVELS**2]).size < _MIN_LEVELS:
            return math.inf  # sensors with few values have no noise of their own
        deviations = math.sqrt(n_frames)
        limit = _normal_maximum(len(self.varying) * int(third.sum()))
        if np.abs(first).max() * deviations < 2 * limit:
            return math.inf  # without a signal in common with others, nothing speaks for a copy
        with_others = float(np.abs(second - gain * first).max()) / size * deviations / limit
        white = max(abs(float(rest[lag:] @ rest[:-lag])) for lag in (1, 2)) / n_frames / size**2
        strength = np.abs(rest) - np.abs(rest).mean()
        nearest = self.others[third][np.abs(first).argmax()]
        height = np.abs(self.rows[nearest])  # of contact, without the noise of the pair
        height -= height.mean()
        spread = float(strength.std() * height.std()) * n_frames
        even = abs(float(strength @ height)) / spread if spread else math.inf
        limit = _normal_maximum(3 * len(self.varying))
        return max(with_others, float(white) * deviations / limit, even * deviations / limit)

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


def _identical(readings: NDArray[Any], pairs: list[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Yield pairs that agree in all frames, up to gain and offset, and change often enough."""
    # Only if some pair agrees, it matters how rarely others disagree.
    if not any(
        _disagreements(readings, pair) == 0 for pair in _agreeing_in_excerpt(readings, pairs)
    ):
        return
    shares, agreeing = [], []
    for i, j in pairs:
        disagreements = _disagreements(readings, (i, j))
        changes = np.count_nonzero(np.abs(np.diff(_unit_range(readings[:, i]))) > _ROUNDING)
        if not disagreements:
            agreeing.append((i, j, changes))
        elif changes >= _MIN_CHANGES:
            shares.append(min(_MAX_BEST_SHARE, disagreements / changes))
    best = min(shares, default=_MAX_BEST_SHARE)
    enough = math.log(max(2, readings.shape[1]) / FALSE_ALARMS) / -math.log1p(-best)
    for i, j, changes in agreeing:
        if changes >= max(_MIN_CHANGES, enough):
            yield i, j


def _agreeing_in_excerpt(
    readings: NDArray[Any], pairs: list[tuple[int, int]]
) -> Iterator[tuple[int, int]]:
    """Yield pairs that agree in evenly spaced frames, up to gain and offset."""
    lowest, highest = (
        np.asarray(f(axis=0), dtype=np.float64) for f in (readings.min, readings.max)
    )
    extent = np.where(highest > lowest, highest - lowest, 1)
    some = (readings[:: -(-len(readings) // _SCREENED)] - lowest) / extent
    for i, j in pairs:
        if (np.abs(some[:, i] - some[:, j]) <= _ROUNDING).all():
            yield i, j


def _disagreements(readings: NDArray[Any], pair: tuple[int, int]) -> int:
    """Count the frames in which two sensors disagree, up to gain and offset."""
    first, second = (_unit_range(readings[:, i]) for i in pair)
    return int(np.count_nonzero(np.abs(first - second) > _ROUNDING))


def _noisy(
    readings: NDArray[Any], excerpt: _Excerpt, pairs: list[tuple[int, int]]
) -> Iterator[tuple[int, int]]:
    """Yield pairs of which one is the other times a gain, plus white noise."""
    misfits = np.array([excerpt.misfit(i, j) for i, j in pairs])
    failed = misfits[(misfits > 1) & np.isfinite(misfits)]
    if failed.size >= _MIN_FAILED and np.quantile(failed, 0.1) < _MIN_POWER:
        return
    passed = [pair for pair, misfit in zip(pairs, misfits.tolist(), strict=True) if misfit <= 1]
    if passed and excerpt.rows.shape[1] < len(readings):
        others = excerpt.varying[excerpt.others]
        sensors = np.union1d(others, np.array(passed, dtype=np.intp).ravel())
        longer = _Excerpt(readings, sensors, _MAX_CONFIRMED)
        passed = [(i, j) for i, j in passed if longer.misfit(i, j) <= 1]
    yield from passed


def _normal_maximum(count: int) -> float:
    """Return the value that the largest of `count` normal variables exceeds with probability 1 %.

    Bonferroni's bound, with the tail of the normal distribution approximated by exp(-z^2 / 2) / 2.
    """
    return math.sqrt(2 * math.log(max(1, count) / FALSE_ALARMS))


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


def _unit_range(column: NDArray[Any]) -> NDArray[np.float64]:
    values = column.astype(np.float64)
    values -= values.min()
    return np.asarray(values / values.max())
