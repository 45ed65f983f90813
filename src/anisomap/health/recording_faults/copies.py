"""Copies: channels that read the same wire, exactly or with a different gain and noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.special import pdtrc

from anisomap.health.recording_faults import Found, has_contacts, turns_like_noise
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.numerics.graph.neighbour_graphs import MAX_WHOLE, all_products, most_similar
from anisomap.numerics.signals import (
    MAX_FRAMES,
    excerpt_frames,
    normal_maximum,
    some_sensors,
    standardised,
)
from anisomap.recording import Recording

_FALSE_ALARMS = 0.01  # expected number of false findings in a recording
_MANY_SENSORS = 512  # above, fewer frames are compared, for speed
_MAX_CONFIRMED = 1 << 15  # frames in which copies are confirmed
_N_PARTNERS = 2  # most similar sensors that are tested
_MIN_CORRELATION = 0.5  # of a copy; r is 0.7 if noise is as strong as the signal
_MIN_CHANGES = 10  # of a sensor's value, in 5 contacts: fewer may agree by chance; chosen by hand
_ROUNDING = 1e-5  # share of the range of a sensor, about 100 steps of float32
_SCREENED = 512  # frames in which the agreement of pairs is examined first; chosen by hand
_PAIRS_AT_ONCE = 64  # whose misfits are computed; arrays of 2,048 frames stay in the cache
_MIN_LEVELS = 32  # distinct values of noise
_NOISIER, _LEAST_NOISE = 2.0, 0.003  # noise of copies relative to their source
# Minimum misfit of the best tenth of the failed pairs, in limits; simulated and real: 3 to 9.
_MIN_POWER = 2.0
_MIN_FAILED = 5  # pairs from which the distances of sensors are estimated
_MAX_BEST_SHARE = 0.9  # maximum share of disagreements of a noisy neighbour; chosen by hand
_EXACT = 1e-3  # share of noise in the variance below which copies are exact


@dataclass(frozen=True)
class Copies:
    """Sensors that read the same wire.

    sensors: In increasing order.
    kept: The sensor that belongs to the wire, which has less noise; None if it is not known.
    noise: Greatest share of noise in the variance of a sensor; 0 if they agree in every frame.
    """

    sensors: tuple[int, ...]
    kept: int | None
    noise: float


def copied_groups(recording: Recording) -> list[Copies]:
    """List the groups of sensors that read the same wire.

    Noisy sensors that are never at rest and agree in every frame have common noise. All other
    sensors must have contacts of several kinds, since contacts at a single place also cause equal
    readings.
    """
    signals = recording.signals
    return [
        one
        for one in _alike(recording.readings, *recording.extremes)
        if (
            one.noise == 0
            and np.isin(one.sensors, signals.never_at_rest).all()
            and turns_like_noise(recording.readings[:, one.sensors[0]])
        )
        or (
            signals.contacts[list(one.sensors)].min() >= MIN_CONTACTS
            and has_contacts(recording, np.array(one.sensors))
        )
    ]


def find_copied(recording: Recording) -> Iterator[Found]:
    """Find groups of sensors that read the same wire: see `copied_groups`."""
    names, groups = recording.names, copied_groups(recording)
    left_out = sum(len(copies.sensors) - (copies.kept is not None) for copies in groups)
    some_left = left_out < np.count_nonzero(recording.varying())
    for copies in groups:
        kept = None if copies.kept is None else names[copies.kept]
        others = frozenset(names[i] for i in copies.sensors) - {kept}
        noise = copies.noise if copies.noise >= _EXACT else 0.0
        yield Found(
            copies.sensors,
            len(copies.sensors),
            {"noise": noise, "kept": kept},
            _leave_out(others) if some_left else None,
        )


def _leave_out(names: frozenset[str]) -> Callable[[Recording], Recording]:
    return lambda recording: recording.select([name not in names for name in recording.names])


def _alike(
    readings: NDArray[Any], lowest: NDArray[np.floating], highest: NDArray[np.floating]
) -> tuple[Copies, ...]:
    """Find groups of sensors with equal readings, up to gain and noise.

    readings (T, N), lowest, highest (N,).

    Neighbours on a skin are similar, too, but their difference correlates with third sensors, which
    are closer to one of the two. If x_j = g x_i + noise, then the covariances of j with all third
    sensors are g times those of i, and x_j - g x_i is white, and independent of third sensors and
    of contact depth. In each test, 1 % of the recordings with copies fail. If sensors are placed at
    random, two sensors may be close enough to pass: a pair is no copy if such a close pair is to be
    expected on this skin (`_closer_than_chance`). If many pairs fail narrowly, none is judged.

    Sensors that agree in every frame are copies if they change often enough. The most similar pair
    that disagrees gives the least probability p of disagreement at a change; n changes agree by
    chance with probability (1 - p)^n.
    """
    varying = np.flatnonzero(highest > lowest)
    if len(readings) < 3 or varying.size < 3:
        return ()
    most = MAX_FRAMES if varying.size <= _MANY_SENSORS else MAX_FRAMES // 2
    excerpt = _Excerpt(readings, varying, most)
    pairs = excerpt.similar_pairs()
    ends = lowest.astype(np.float64), highest.astype(np.float64)
    same = _identical(readings, *ends, varying[pairs])
    noisy = _noisy(readings, varying, excerpt, pairs)
    found = pairs[same | noisy]
    if not len(found):
        return ()
    noise = np.zeros(varying.size)
    differ = pairs[noisy & ~same]
    np.maximum.at(noise, differ, excerpt.noise_shares(differ))
    graph = coo_array((np.ones(len(found)), found.T), shape=(varying.size, varying.size))
    _, group = connected_components(graph, directed=False)
    copied = np.unique(found)
    groups = [copied[group[copied] == number] for number in np.unique(group[copied])]
    return tuple(_group(varying[members], noise[members]) for members in groups)


def _group(sensors: NDArray[np.intp], noise: NDArray[np.float64]) -> Copies:
    """Return a group of copies, with the sensor to keep if it has clearly less noise."""
    quietest = int(noise.argmin())
    others = np.delete(noise, quietest)
    clear = (others > _NOISIER * noise[quietest] + _LEAST_NOISE).all()
    kept = int(sensors[quietest]) if clear else None
    return Copies(tuple(sensors.tolist()), kept, float(noise.max()))


class _Excerpt:
    """Standardised readings of n sensors in some frames, and covariances with K sensors."""

    def __init__(self, readings: NDArray[Any], sensors: NDArray[np.intp], most: int) -> None:
        part = readings[excerpt_frames(readings, most)]
        self.rows = np.ascontiguousarray(standardised(part[:, sensors]).T)
        self.others = some_sensors(sensors.size)
        self.whole = all_products(self.rows) if sensors.size <= MAX_WHOLE else None

    @cached_property
    def covariance(self) -> NDArray[np.float32]:
        """Covariances of all sensors with the K sensors `others`, (n, K)."""
        found = (
            self.rows @ self.rows[self.others].T
            if self.whole is None
            else self.whole[:, self.others]
        )
        return np.asarray(found / np.float32(self.rows.shape[1]))

    def similar_pairs(self) -> NDArray[np.intp]:
        """Return pairs of similar sensors, each once, the lower index first, shape (P, 2)."""
        n_sensors, n_frames = self.rows.shape
        found, products = most_similar(self.rows, min(_N_PARTNERS, n_sensors - 1), whole=self.whole)
        first, which = np.nonzero(products >= _MIN_CORRELATION * n_frames)
        ordered = np.sort(np.column_stack([first, found[first, which]]), axis=1)
        return np.unique(ordered, axis=0).astype(np.intp).reshape(-1, 2)

    def related(
        self, pairs: NDArray[np.intp]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64], NDArray[np.intp]]:
        """Return covariances of both sensors of pairs with third sensors, (P, K); 0 within a pair.

        Also return the ratio of the covariances of the second and the first sensor, (P,), which
        noise does not bias, unlike a slope of readings; and the numbers of third sensors, (P,).
        """
        third = (self.others != pairs[:, :1]) & (self.others != pairs[:, 1:])
        first, second = (np.where(third, self.covariance[k], 0) for k in pairs.T)
        square = np.einsum("pk,pk->p", first, first)
        product = np.einsum("pk,pk->p", first, second, dtype=np.float64)
        gain = np.divide(product, square, out=np.zeros(len(pairs)), where=square > 0)
        return first, second, gain, np.count_nonzero(third, axis=1)

    def distances(self, pairs: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the relative difference of the covariances with third sensors, (P,).

        It is proportional to the distance of near sensors, and independent of their own noise.
        """
        first, second, gain, _ = self.related(pairs)
        size = np.linalg.norm(second, axis=1)
        apart = np.linalg.norm(second - gain[:, None] * first, axis=1)
        return np.asarray(np.divide(apart, size, out=np.full(len(pairs), np.inf), where=size > 0))

    def misfits(self, pairs: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the deviation of j from i times a gain plus noise, relative to limits.

        Shape (P,); inf where there is no evidence of a copy.
        """
        starts = range(0, len(pairs), _PAIRS_AT_ONCE)
        parts = [self._misfits(pairs[begin : begin + _PAIRS_AT_ONCE]) for begin in starts]
        return np.concatenate([np.empty(0), *parts])

    def _misfits(self, pairs: NDArray[np.intp]) -> NDArray[np.float64]:
        n_sensors, n_frames = self.rows.shape
        first, second, gain, counts = self.related(pairs)
        rest = self.rows[pairs[:, 1]] - gain.astype(np.float32)[:, None] * self.rows[pairs[:, 0]]
        size = rest.std(axis=1).astype(np.float64)
        deviations = math.sqrt(n_frames)
        limit = normal_maximum(n_sensors * counts)
        nearest, related = np.abs(first).argmax(axis=1), np.abs(first).max(axis=1)
        ordered = np.sort(rest[:, : _MIN_LEVELS**2], axis=1)
        levels = 1 + np.count_nonzero(ordered[:, 1:] > ordered[:, :-1], axis=1)
        possible = (
            (gain > 0)
            & (size > _ROUNDING)
            & (levels >= _MIN_LEVELS)  # sensors with few values have no noise of their own
            # There is no evidence of a copy without a signal in common with other sensors.
            & (related * deviations >= 2 * limit)
        )
        found = np.full(len(pairs), math.inf)
        rest, size, limit = rest[possible], size[possible], limit[possible]
        apart = np.abs(second[possible] - gain[possible, None] * first[possible]).max(axis=1)
        with_others = apart / size * deviations / limit
        products = [np.einsum("pt,pt->p", rest[:, lag:], rest[:, :-lag]) for lag in (1, 2)]
        white = np.abs(products).max(axis=0) / n_frames / size**2
        strength = np.abs(rest)
        strength -= strength.mean(axis=1, keepdims=True)
        # The contact depth in a third sensor does not contain the noise of the pair.
        height = np.abs(self.rows[self.others[nearest[possible]]])
        height -= height.mean(axis=1, keepdims=True)
        spread = strength.std(axis=1).astype(np.float64) * height.std(axis=1) * n_frames
        even = np.abs(np.einsum("pt,pt->p", strength, height)).astype(np.float64)
        even = np.divide(even, spread, out=np.full(even.size, math.inf), where=spread > 0)
        overall = normal_maximum(3 * n_sensors)
        found[possible] = np.maximum(with_others, np.maximum(white, even) * (deviations / overall))
        return found

    def noise_shares(self, pairs: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the share of each variance that the sensors of pairs do not share, (P, 2)."""
        gain = self.related(pairs)[2]
        r = np.einsum("pt,pt->p", *self.rows[pairs.T]) / self.rows.shape[1]
        shares = 1 - np.column_stack([r / np.where(gain > 0, gain, 1), r * gain])
        return np.where(gain[:, None] > 0, np.maximum(shares, 0), 0)


def _identical(
    readings: NDArray[Any],
    lowest: NDArray[np.float64],
    highest: NDArray[np.float64],
    pairs: NDArray[np.intp],
) -> NDArray[np.bool_]:
    """Mark pairs that agree in all frames, up to gain and offset, and change often enough."""

    def scaled(i: int, step: int = 1) -> NDArray[np.float64]:
        return np.asarray((readings[::step, i] - lowest[i]) / (highest[i] - lowest[i]))

    def count(apart: NDArray[np.float64]) -> int:
        return int(np.count_nonzero(np.abs(apart) > _ROUNDING))

    step = -(-len(readings) // _SCREENED)
    agree = np.zeros(len(pairs), dtype=bool)
    for k, (i, j) in enumerate(pairs):
        alike = not count(scaled(i, step) - scaled(j, step))
        agree[k] = alike and not count(scaled(i) - scaled(j))
    if not agree.any():
        return agree
    first, pair = np.unique(pairs[:, 0], return_inverse=True)
    changes = np.array([count(np.diff(scaled(i))) for i in first])[pair]
    often = ~agree & (changes >= _MIN_CHANGES)
    apart = np.array([count(scaled(i) - scaled(j)) for i, j in pairs[often]])
    best = (apart / changes[often]).min(initial=_MAX_BEST_SHARE)
    enough = math.log(max(2, readings.shape[1]) / _FALSE_ALARMS) / -math.log1p(-best)
    return agree & (changes >= max(_MIN_CHANGES, enough))


def _noisy(
    readings: NDArray[Any], varying: NDArray[np.intp], excerpt: _Excerpt, pairs: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Mark pairs in which one sensor equals the other times a gain, plus white noise."""
    misfits = excerpt.misfits(pairs)
    passed = misfits <= 1
    failed = ~passed & np.isfinite(misfits)
    if passed.any() and np.count_nonzero(failed) >= _MIN_FAILED:
        if np.quantile(misfits[failed], 0.1) < _MIN_POWER:
            return np.zeros_like(passed)
        distances = excerpt.distances(pairs)
        passed[passed] = _closer_than_chance(distances[passed], distances[failed])
    if passed.any() and excerpt.rows.shape[1] < len(readings):
        used = np.union1d(excerpt.others, pairs[passed])
        longer = _Excerpt(readings, varying[used], _MAX_CONFIRMED)
        passed[passed] = longer.misfits(np.searchsorted(used, pairs[passed])) <= 1
    return np.asarray(passed)


def _closer_than_chance(
    distances: NDArray[np.float64], apart: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Mark pairs that are closer than the closest pairs of different sensors by chance, (P,).

    distances (P,), apart (Q,): Distances of possible copies, and of different sensors.

    Small distances follow a power law: the number of pairs closer than d is proportional to d^2 for
    random places on a surface, and smaller for regular ones. The exponent is estimated from the
    closer half of the pairs (Hill 1975, Annals of Statistics 3: 1163-1174). The number is Poisson
    distributed. The m closest pairs are marked, for the largest m of probability .01.
    """
    middle = float(np.median(apart))
    closer = apart[(apart > 0) & (apart < middle)]
    if not closer.size:
        return np.ones(len(distances), dtype=bool)
    exponent = 1 / float(np.log(middle / closer).mean())
    expected = apart.size / 2 * (distances / middle) ** exponent
    rank = np.searchsorted(np.sort(expected), expected, side="right")
    unlikely = pdtrc(rank - 1, expected) <= _FALSE_ALARMS
    return np.asarray(rank <= np.max(rank[unlikely], initial=0))
