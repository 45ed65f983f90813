"""Leaks: each channel contains a share of the channel read before it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, ndtr

from anisomap.health.recording_faults import Found, in_readings
from anisomap.numerics.columns import columns
from anisomap.numerics.signals import excerpt_frames
from anisomap.numerics.similarity.rest import Rest
from anisomap.recording import Recording

_LEVEL = 1e-4  # of the sign test: the probability of a false finding
_QUANTILES = (0.05, 0.25)  # the lower edge of wide contacts, and of brief ones
_MIN_FRAMES = 20  # of strong contact; chosen by hand
_MAX_FRAMES = 2000  # of strong contact that are used, for speed
_MAX_EXCERPT = 16384  # frames
_MAX_CHANNELS = 256  # the first ones, in which a leak is searched for
_MIN_LEVELS = 8  # distinct values, for a share to be visible
_MAX_SHARE = 0.6  # above, a leak cannot be told from a copy; chosen by hand
_APART = range(6, 26)  # differences of channels between which nothing leaks; chosen by hand
_TOLERANCE = 1e-4  # of a share computed from readings without noise, stored as float32


def find_leak(recording: Recording) -> Iterator[Found]:
    """Find a leak from each channel to the next.

    Contacts only add to readings. Hence, while channel i - 1 is in contact, the lowest readings of
    channel i in units of i - 1 estimate the share that leaks. Neighbours on the skin raise this
    share in both directions alike, and a leak in one direction: a sign test of the differences
    tells them apart. If the order of channels follows the skin, contacts raise even the lowest
    readings, and a leak is not found. Differences of adjacent pairs then also depend on each other,
    since one contact reaches several of them: those of channels that are further apart, between
    which nothing leaks, show by how much more their sum varies than that of independent ones. The
    reading that leaks is that of the previous channel with or without its own leak, whichever
    repair leaves less of earlier channels.
    """
    n_sensors = min(recording.n_sensors, _MAX_CHANNELS)
    excerpt = recording.readings[excerpt_frames(recording.readings, _MAX_EXCERPT), :n_sensors]
    rest = recording.signals.rest
    depths = _Depths(excerpt, rest)
    for gains in depths.compare(1):
        start, n_pairs = float(np.median(gains)), np.count_nonzero(gains)
        n_forward = np.count_nonzero(gains > 0)
        # One-sided binomial test.
        if not 0 < start < _MAX_SHARE or bdtrc(n_forward - 1, n_pairs, 0.5) > _LEVEL:
            continue
        if ndtr(-_score(gains) / depths.excess(start)) > _LEVEL:
            continue
        share, error = depths.share(start)
        if not share > 0:
            return
        left = [
            _asymmetry(remove_leak(rest, share, error, chained, excerpt), rest)
            for chained in (False, True)
        ]
        yield Found(
            range(1, recording.n_sensors),
            share,
            f"{share:.1%} of each channel leaks into the next, in {n_forward} of {n_pairs} pairs "
            "and not backwards",
            in_readings(partial(remove_leak, rest, share, error, left[1] < left[0])),
        )
        return


def remove_leak(
    rest: Rest, share: float, error: float, chained: bool, readings: NDArray[Any]
) -> NDArray[Any]:
    """Subtract a leak; if chained, of channels with their own leak. readings (T, N) -> (T, N)."""
    mended = np.array(readings)
    values = rest.value.astype(readings.dtype)
    for i in range(1, readings.shape[1]):
        source = readings if chained else mended
        leaked = share * (source[:, i - 1] - values[i - 1])
        mended[:, i] -= leaked
        slack = np.abs(leaked) * max(3 * error / share, _TOLERANCE)
        at_rest = (np.abs(mended[:, i] - values[i]) <= slack) & (leaked != 0)
        mended[at_rest, i] = values[i]
    return mended


def _is_visible(column: NDArray[Any]) -> bool:
    """Return whether a sensor has enough distinct values to show a share of another."""
    some = column[:: max(1, len(column) // 2048)]
    return any(np.unique(part).size >= _MIN_LEVELS for part in (some[: _MIN_LEVELS**2], some))


class _Depths:
    """Depths of contact of the channels, computed channel by channel."""

    def __init__(self, readings: NDArray[Any], rest: Rest) -> None:
        self.rest = rest
        raised = zip(columns(readings), rest.side.astype(readings.dtype), strict=False)
        self.raised = [column * side for column, side in raised]  # by contact
        self.bounds = rest.side * rest.bounds(readings.dtype)
        self.visible = [_is_visible(column) for column in self.raised]
        self.frames = cache(self._frames)

    def depth(self, i: int, frames: NDArray[np.intp]) -> NDArray[np.float64]:
        """Return the depths of a channel in some frames."""
        return np.asarray(self.raised[i][frames] - self.rest.side[i] * self.rest.value[i])

    def _frames(
        self, i: int
    ) -> tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.intp]] | None:
        """Return frames of strong contact, depths there, and frames of rest; None if few."""
        if not self.visible[i]:
            return None
        raised = self.raised[i]
        touched = raised >= self.bounds[i]
        quiet, reached = np.flatnonzero(~touched), raised[touched]
        if reached.size < 2 * _MIN_FRAMES or quiet.size < _MIN_FRAMES:
            return None
        deep = _thinned(np.flatnonzero(raised >= np.sort(reached)[reached.size // 2]))
        return deep, self.depth(i, deep), _thinned(quiet)

    def ratios(
        self, i: int, source: int, quantiles: Sequence[float]
    ) -> list[NDArray[np.float64]] | None:
        """Return channel i minus each of its quantiles at rest, in units of the source's depth.

        In frames of strong contact with the source. None if frames or distinct values are too few.
        """
        frames = self.frames(source)
        if frames is None or not self.visible[i]:
            return None
        deep, depth, quiet = frames
        touched, levels = self.depth(i, deep), _quantiles(self.depth(i, quiet), quantiles)
        return [(touched - level) / depth for level in levels]

    def compare(self, offset: int) -> NDArray[np.float64]:
        """Return the gain forward minus the gain backward of channels `offset` apart, (2, P).

        A row for each of `_QUANTILES`.
        """
        found = []
        for i in range(offset, len(self.raised)):
            forward = self.ratios(i, i - offset, _QUANTILES)
            backward = self.ratios(i - offset, i, _QUANTILES)
            if forward is not None and backward is not None:
                ends = zip(_QUANTILES, forward, backward, strict=True)
                found.append([_quantile(one, q) - _quantile(other, q) for q, one, other in ends])
        gains = np.array(found or [[0.0] * len(_QUANTILES)]).T
        return np.where(np.abs(gains) < _TOLERANCE, 0, gains)

    def excess(self, share: float) -> float:
        """Return the deviation of the scores of channels between which nothing leaks, at least 1.

        share: A leak of channels with their own leak passes on a share of a share.
        """
        scores = [
            min(abs(_score(gains)), abs(_score(gains - share**offset)))
            for offset in _APART
            if offset < len(self.raised) - 1
            for gains in self.compare(offset)
        ]
        return max(1.0, float(np.median(scores or [0])) / 0.6745)

    def share(self, start: float) -> tuple[float, float]:
        """Return the most frequent ratio of adjacent channels near a first one, and its error."""
        ratios = [self.ratios(i, i - 1, (0.5,)) for i in range(1, len(self.raised))]
        pooled = np.sort(np.concatenate([one[0] for one in ratios if one is not None]))
        near = pooled[(pooled > 0.3 * start) & (pooled < 2.5 * start)]
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


def _score(gains: NDArray[np.float64]) -> float:
    """Return the score of a sign test, of unit variance if the gains, (P,), are independent."""
    signs = np.sign(gains[gains != 0])
    return float(signs.sum() / np.sqrt(max(1, signs.size)))


def _asymmetry(readings: NDArray[Any], rest: Rest) -> float:
    """Return how much more channels contain of earlier than of later ones."""
    depths = _Depths(readings, rest)
    return sum(
        abs(float(np.mean(np.sign(gains)))) for offset in (1, 2) for gains in depths.compare(offset)
    )


def _densest(values: NDArray[np.float64]) -> float:
    """Return the median of that tenth of sorted values whose ends have the smallest ratio."""
    count = max(_MIN_FRAMES, values.size // 10)
    if values.size <= count:
        return float(np.median(values)) if values.size else 0.0
    logarithm = np.log(values)
    begin = int(np.argmin(logarithm[count:] - logarithm[:-count]))
    return float(np.median(values[begin : begin + count + 1]))


def _quantile(values: NDArray[np.float64], level: float) -> float:
    return _quantiles(values, (level,))[0]


def _quantiles(values: NDArray[np.float64], levels: Sequence[float]) -> list[float]:
    """Return the values of the nearest ranks; interpolation takes several times as long."""
    places = [round(level * (values.size - 1)) for level in levels]
    values.partition(places)
    return [float(values[place]) for place in places]


def _thinned(frames: NDArray[np.intp]) -> NDArray[np.intp]:
    return frames[:: max(1, -(-frames.size // _MAX_FRAMES))]
