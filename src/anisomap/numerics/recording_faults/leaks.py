"""Leaks: each channel contains a share of the channel read before it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from anisomap.numerics.columns import columns
from anisomap.numerics.signals import middle_frames, some_sensors
from anisomap.numerics.similarity.rest import estimate_rest

LEVEL = 1e-4
"""Level of the sign test: the probability of a false finding."""

_QUANTILES = (0.05, 0.25)  # the lower edge of wide contacts, and of brief ones
_OTHER_OFFSETS = (2, 3, 5, 7)  # channels between which nothing leaks, for comparison
_MIN_FRAMES = 20  # of strong contact; chosen by hand
_MAX_FRAMES = 2000  # of strong contact that are used, for speed
_MAX_EXCERPT = 16384  # frames
_MAX_CHANNELS = 256  # the first ones, in which a leak is searched
# Pairs that are compared first, and the least excess, as a share of them, of those with more signal
# in the later channel over those with less; chosen by hand. Leaks of 5 % gave .5 and more.
_MIN_SCREENED, _MIN_FORWARD = 32, 0.2
_MIN_LEVELS = 8  # distinct values, for a share to be visible
_MAX_SHARE = 0.6  # above, a leak cannot be told from a copy; chosen by hand
_TOLERANCE = 1e-4  # of a share computed from readings without noise, stored as float32


@dataclass(frozen=True, eq=False)
class Leak:
    """A leak from each channel to the next.

    share: Share of the previous reading beyond rest that is added.
    error: Its uncertainty.
    n_pairs, n_forward: Pairs of adjacent channels that were compared, and those with more signal in
        the later one.
    chained: Whether what leaks is the reading of the previous channel including its own leak.
    """

    share: float
    error: float
    n_pairs: int
    n_forward: int
    chained: bool


def find_leak(readings: NDArray[Any]) -> Leak | None:
    """Find a leak from each channel to the next.

    readings (T, N).

    Contacts only add to readings. Hence, while channel i - 1 is in contact, the lowest readings of
    channel i in units of i - 1 estimate the share that leaks. Neighbours on the skin raise it in
    both directions alike, a leak in one: the signs of the differences are tested. They must also
    exceed those of channels that are further apart in order. Where the order follows the skin, most
    lowest readings are due to contacts, and a leak is not found.
    """
    n_sensors = readings.shape[1]
    n_sensors = min(n_sensors, _MAX_CHANNELS)
    excerpt = readings[middle_frames(len(readings), _MAX_EXCERPT), :n_sensors]
    if n_sensors <= max(_OTHER_OFFSETS):
        return None
    last = some_sensors(n_sensors - max(_OTHER_OFFSETS)) + max(_OTHER_OFFSETS)
    depths = _Depths(excerpt)
    some = last[:: max(1, last.size // _MIN_SCREENED)]
    for quantile in _QUANTILES:
        if np.mean(np.sign(depths.compare(some, 1, quantile))) < _MIN_FORWARD:
            continue
        gains = depths.compare(last, 1, quantile)
        clear = gains[np.abs(gains) > 0]
        if not clear.size or not 0 < np.median(gains) < _MAX_SHARE:
            continue
        n_forward = int(np.count_nonzero(clear > 0))
        if bdtrc(n_forward - 1, clear.size, 0.5) > LEVEL:  # one-sided binomial test
            continue
        beyond = [np.median(depths.compare(last, k, quantile)) for k in _OTHER_OFFSETS]
        if np.median(gains) < 2 * max(map(abs, beyond)):
            continue
        start = float(np.median(gains))
        trials = [depths.share(last, start, limit) for limit in (2.5 * start, _MAX_SHARE)]
        found = [
            Leak(share, error, clear.size, n_forward, chained)
            for share, error in trials
            for chained in (False, True)
            if share > 0
        ]
        return min(found, key=lambda leak: _asymmetry(excerpt, leak, last), default=None)
    return None


def remove_leak(readings: NDArray[Any], leak: Leak) -> NDArray[Any]:
    """Subtract a leak. readings (T, N) -> (T, N)."""
    mended = np.array(readings)
    rest = estimate_rest(readings[:: -(-len(readings) // _MAX_EXCERPT)]).value.astype(
        readings.dtype
    )
    for i in range(1, readings.shape[1]):
        source = readings if leak.chained else mended
        leaked = leak.share * (source[:, i - 1] - rest[i - 1])
        mended[:, i] -= leaked
        slack = np.abs(leaked) * max(3 * leak.error / leak.share, _TOLERANCE)
        at_rest = (np.abs(mended[:, i] - rest[i]) <= slack) & (leaked != 0)
        mended[at_rest, i] = rest[i]
    return mended


def _is_visible(column: NDArray[Any]) -> bool:
    """Return whether a sensor has enough distinct values to show a share of another."""
    some = column[:: max(1, len(column) // 2048)]
    return any(np.unique(part).size >= _MIN_LEVELS for part in (some[: _MIN_LEVELS**2], some))


class _Depths:
    """Depths of contact of the channels, computed channel by channel."""

    def __init__(self, readings: NDArray[Any]) -> None:
        self.columns = list(columns(readings))
        self.visible = [_is_visible(column) for column in self.columns]
        self.depths: dict[int, tuple[NDArray[np.float64], float]] = {}
        self.strong: dict[int, tuple[NDArray[np.intp], NDArray[np.intp]] | None] = {}

    def depth(self, i: int) -> tuple[NDArray[np.float64], float]:
        """Return the excess of a channel over rest, and what of it is noise."""
        if i not in self.depths:
            column = self.columns[i]
            rest = estimate_rest(column[:, None])
            depth = (column.astype(np.float64) - rest.value) * rest.side
            self.depths[i] = depth, float(rest.threshold[0])
        return self.depths[i]

    def frames(self, i: int) -> tuple[NDArray[np.intp], NDArray[np.intp]] | None:
        """Return the frames of strong contact and of rest of a channel; None if there are few."""
        if i not in self.strong:
            self.strong[i] = None
            if not self.visible[i]:
                return None
            depth, threshold = self.depth(i)
            touched = depth > threshold
            if np.count_nonzero(touched) >= 2 * _MIN_FRAMES:
                deep = np.flatnonzero(depth >= np.median(depth[touched]))
                quiet = np.flatnonzero(~touched)
                if quiet.size >= _MIN_FRAMES:
                    self.strong[i] = (_thinned(deep), _thinned(quiet))
        return self.strong[i]

    def lowest(self, i: int, source: int, quantile: float) -> float:
        """Return a low quantile of channel i in units of another while that is in contact."""
        frames = self.frames(source)
        if frames is None or not self.visible[i]:
            return np.nan
        deep, quiet = frames
        mine = self.depth(i)[0]
        noise = _quantile(mine[quiet], quantile)
        ratios = (mine[deep] - noise) / self.depth(source)[0][deep]
        return _quantile(ratios, quantile)

    def compare(self, last: NDArray[np.intp], offset: int, quantile: float) -> NDArray[np.float64]:
        """Return the gain forward minus the gain backward of channels `offset` apart."""
        both = [
            self.lowest(i, i - offset, quantile) - self.lowest(i - offset, i, quantile)
            for i in last.tolist()
        ]
        found = np.array([gain for gain in both if np.isfinite(gain)])
        return np.where(np.abs(found) < _TOLERANCE, 0, found) if found.size else np.zeros(1)

    def share(self, last: NDArray[np.intp], start: float, limit: float) -> tuple[float, float]:
        """Return the most frequent ratio of adjacent channels near a first estimate."""
        ratios = []
        for i in last.tolist():
            frames = self.frames(i - 1)
            if frames is not None and self.visible[i]:
                deep, quiet = frames
                mine = self.depth(i)[0]
                noise = np.median(mine[quiet])
                ratios.append((mine[deep] - noise) / self.depth(i - 1)[0][deep])
        pooled = np.sort(np.concatenate(ratios))
        near = pooled[(pooled > 0.3 * start) & (pooled < limit)]
        share = _densest(near)
        for _ in range(3):
            width = 3 * np.median(np.abs(near - share)) / 0.6745
            inside = near[np.abs(near - share) <= max(min(width, 0.5 * share), _TOLERANCE * share)]
            if inside.size < _MIN_FRAMES:
                break
            centre = float(np.median(inside))
            if abs(centre - share) > 0.2 * share:
                break  # contacts outweigh the leak: keep the mode
            share, near = centre, inside
        return share, float(np.std(near) / np.sqrt(max(1, near.size)))


def _asymmetry(readings: NDArray[Any], leak: Leak, last: NDArray[np.intp]) -> float:
    """Return how much more channels contain of earlier than of later ones without a leak."""
    depths = _Depths(remove_leak(readings, leak))
    return sum(
        abs(float(np.mean(np.sign(depths.compare(last, offset, quantile)))))
        for offset in (1, 2)
        for quantile in _QUANTILES
    )


def _densest(values: NDArray[np.float64]) -> float:
    """Return the middle of the narrowest interval, in proportion, of a tenth of sorted values."""
    count = max(_MIN_FRAMES, values.size // 10)
    if values.size <= count:
        return float(np.median(values)) if values.size else 0.0
    logarithm = np.log(values)
    begin = int(np.argmin(logarithm[count:] - logarithm[:-count]))
    return float(np.median(values[begin : begin + count + 1]))


def _quantile(values: NDArray[np.float64], level: float) -> float:
    """Return a quantile as `numpy.quantile` does, in a fifth of its time for few values."""
    place = level * (values.size - 1)
    below = int(place)
    above = min(below + 1, values.size - 1)
    ordered = np.partition(values, (below, above))
    low, high = float(ordered[below]), float(ordered[above])
    return low + (place - below) * (high - low)


def _thinned(frames: NDArray[np.intp]) -> NDArray[np.intp]:
    return frames[:: -(-frames.size // _MAX_FRAMES)] if frames.size else frames
