"""Lags: groups of channels, such as boards, that are read some frames later than others."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import rfft

from anisomap.health.recording_faults import Found
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.numerics.columns import ranked
from anisomap.numerics.neighbours import tree_edges
from anisomap.numerics.reliability.sampling_noise import sampling_variance
from anisomap.numerics.signals import (
    count_contacts,
    excerpt_frames,
    normal_maximum,
    some_sensors,
    standardised,
)
from anisomap.recording import Recording

_MAX_LAG = 40  # greatest lag that is searched, in frames; chosen by hand
_PIECE = 128  # frames whose spectra are multiplied
_N_PARTNERS = 6  # most similar sensors of each sensor, whose lags are compared
_MAX_VALUES = 1 << 19  # readings of an excerpt; chosen for about half a second
_MIN_SENSORS, _MAX_SENSORS = 8, 128  # compared; the others take the lag of the most similar one
_CHANGE_COST = 4.0  # of a new lag along the channels, in frames of misfit; tuned on seeds 1 and 2
_MAX_MISFIT = 6.0  # frames of misfit of one sensor that count
_SPREAD = 2  # frames by which the lags of a group may differ before they are made equal
# Limits of a finding; others decide nothing on 373 recordings of `benchmarks.verdicts.faults`,
# seeds 301 and 302.
_MIN_RELATIVE = 0.93  # share of links with the lag of their groups: between groups over within
_MIN_AGAIN = 0.9  # share of the links for which each part of the recording gives the same lags
_MIN_OWN = 0.9  # share of the sensors whose lag, fitted alone, is exactly that of their group
# Of lags that are named, but not mended, since single sensors do not show them exactly.
_LIKELY_OWN, _LIKELY_RELATIVE, _LIKELY_AGAIN, _LIKELY_GROUP = 0.7, 0.95, 0.95, 12.0
_MIN_GAIN = 0.8  # correlation restored, over what equal lags would cost links within groups
_MIN_GROUP = 3.0  # sensors per group, on average
_CLEARLY_MORE = 1.005  # correlation by which groups that are not adjacent must explain more
_MAX_ROUNDS = 3  # of the fit of lags
_UNCLEAR, _LIKELY, _EXACT = range(3)
_STEPS = np.array([[0], *([s * lag] for lag in range(1, _MAX_LAG + 1) for s in (1, -1))])  # by size


def find_lags(recording: Recording) -> Iterator[Found]:
    """Find groups of sensors that lag.

    Ranks of the readings are correlated at all lags up to 40 frames. The lags of the strongest
    links, a spanning tree, give a lag to each sensor. Groups are sensors with nearly equal lags
    that follow each other in the order of the channels, or, if that explains less, wherever they
    are. The lags of groups and those of single sensors are fitted in turn.

    Moving contacts and waves also delay sensors relative to their neighbours, but these lags differ
    from sensor to sensor, and from one time to another. A lag of the read-out is the same in all
    parts of the recording, and nine in ten sensors have exactly the lag of their group. It must
    also restore about as much correlation as a lag of its size costs the links within groups.
    Where seven in ten sensors show it alone, few lags of many sensors are named, but not mended.
    Sensors with fewer than 5 contacts in a half of the recording are not compared, since places
    that are pressed one after another in the same way also differ by a lag.
    """
    halves = [count_contacts(half) for half in np.array_split(recording.signals.touched, 2)]
    judged = np.flatnonzero(np.min(halves, axis=0) >= MIN_CONTACTS)
    touched = np.flatnonzero(np.max(halves, axis=0))
    lags, clarity = _lags(recording.readings, touched, judged)
    if lags.any():
        values = {"lags": np.unique(lags[lags != 0]).tolist(), "lost": int(np.ptp(lags))}
        exact = clarity == _EXACT and _is_of_boards(lags[touched])
        mend = (lambda recording: _shifted(recording, lags)) if exact else None
        yield Found(np.flatnonzero(lags), float(np.abs(lags).max()), values, mend)


def _is_of_boards(lags: NDArray[np.intp]) -> bool:
    """Return whether one group of sensors lags, or runs of channels.

    A body that rolls at an even pace delays sensors regardless of the order of the channels.
    """
    n_runs = 1 + np.count_nonzero(np.diff(lags))
    return np.unique(lags).size <= 2 or bool(n_runs * _MIN_GROUP <= lags.size)


def _shifted(recording: Recording, lags: NDArray[np.intp]) -> Recording:
    readings, times = _aligned(recording.readings, lags), recording.times
    times = None if times is None else times[: len(readings)]
    return replace(recording, readings=readings, times=times)


def _aligned(readings: NDArray[Any], lags: NDArray[np.intp]) -> NDArray[Any]:
    """Shift sensors in time by their lags, and leave out frames that some sensors lack.

    readings (T, N) -> (T - max(lags) + min(lags), N).
    """
    n_frames = len(readings) - int(np.ptp(lags))
    if n_frames == len(readings):
        return readings
    shifted = np.empty((n_frames, readings.shape[1]), dtype=readings.dtype)
    for lag in np.unique(lags).tolist():
        start = lag - int(lags.min())
        shifted[:, lags == lag] = readings[start : start + n_frames][:, lags == lag]
    return shifted


def _lags(
    readings: NDArray[Any], touched: NDArray[np.intp], judged: NDArray[np.intp]
) -> tuple[NDArray[np.intp], int]:
    """Return the lag of each sensor, 0 unless lags are clear, and how clear they are.

    touched, judged: Numbers of sensors; those touched but not judged take the lag of a judged one.
    """
    lags = np.zeros(readings.shape[1], dtype=np.intp)
    chosen = judged[some_sensors(judged.size, _MAX_SENSORS)]
    part = readings[excerpt_frames(readings, max(1024, _MAX_VALUES // max(1, chosen.size)))]
    if chosen.size < _MIN_SENSORS or len(part) < 8 * _MAX_LAG:
        return lags, _UNCLEAR
    fit = _Fit.of(part[:, chosen]).of_related_groups()
    clarity = fit.clarity()
    if clarity == _UNCLEAR:
        return lags, clarity
    lags[chosen] = fit.lags
    if chosen.size < touched.size:
        lags = _extended(part, touched, chosen, lags)
    lags[touched] -= _most_frequent(lags[touched])
    return lags, clarity


def _correlations(parts: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Correlate i(t) and j(t + lag) of all pairs, lags from 0 on, (lags, n, n). parts (t, n).

    Spectra of short pieces are multiplied, which takes half the time of one product for each lag.
    """
    n_frames, n_sensors = parts[0].shape
    step = _PIECE - _MAX_LAG
    # Zeros between the parts keep the frames of one from those of the next.
    gap = np.zeros((_MAX_LAG, n_sensors), dtype=np.float32)
    end = np.zeros((_MAX_LAG + -len(parts) * (n_frames + _MAX_LAG) % step, n_sensors), np.float32)
    joined = np.concatenate([*(block for part in parts for block in (part, gap)), end])
    pieces = np.lib.stride_tricks.sliding_window_view(joined, _PIECE, axis=0)[::step].copy()
    later = rfft(pieces, axis=2)
    pieces[:, :, step:] = 0
    earlier = rfft(pieces, axis=2)
    products = earlier.transpose(2, 1, 0).conj() @ later.transpose(2, 0, 1)
    frequencies, lags = np.arange(len(products)), np.arange(_MAX_LAG + 1)
    # Each frequency but the first and the last stands for its negative, too.
    weight = np.where((frequencies > 0) & (2 * frequencies < _PIECE), 2, 1) / _PIECE
    waves = weight * np.exp(2j * np.pi / _PIECE * np.outer(lags, frequencies))
    sums = (waves.astype(np.complex64) @ products.reshape(len(products), -1)).real
    counts = len(parts) * (n_frames - lags).astype(np.float32)
    found = np.asarray(sums / counts[:, None]).reshape(lags.size, n_sensors, n_sensors)
    found[:, np.arange(n_sensors), np.arange(n_sensors)] = -1
    return found


def _highest(
    correlations: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Return the highest correlation of each pair, and its lag; the smallest of equal ones."""
    peak = correlations[0].copy()
    peak_lag = np.zeros(peak.shape, dtype=np.intp)
    for lag, later in enumerate(correlations[1:], 1):
        for signed, found in ((lag, later), (-lag, later.T)):
            higher = found > peak
            np.copyto(peak, found, where=higher)
            peak_lag[higher] = signed
    return peak, peak_lag


@dataclass(frozen=True, eq=False)
class _Fit:
    """Lags of n sensors and their groups, which restore most of the correlation of the links.

    parts: Standardised ranks of each part of the recording.
    i, j (P,): Links: each sensor, and those that it is most similar to at any lag.
    curves (P, lags): Their correlations at lags from -40 to 40.
    peak, peak_lag (P,): Highest correlations, and their lags.
    """

    parts: list[NDArray[np.float32]]
    i: NDArray[np.intp]
    j: NDArray[np.intp]
    curves: NDArray[np.float32]
    peak: NDArray[np.float32]
    peak_lag: NDArray[np.intp]
    lags: NDArray[np.intp]
    groups: NDArray[np.intp]

    @classmethod
    def of(cls, values: NDArray[Any]) -> _Fit:
        """Fit lags to readings of shape (T, n)."""
        ranks = ranked(values)
        n_parts = int(np.clip(len(ranks) // (10 * _MAX_LAG), 2, 4))
        equal = ranks[: len(ranks) // n_parts * n_parts]
        parts = [standardised(part) for part in np.split(equal, n_parts)]
        whole = _correlations(parts)
        peak, peak_lag = _highest(whole)
        count = min(_N_PARTNERS, len(peak) - 1)
        j = np.argsort(-peak, axis=1, kind="stable")[:, :count].ravel()
        i = np.repeat(np.arange(len(peak)), count)
        tree = np.zeros(len(peak), dtype=np.intp)
        for new, joined in tree_edges(peak):
            tree[new] = tree[joined] + peak_lag[joined, new]
        tree -= int(np.median(tree))
        curves = _along(whole, i, j)
        fit = cls(parts, i, j, curves, peak[i, j], peak_lag[i, j], tree, np.arange(tree.size))
        for _ in range(_MAX_ROUNDS):
            before, fit = fit.lags, fit._grouped()
            if (fit.lags == before).all():
                break
        return fit

    def _grouped(self) -> _Fit:
        """Group sensors by the lag that each has by itself, and fit the lags of the groups."""
        own = self._of_single_sensors()

        def fitted(start: tuple[NDArray[np.intp], NDArray[np.intp]]) -> tuple[_Fit, float]:
            fit = replace(self, lags=start[0], groups=start[1])
            fit = replace(fit, lags=fit.refitted(fit.curves))
            return fit, float(_at(fit.curves, fit.expected).sum())

        anywhere, most = fitted(_anywhere(own))
        in_order, best = fitted(_in_order(own))
        fewer = np.unique(anywhere.groups).size < np.unique(in_order.groups).size
        return anywhere if most >= (1 if fewer else _CLEARLY_MORE) * best else in_order

    def _of_single_sensors(self) -> NDArray[np.intp]:
        """Fit the lag of each sensor by itself, (n,), from those of the groups."""
        own = replace(self, groups=np.arange(self.lags.size)).refitted(self.curves)
        return own - _most_frequent(own - self.lags)

    def refitted(self, curves: NDArray[np.float32]) -> NDArray[np.intp]:
        """Fit the lag of each group to the correlations of its links, in turn."""
        lags, groups = self.lags.copy(), self.groups
        # Links to other groups, seen from either end, by the group at that end.
        own, other = np.concatenate([self.i, self.j]), np.concatenate([self.j, self.i])
        order = np.argsort(groups[own], kind="stable")
        order = order[groups[own[order]] != groups[other[order]]]
        own, other = own[order], other[order]
        values = np.concatenate([curves[:, ::-1], curves])[order].ravel()
        middles = np.arange(order.size) * (2 * _MAX_LAG + 1) + _MAX_LAG
        edges = np.searchsorted(groups[own], np.arange(groups.max() + 2)).tolist()
        due = np.ones(len(edges) - 1, dtype=bool)  # unless nothing beside a group moved since
        for _ in range(_MAX_ROUNDS):
            for group in range(due.size):
                if not due[group]:
                    continue
                links = slice(edges[group], edges[group + 1])
                at = lags[own[links]] - lags[other[links]] + _STEPS
                at = np.maximum(np.minimum(at, _MAX_LAG), -_MAX_LAG) + middles[links]
                step = _STEPS[values.take(at).sum(axis=1).round(6).argmax(), 0]
                due[group] = step != 0
                if step:
                    lags[groups == group] += step
                    due[groups[other[links]]] = True
        return lags - _most_frequent(lags)

    @property
    def expected(self) -> NDArray[np.intp]:
        """Lag of each link."""
        return np.asarray(self.lags[self.j] - self.lags[self.i])

    def of_related_groups(self) -> _Fit:
        """Set the lags of groups without a significant link to other groups to 0.

        The highest correlation at any lag, of any of their links, must be one that unrelated
        readings with the same autocorrelations reach with probability 1 %.
        """
        if not self.lags.any():
            return self
        variance = sampling_variance(np.concatenate(self.parts))[self.i, self.j]
        across = self.groups[self.i] != self.groups[self.j]
        ends = np.concatenate([self.groups[end][across] for end in (self.i, self.j)])
        count = np.bincount(ends, minlength=int(self.groups.max()) + 1)
        strongest = np.zeros(count.size)
        np.maximum.at(strongest, ends, np.tile((self.peak / np.sqrt(variance))[across], 2))
        related = strongest > normal_maximum(count * (2 * _MAX_LAG + 1))
        return replace(self, lags=np.where(related[self.groups], self.lags, 0))

    def found_again(self) -> Iterator[float]:
        """Yield the share of the links for which each part of the recording gives the same lags."""
        across = self.expected != 0
        for part in self.parts:
            again = self.refitted(_along(_correlations([part]), self.i, self.j))
            apart = again[self.j] - again[self.i] - self.expected
            yield float(np.mean(np.abs(apart)[across] <= 1))

    def clarity(self) -> int:
        """Return how far the links agree with the lags of their groups."""
        own, expected = self.peak_lag, self.expected
        across = expected != 0
        if not across.any() or self.lags.size < _MIN_GROUP * np.unique(self.groups).size:
            return _UNCLEAR
        slack = np.maximum(1, 0.15 * np.abs(expected))
        weight = self.peak.astype(np.float64) ** 2  # weak links have random lags
        agreement = _share(np.abs(own - expected) <= slack, weight * across)
        within, cost = 1.0, np.zeros(_MAX_LAG + 1)
        if not across.all():
            within = _share(np.abs(own) <= 1, weight * ~across)
            # The share of correlation that links within groups lose at each lag.
            kept = self.curves[~across].mean(axis=0, dtype=np.float64)
            kept = kept[_MAX_LAG:] + kept[_MAX_LAG::-1]
            cost = 1 - kept / max(float(kept[0]), 1e-12)
        gain = (self.peak * cost[np.minimum(np.abs(expected), _MAX_LAG)])[across].sum()
        without = self.curves[across, _MAX_LAG]
        restored = (_at(self.curves, expected)[across] - without).sum()
        alone = float(np.mean(self._of_single_sensors() == self.lags))
        if alone < _LIKELY_OWN or restored < _MIN_GAIN * gain or agreement < _MIN_RELATIVE * within:
            return _UNCLEAR
        again = min(self.found_again())
        if alone >= _MIN_OWN and again >= _MIN_AGAIN:
            return _EXACT
        likely = agreement >= _LIKELY_RELATIVE * within and again >= _LIKELY_AGAIN
        large = self.lags.size >= _LIKELY_GROUP * np.unique(self.lags).size
        return _LIKELY if likely and large else _UNCLEAR


def _along(
    correlations: NDArray[np.float32], i: NDArray[np.intp], j: NDArray[np.intp]
) -> NDArray[np.float32]:
    """Return the correlations of links at lags of either sign, (P, lags)."""
    return np.concatenate([correlations[:0:-1, j, i], correlations[:, i, j]]).T


def _at(curves: NDArray[np.float32], lags: NDArray[np.intp]) -> NDArray[np.float32]:
    """Return the correlations of links, (P, lags), at lags of shape (..., P)."""
    return curves[np.arange(len(curves)), np.clip(lags, -_MAX_LAG, _MAX_LAG) + _MAX_LAG]


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


def _share(marked: NDArray[np.bool_], weight: NDArray[np.float64]) -> float:
    return float(np.sum(weight * marked) / max(float(weight.sum()), 1e-300))


def _extended(
    values: NDArray[Any],
    touched: NDArray[np.intp],
    chosen: NDArray[np.intp],
    lags: NDArray[np.intp],
) -> NDArray[np.intp]:
    """Give each other sensor the lag at which it resembles one of the chosen sensors most."""
    ranks = standardised(ranked(values))
    aligned = _aligned(ranks[:, chosen], lags[chosen])
    n_frames = len(aligned) - 2 * _MAX_LAG
    others = np.setdiff1d(touched, chosen)
    best = np.full(others.size, -np.inf)
    result = lags.copy()
    for lag in np.unique(lags[chosen]).tolist():
        begin = _MAX_LAG + lag - int(lags[chosen].min())
        part = ranks[begin : begin + n_frames, others]
        match = (part.T @ aligned[_MAX_LAG : _MAX_LAG + n_frames]).max(axis=1)
        result[others[match > best]] = lag
        best = np.maximum(best, match)
    return result


def _most_frequent(lags: NDArray[np.intp]) -> int:
    levels, counts = np.unique(lags, return_counts=True)
    return int(levels[counts.argmax()])
