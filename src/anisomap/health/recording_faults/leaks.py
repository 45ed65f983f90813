"""Leaks: each channel contains a share of the preceding channel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc, ndtr

from anisomap.health.recording_faults import Found
from anisomap.numerics.columns import columns
from anisomap.numerics.signals import excerpt_frames
from anisomap.recording import Recording

_LEVEL = 1e-4  # of the sign test: the probability of a false finding
_QUANTILES = (0.05, 0.25)  # lowest readings during wide contacts, and during brief ones
_MIN_FRAMES = 20  # of strong contact; chosen by hand
_MAX_FRAMES = 2000  # of strong contact that are used, for speed
_MAX_EXCERPT = 16384  # frames
_MAX_CHANNELS = 256  # first channels, in which a leak is searched for
_MIN_LEVELS = 8  # distinct values, which resolve a share
_MAX_SHARE = 0.6  # a greater leak cannot be distinguished from a copy; chosen by hand
_APART = range(6, 26)  # differences of channels between which nothing leaks; chosen by hand
_TOLERANCE = 1e-4  # of a share computed from readings without noise, stored as float32


def find_leak(recording: Recording) -> Iterator[Found]:
    """Find a leak from each channel to the next.

    Contacts only add to readings. While channel i - 1 is in contact, the lowest ratio of channel i
    to channel i - 1 therefore estimates the share that leaks. Neighbours on the skin increase this
    share in both directions, a leak in one direction only: a sign test of the differences
    distinguishes them. If the order of channels follows the skin, contacts raise even the lowest
    readings, and a leak is not found. Differences of adjacent pairs are then also dependent, since
    one contact reaches several pairs. The excess variance of their sum is estimated from channels
    that are further apart, between which nothing leaks.
    """
    readings = recording.readings[excerpt_frames(recording.readings, _MAX_EXCERPT), :_MAX_CHANNELS]
    rest = recording.signals.rest
    sides = rest.side.astype(readings.dtype)
    each = zip(columns(readings), sides, sides * rest.value, rest.threshold, strict=False)
    channels = [_channel(side * column, value, limit) for column, side, value, limit in each]
    for quantile in _QUANTILES:
        gains = _gains(channels, 1, quantile)
        share, n_pairs = float(np.median(gains)), np.count_nonzero(gains)
        n_forward = np.count_nonzero(gains > 0)
        # One-sided binomial test.
        if not 0 < share < _MAX_SHARE or bdtrc(n_forward - 1, n_pairs, 0.5) > _LEVEL:
            continue
        if ndtr(-_score(gains) / _excess(channels, share)) <= _LEVEL:
            values = {"n_forward": n_forward, "n_pairs": n_pairs}
            yield Found(range(1, recording.n_sensors), share, values)
            return


class _Channel(NamedTuple):
    """Readings above rest, (T,), frames of strong contact, their depths, and frames at rest."""

    above: NDArray[Any]
    deep: NDArray[np.intp]
    depth: NDArray[np.float64]
    quiet: NDArray[np.intp]

    def lowest(self, source: _Channel, quantile: float) -> float:
        """Return a low quantile relative to the source, while the source is in strong contact."""
        level = _quantile(self.above[source.quiet], quantile)
        return _quantile((self.above[source.deep] - level) / source.depth, quantile)


def _channel(raised: NDArray[Any], rest: float, threshold: float) -> _Channel | None:
    """Examine readings that contact raises; None if frames or distinct values are too few."""
    some = raised[:: max(1, len(raised) // 2048)]
    if not any(np.unique(part).size >= _MIN_LEVELS for part in (some[: _MIN_LEVELS**2], some)):
        return None
    touched = np.subtract(raised, rest, dtype=np.float64) > threshold
    quiet, reached = np.flatnonzero(~touched), raised[touched]
    if reached.size < 2 * _MIN_FRAMES or quiet.size < _MIN_FRAMES:
        return None
    deep = _thinned(np.flatnonzero(raised >= np.sort(reached)[reached.size // 2]))
    return _Channel(raised, deep, raised[deep].astype(np.float64) - rest, _thinned(quiet))


def _gains(
    channels: Sequence[_Channel | None], offset: int, quantile: float
) -> NDArray[np.float64]:
    """Return forward minus backward gains of channels at a distance of `offset`, (P,)."""
    pairs = zip(channels, channels[offset:], strict=False)
    found = [
        later.lowest(earlier, quantile) - earlier.lowest(later, quantile)
        for earlier, later in pairs
        if earlier is not None and later is not None
    ]
    gains = np.array(found or [0.0])
    return np.where(np.abs(gains) < _TOLERANCE, 0, gains)


def _score(gains: NDArray[np.float64]) -> float:
    """Return the score of a sign test, of unit variance if the gains, (P,), are independent."""
    signs = np.sign(gains[gains != 0])
    return float(signs.sum() / np.sqrt(max(1, signs.size)))


def _excess(channels: Sequence[_Channel | None], share: float) -> float:
    """Return the standard deviation of scores of channels without leaks between them, at least 1.

    share: The leak. Since leaks accumulate, channels further apart contain powers of this share.
    """
    scores = [
        min(abs(_score(gains)), abs(_score(gains - share**offset)))
        for offset in _APART
        if offset < len(channels) - 1
        for gains in (_gains(channels, offset, quantile) for quantile in _QUANTILES)
    ]
    return max(1.0, float(np.median(scores or [0])) / 0.6745)


def _quantile(values: NDArray[Any], level: float) -> float:
    """Return the value of the nearest rank; interpolation takes several times as long."""
    place = round(level * (values.size - 1))
    return float(np.partition(values, place)[place])


def _thinned(frames: NDArray[np.intp]) -> NDArray[np.intp]:
    return frames[:: max(1, -(-frames.size // _MAX_FRAMES))]
