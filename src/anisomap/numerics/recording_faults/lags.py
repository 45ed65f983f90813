"""Lags: groups of channels, such as boards, that are read some frames later than others."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.columns import columns, rank_columns
from anisomap.numerics.neighbours import tree_edges
from anisomap.numerics.signals import (
    middle_frames,
    some_sensors,
    standardised,
)

MAX_LAG = 40
"""Greatest lag that is searched, in frames; chosen by hand."""

_N_PARTNERS = 6  # most similar sensors of each sensor, whose lags are compared


@dataclass(frozen=True, eq=False)
class LagCorrelations:
    """Correlations of all pairs: ``at_lag[l, i, j]`` of i(t) and j(t + l), lags from 0 on."""

    at_lag: NDArray[np.float32]

    @classmethod
    def of(cls, parts: Sequence[NDArray[np.float32]]) -> LagCorrelations:
        """Average over parts of equal length."""
        n_frames, n_sensors = parts[0].shape
        # Zeros between the parts keep the frames of one from those of the next: one product.
        gap = np.zeros((MAX_LAG, n_sensors), dtype=np.float32)
        joined = np.concatenate([block for part in parts for block in (part, gap)])
        result = np.empty((MAX_LAG + 1, n_sensors, n_sensors), dtype=np.float32)
        for lag in range(MAX_LAG + 1):
            np.matmul(joined[: len(joined) - lag].T, joined[lag:], out=result[lag])
            result[lag] /= np.float32(len(parts) * (n_frames - lag))
            np.fill_diagonal(result[lag], -1)
        return cls(result)

    @cached_property
    def _highest(self) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
        peak = self.at_lag[0].copy()
        peak_lag = np.zeros(peak.shape, dtype=np.intp)
        for lag, later in enumerate(self.at_lag[1:], 1):
            for signed, found in ((lag, later), (-lag, later.T)):
                higher = found > peak
                np.copyto(peak, found, where=higher)
                peak_lag[higher] = signed
        return peak, peak_lag

    @property
    def peak(self) -> NDArray[np.float32]:
        """Highest correlation of each pair."""
        return self._highest[0]

    @property
    def peak_lag(self) -> NDArray[np.intp]:
        """Lag of the highest correlation; the smallest of equal ones."""
        return self._highest[1]

    def at(
        self, lags: NDArray[np.intp], i: NDArray[np.intp], j: NDArray[np.intp]
    ) -> NDArray[np.float32]:
        """Return the correlations of some pairs at lags of either sign, up to `MAX_LAG`."""
        apart = np.clip(lags, -MAX_LAG, MAX_LAG)
        later = apart >= 0
        return np.asarray(self.at_lag[np.abs(apart), np.where(later, i, j), np.where(later, j, i)])

    def strongest_links(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return pairs: each sensor and the ones that it is most similar to at any lag."""
        count = min(_N_PARTNERS, len(self.peak) - 1)
        partners = np.argsort(-self.peak, axis=1, kind="stable")[:, :count]
        return np.repeat(np.arange(len(self.peak)), count), partners.ravel()

    def along(
        self, links: tuple[NDArray[np.intp], NDArray[np.intp]], lags: NDArray[np.intp]
    ) -> NDArray[np.float32]:
        """Return the correlation of each link if sensors have the given lags."""
        i, j = links
        return self.at(lags[j] - lags[i], i, j)

    def lags_along_tree(self) -> NDArray[np.intp]:
        """Add up the lags of the links of a maximum spanning tree."""
        lags = np.zeros(len(self.peak), dtype=np.intp)
        for new, joined in tree_edges(self.peak):
            lags[new] = lags[joined] + self.peak_lag[joined, new]
        return lags - int(np.median(lags))


_MAX_VALUES = 1 << 19  # readings of an excerpt; chosen for about half a second
_MIN_SENSORS = 8
_SCREENED = 96  # sensors of which lags are searched first, if there are twice as many
# Least share of the lost correlation that their lags restore, and of their links of which a part of
# the recording gives the same lags. On simulated and real skins of 220 to 737 sensors in which lags
# were found (seeds 21 to 23), they were at least .42 and .78, and at most .32 and .58 on seven of
# eight without; on the other, .71 and .58.
_MIN_EXPLAINED_OF_FEW, _MIN_AGAIN_OF_FEW = 0.35, 0.6
_CHANGE_COST = 4.0  # of a new lag along the channels, in frames of misfit; tuned on seeds 1 and 2
_MAX_MISFIT = 6.0  # frames of misfit of one sensor that count
_SPREAD = 2  # frames by which the lags of a group may differ before they are made equal
# Limits of a finding, tuned on simulated skins (seeds 1 to 20) and on real recordings.
_MIN_AGREEMENT = 0.8  # share of the links between groups with the lag of the groups
_MIN_RELATIVE = 0.93  # this share over the share of the links within groups without a lag
_MAX_OPPOSITE = 0.08  # share of the links between groups with a lag of the other sign
_MIN_EXPLAINED = 0.5  # share of the correlation lost between groups that the lags restore
_MIN_AGAIN = 0.9  # share of the links for which each part of the recording gives the same lags
_MIN_GAIN = 0.8  # restored correlation over what the lags would cost links within groups
_MIN_WITHIN = 0.6  # share of the links within groups without a lag
_MIN_GROUP = 3.0  # sensors per group, on average
_CLEARLY_MORE = 1.005  # correlation by which groups that are not adjacent must explain more
_MAX_ROUNDS = 3


@dataclass(frozen=True, eq=False)
class Lags:
    """Lags of all sensors.

    frames: Frames by which each sensor lags; 0 for the largest group.
    agreement: Share of the similar pairs in different groups whose own lag is that of the groups.
    """

    frames: NDArray[np.intp]
    agreement: float


def find_lags(readings: NDArray[Any], varying: NDArray[np.bool_]) -> Lags | None:
    """Find groups of sensors that lag.

    readings (T, N).

    Ranks of the readings are correlated at all lags up to `MAX_LAG`. The lags of the strongest
    links, a spanning tree, give a lag to each sensor. Groups are sensors with nearly equal lags
    that follow each other in the order of the channels, or, if that explains less, wherever they
    are. Contacts that move also give neighbours a lag, but of either sign, spread over many values,
    and different from one time to another; a lag of the read-out is the same for all pairs of two
    groups and in all quarters of the recording. It must restore as much correlation as such a lag
    costs links within groups. Of many sensors, some are searched first.
    """
    total: NDArray[np.intp] | None = None
    agreement = 1.0
    for _ in range(_MAX_ROUNDS):
        current = readings if total is None else align(readings, total)
        found = _find_once(current, np.flatnonzero(varying), screened=total is None)
        if found is None:
            break
        total = found.frames if total is None else total + found.frames
        total -= _most_frequent(total)
        agreement = found.agreement
    return None if total is None or not total.any() else Lags(total, agreement)


def align(readings: NDArray[Any], lags: NDArray[np.intp]) -> NDArray[Any]:
    """Shift sensors in time by their lags, and leave out frames that some sensors lack.

    readings (T, N) -> (T - max(lags) + min(lags), N).
    """
    n_frames = len(readings) - int(np.ptp(lags))
    shifted = np.empty((n_frames, readings.shape[1]), dtype=readings.dtype)
    for lag in np.unique(lags).tolist():
        start = lag - int(lags.min())
        shifted[:, lags == lag] = readings[start : start + n_frames][:, lags == lag]
    return shifted


def _find_once(readings: NDArray[Any], varying: NDArray[np.intp], *, screened: bool) -> Lags | None:
    chosen = varying[some_sensors(varying.size)]
    if chosen.size < _MIN_SENSORS:
        return None
    frames = middle_frames(len(readings), max(1024, _MAX_VALUES // chosen.size))
    values = readings[frames][:, chosen]
    if len(values) < 8 * MAX_LAG:
        return None
    if screened and chosen.size >= 2 * _SCREENED:
        few = _Fit.of(values[:, some_sensors(chosen.size, _SCREENED)])
        if not few.explains(_MIN_EXPLAINED_OF_FEW):
            return None
        if np.mean(list(few.found_again())) < _MIN_AGAIN_OF_FEW:
            return None
    fit = _Fit.of(values)
    agreement = _check(fit)
    if agreement is None:
        return None
    everyone = np.zeros(readings.shape[1], dtype=np.intp)
    everyone[chosen] = fit.lags
    if chosen.size < varying.size:
        everyone = _extended(readings[frames], varying, chosen, everyone)
    return Lags(everyone - _most_frequent(everyone[varying]), agreement)


@dataclass(frozen=True, eq=False)
class _Fit:
    """Lags of n sensors and their groups, which restore most of the correlation of the links."""

    parts: Sequence[NDArray[np.float32]]
    whole: LagCorrelations
    links: tuple[NDArray[np.intp], NDArray[np.intp]]
    lags: NDArray[np.intp]
    groups: NDArray[np.intp]

    @classmethod
    def of(cls, values: NDArray[Any]) -> _Fit:
        """Fit lags to readings of shape (T, n)."""
        ranks = rank_columns(columns(values), values.shape)
        n_parts = int(np.clip(len(ranks) // (10 * MAX_LAG), 2, 4))
        equal = ranks[: len(ranks) // n_parts * n_parts]
        parts = [standardised(part) for part in np.split(equal, n_parts)]
        whole = LagCorrelations.of(parts)
        links = whole.strongest_links()
        tree = whole.lags_along_tree()
        anywhere = _fitted(whole, links, _anywhere(tree))
        in_order = max(
            (_fitted(whole, links, _in_order(lags)) for lags in (tree, anywhere[0])),
            key=lambda result: whole.along(links, result[0]).sum(),
        )
        sums = [float(whole.along(links, lags).sum()) for lags, _ in (in_order, anywhere)]
        best = anywhere if sums[1] > _CLEARLY_MORE * sums[0] else in_order
        return cls(parts, whole, links, *best)

    @property
    def expected(self) -> NDArray[np.intp]:
        """Lag of each link."""
        i, j = self.links
        return self.lags[j] - self.lags[i]

    def restored(self) -> tuple[float, float]:
        """Return the correlation that the lags restore, and that which any lags could."""
        across = self.expected != 0
        without = self.whole.along(self.links, np.zeros_like(self.lags))[across]
        restored = float((self.whole.along(self.links, self.lags)[across] - without).sum())
        return restored, float((self.whole.peak[self.links][across] - without).sum())

    def explains(self, share: float) -> bool:
        """Return whether there are lags, and restore at least a share of the lost correlation."""
        restored, lost = self.restored()
        return bool(self.expected.any()) and restored >= share * lost

    def found_again(self) -> Iterator[float]:
        """Yield the share of the links for which each part of the recording gives the same lags."""
        i, j = self.links
        across = self.expected != 0
        for part in self.parts:
            again = _fitted(LagCorrelations.of([part]), self.links, (self.lags, self.groups))[0]
            same = np.abs(again[j] - again[i] - self.expected)[across] <= 1
            yield float(np.mean(same))


def _in_order(lags: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Divide sensors along their order into runs of equal lags."""
    levels = np.unique(lags)
    misfit = np.minimum(np.abs(lags[:, None] - levels), _MAX_MISFIT)
    cost, previous = misfit[0].copy(), []
    for row in misfit[1:]:
        cheapest = int(cost.argmin())
        changes = cost[cheapest] + _CHANGE_COST < cost
        previous.append(np.where(changes, cheapest, np.arange(levels.size)))
        cost = np.where(changes, cost[cheapest] + _CHANGE_COST, cost) + row
    state = int(cost.argmin())
    states = [state]
    for row_of_states in reversed(previous):
        state = int(row_of_states[state])
        states.append(state)
    found = levels[np.array(states[::-1])]
    return found, np.concatenate([[0], np.cumsum(np.diff(found) != 0)])


def _anywhere(lags: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Group sensors by lags that differ by at most 2 frames, the most frequent first."""
    found = lags.copy()
    left = np.ones(lags.size, dtype=bool)
    while left.any():
        levels, counts = np.unique(lags[left], return_counts=True)
        near = np.abs(levels[:, None] - levels) <= _SPREAD
        level = levels[np.lexsort((counts, near @ counts))[-1]]
        members = left & (np.abs(lags - level) <= _SPREAD)
        found[members], left = level, left & ~members
    return found, np.unique(found, return_inverse=True)[1]


def _fitted(
    correlations: LagCorrelations,
    links: tuple[NDArray[np.intp], NDArray[np.intp]],
    start: tuple[NDArray[np.intp], NDArray[np.intp]],
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Fit the lag of each group to the correlations of its links, in turn."""
    lags, groups = start[0].copy(), start[1]
    i, j = links
    for _ in range(_MAX_ROUNDS):
        changed = False
        for group in np.unique(groups).tolist():
            begins, ends = groups[i] == group, groups[j] == group
            leaving, arriving = begins & ~ends, ends & ~begins
            if not (leaving.any() or arriving.any()):
                continue
            steps = np.arange(-MAX_LAG, MAX_LAG + 1)
            sums = np.zeros(steps.size)
            for part, sign in ((leaving, -1), (arriving, 1)):
                apart = (lags[j] - lags[i])[part] + sign * steps[:, None]
                sums += correlations.at(apart, i[part], j[part]).sum(axis=1)
            best = steps[np.lexsort((-np.abs(steps), sums.round(6)))[-1]]
            if best:
                lags[groups == group] += best
                changed = True
        if not changed:
            break
    return lags - _most_frequent(lags), groups


def _check(fit: _Fit) -> float | None:
    """Return the agreement of links with the lags of their groups; None if there are no lags."""
    i, j = fit.links
    whole, expected = fit.whole, fit.expected
    across = expected != 0
    if not across.any() or fit.lags.size < _MIN_GROUP * np.unique(fit.groups).size:
        return None
    own = whole.peak_lag[i, j]
    slack = np.maximum(1, 0.15 * np.abs(expected))
    weight = whole.peak[i, j].astype(np.float64) ** 2  # weak links have random lags
    agreement = _share(np.abs(own - expected) <= slack, weight * across)
    opposite = _share(np.sign(own) == -np.sign(expected), weight * across)
    within = _share(np.abs(own) <= 1, weight * ~across) if not across.all() else 1.0
    cost = _cost_of_lags(whole, i[~across], j[~across])
    expected_gain = float(
        (whole.peak[i, j] * cost[np.minimum(np.abs(expected), MAX_LAG)])[across].sum()
    )
    if (
        fit.restored()[0] < _MIN_GAIN * expected_gain
        or agreement < max(_MIN_AGREEMENT, _MIN_RELATIVE * within)
        or opposite > _MAX_OPPOSITE
        or within < _MIN_WITHIN
        or not fit.explains(_MIN_EXPLAINED)
    ):
        return None
    return agreement if all(share >= _MIN_AGAIN for share in fit.found_again()) else None


def _share(marked: NDArray[np.bool_], weight: NDArray[np.float64]) -> float:
    return float(np.sum(weight * marked) / max(float(weight.sum()), 1e-300))


def _cost_of_lags(
    correlations: LagCorrelations, i: NDArray[np.intp], j: NDArray[np.intp]
) -> NDArray[np.float64]:
    """Return the share of correlation that links within groups lose at each lag from 0 on."""
    if not i.size:
        return np.zeros(MAX_LAG + 1)
    course = (correlations.at_lag[:, i, j], correlations.at_lag[:, j, i])
    both = np.asarray(np.mean(course, axis=(0, 2), dtype=np.float64))
    return np.asarray(1 - both / max(float(both[0]), 1e-12))


def _extended(
    values: NDArray[Any],
    varying: NDArray[np.intp],
    chosen: NDArray[np.intp],
    lags: NDArray[np.intp],
) -> NDArray[np.intp]:
    """Give each other sensor the lag at which it resembles one of the chosen sensors most."""
    ranks = standardised(rank_columns(columns(values), values.shape))
    aligned = align(ranks[:, chosen], lags[chosen])
    start = -int(lags[chosen].min())
    n_frames = len(aligned) - 2 * MAX_LAG
    others = np.setdiff1d(varying, chosen)
    best = np.full(others.size, -np.inf)
    result = lags.copy()
    for lag in np.unique(lags[chosen]).tolist():
        begin = MAX_LAG + start - start + lag - int(lags[chosen].min())
        part = ranks[begin : begin + n_frames, :][:, others]
        if len(part) < n_frames:
            continue
        match = (part.T @ aligned[MAX_LAG : MAX_LAG + n_frames]).max(axis=1)
        result[others[match > best]] = lag
        best = np.maximum(best, match)
    return result


def _most_frequent(lags: NDArray[np.intp]) -> int:
    levels, counts = np.unique(lags, return_counts=True)
    return int(levels[counts.argmax()])
