"""What every sensor did during a recording, in the figures that verdicts are made from."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.rest import Rest, estimate_rest
from anisomap.numerics.similarity.search import NO_SENSOR, most_similar

_MATCHES = 4  # neighbours that are asked whether they felt a contact, too
_CLEAR_RELATION = 0.6  # no sensor with such a match is suspected of having none
_SHIFTS = 19  # an unrelated sensor beats all of them in one case of twenty
_MEMORY = 0.05  # autocorrelation
_BLOCK_READINGS = 1 << 24  # that are worked on at a time, as float64
_ALL_PAIRS = 4096  # of more sensors no matrix of pairs is made


@dataclass(frozen=True, eq=False)
class Behaviour:
    """What n sensors that vary did; shape (n,) each.

    Attributes
    ----------
    rest : Rest
        Where they rest.
    active : ndarray
        Share of frames beyond rest.
    contacts : ndarray of int
        How many separate times they went beyond rest.
    at_ceiling : ndarray
        Share of active frames at the most extreme reading on the side of contact.
    unexplained : ndarray
        Share of active frames in which none of the sensors most like it is active.
    lag_correlation : ndarray
        Autocorrelation at a lag of one frame.
    noise_share : ndarray
        Share of the variance that is noise from frame to frame.
    best_match, chance_match : ndarray
        Highest Pearson r with any other sensor; the same with frames shifted in time.
    n_frames : int
        Length of the recording.
    """

    rest: Rest
    active: NDArray[np.float64]
    contacts: NDArray[np.intp]
    at_ceiling: NDArray[np.float64]
    unexplained: NDArray[np.float64]
    lag_correlation: NDArray[np.float64]
    noise_share: NDArray[np.float64]
    best_match: NDArray[np.float64]
    chance_match: NDArray[np.float64]
    n_frames: int


@dataclass(frozen=True, eq=False)
class Matches:
    """Which sensors are most like which.

    Attributes
    ----------
    kin : ndarray of int, shape (n, m)
        The sensors most like each; -1 where there are fewer.
    best : ndarray of shape (n,)
        The highest Pearson r of each with any other; NaN if there is none.
    """

    kin: NDArray[np.int64]
    best: NDArray[np.float64]

    def among(self, chosen: NDArray[np.bool_]) -> Matches:
        """Keep some sensors only, numbered anew."""
        number = np.append(np.where(chosen, np.cumsum(chosen) - 1, NO_SENSOR), NO_SENSOR)
        return Matches(number[self.kin[chosen]], self.best[chosen])


@dataclass(frozen=True, eq=False)
class _Alone:
    """What of `Behaviour` the readings of a sensor tell by themselves."""

    rest: Rest
    active: NDArray[np.bool_]
    at_ceiling: NDArray[np.float64]
    at_one: NDArray[np.float64]
    at_two: NDArray[np.float64]


def observe(readings: NDArray[np.floating], matches: Matches | None = None) -> Behaviour:
    """Work out what sensors did.

    Parameters
    ----------
    readings : ndarray of shape (T, n)
        Finite readings of sensors that vary.
    matches : Matches, optional
        Which of them are most like which, where that is known; then nothing is shifted in time to
        learn what chance would give, and `chance_match` is -1.

    Returns
    -------
    Behaviour

    Notes
    -----
    Of more than 4096 sensors no matrix of pairs is made, and chance is learnt from as many others.
    """
    n_frames, n_sensors = readings.shape
    width = max(1, _BLOCK_READINGS // n_frames)
    parts = [
        _observe_alone(readings[:, start : start + width].astype(np.float64))
        for start in range(0, n_sensors, width)
    ]
    rest = Rest(
        *(np.concatenate([getattr(part.rest, name) for part in parts]) for name in _REST_FIELDS)
    )
    active = np.hstack([part.active for part in parts])
    found = matches or _find_matches(readings)
    at_one = np.concatenate([part.at_one for part in parts])
    at_two = np.concatenate([part.at_two for part in parts])
    return Behaviour(
        rest=rest,
        active=active.mean(axis=0),
        contacts=active[0] + np.count_nonzero(active[1:] & ~active[:-1], axis=0),
        at_ceiling=np.concatenate([part.at_ceiling for part in parts]),
        unexplained=_unexplained(active, found.kin),
        lag_correlation=at_one,
        noise_share=_noise_share(at_one, at_two),
        best_match=found.best,
        chance_match=np.full(n_sensors, -1.0) if matches else _chance_match(readings, found.best),
        n_frames=n_frames,
    )


_REST_FIELDS = ("value", "side", "threshold")


def _observe_alone(readings: NDArray[np.float64]) -> _Alone:
    rest = estimate_rest(readings)
    active = rest.active(readings)
    # The far end of the range on the side of contact: where a sensor that saturates is held.
    towards_contact = rest.side * readings
    at_ceiling = active & (towards_contact == towards_contact.max(axis=0))
    at_one, at_two = _lag_correlations(readings, (1, 2))
    return _Alone(
        rest=rest,
        active=active,
        at_ceiling=_share(at_ceiling, active),
        at_one=at_one,
        at_two=at_two,
    )


def _find_matches(readings: NDArray[np.floating]) -> Matches:
    n_sensors = readings.shape[1]
    count = min(_MATCHES, n_sensors - 1)
    if count < 1:
        return Matches(np.full((n_sensors, 1), NO_SENSOR), np.full(n_sensors, np.nan))
    if n_sensors > _ALL_PAIRS:
        found, r = most_similar(np.ascontiguousarray(_standardised(readings).T), count)
        return Matches(found, r[:, 0].astype(np.float64))
    correlation = pearson(readings)
    np.fill_diagonal(correlation, -np.inf)
    kin = np.argpartition(-correlation, count - 1, axis=1)[:, :count]
    return Matches(kin.astype(np.int64), correlation.max(axis=1))


def _unexplained(active: NDArray[np.bool_], kin: NDArray[np.int64]) -> NDArray[np.float64]:
    """Share of a sensor's active frames in which none of its nearest kin is active."""
    series = np.ascontiguousarray(active.T)
    alone = [
        np.count_nonzero(mine & ~series[others[others != NO_SENSOR]].any(axis=0))
        for mine, others in zip(series, kin, strict=True)
    ]
    counted = np.where((kin != NO_SENSOR).any(axis=1), alone, 0)  # where there is nobody to ask
    return np.asarray(counted / np.maximum(np.count_nonzero(series, axis=1), 1))


def _lag_correlations(
    readings: NDArray[np.float64], lags: Iterable[int]
) -> Iterator[NDArray[np.float64]]:
    centred = readings - readings.mean(axis=0)
    centred /= np.abs(centred).max(axis=0)
    of_itself = np.einsum("ti,ti->i", centred, centred)
    for lag in lags:
        yield np.einsum("ti,ti->i", centred[lag:], centred[:-lag]) / of_itself


def _noise_share(at_one: NDArray[np.float64], at_two: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give the share of a sensor's variance that is white noise, from lags of one and two frames.

    Beside white noise, a signal whose autocorrelation falls as a^l and that holds a share c of the
    variance has rho_l = c a^l, so that c = rho_1^2 / rho_2. Contacts that are merely short fall
    fast at both lags, and are no noise. Without memory at lag two, lag one speaks for itself.
    """
    signal = np.divide(at_one**2, at_two, out=at_one.copy(), where=at_two > _MEMORY)
    return np.asarray(1 - np.clip(signal, 0, 1))


def _chance_match(
    readings: NDArray[np.floating], best_match: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Give the highest r that a sensor has with any other if its frames are shifted in time.

    Frames overlap in time, so that no formula for independent frames holds; a shift leaves all
    that a sensor does as it is, but for when. A sensor with a clear relation is not shifted: -1.
    """
    n_frames, n_sensors = readings.shape
    chance = np.full(n_sensors, -1.0)
    suspects = np.flatnonzero(best_match < _CLEAR_RELATION)
    if not suspects.size or n_frames < 2 * _SHIFTS:
        return chance
    others = np.unique(np.linspace(0, n_sensors - 1, min(n_sensors, _ALL_PAIRS)).astype(int))
    standard = _standardised(readings[:, others], np.float64)
    for start in range(0, suspects.size, _ALL_PAIRS):
        part = suspects[start : start + _ALL_PAIRS]
        mine = _standardised(readings[:, part], np.float64)
        for step in range(1, _SHIFTS + 1):
            shifted = np.roll(mine, step * n_frames // (_SHIFTS + 1), axis=0)
            correlation = shifted.T @ standard
            correlation[part[:, None] == others] = -1
            chance[part] = np.maximum(chance[part], correlation.max(axis=1))
    return chance


def _standardised(
    readings: NDArray[np.floating], dtype: type[np.floating] = np.float32
) -> NDArray[np.floating]:
    """Bring every sensor to mean 0 and length 1."""
    width = max(1, _BLOCK_READINGS // len(readings))
    standard = np.empty(readings.shape, dtype=dtype)
    for start in range(0, readings.shape[1], width):
        block = readings[:, start : start + width].astype(np.float64)
        block -= block.mean(axis=0)
        block /= np.abs(block).max(axis=0)
        standard[:, start : start + width] = block / np.linalg.norm(block, axis=0)
    return standard


def _share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> NDArray[np.float64]:
    counts = np.count_nonzero(whole, axis=0)
    return np.asarray(np.count_nonzero(part, axis=0) / np.maximum(counts, 1))
