"""Statistics of single sensors, from which sensor health is assessed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.rest import Rest, estimate_rest
from anisomap.numerics.similarity.search import NO_SENSOR, most_similar

_N_NEAREST = 4  # most similar sensors that are checked for the same contact; chosen by hand
_MIN_CLEAR_R = 0.6  # sensors with a higher r are never tested for isolation; chosen by hand
_N_SHIFTS = 19  # an unrelated sensor exceeds all of them with probability 1/20
_MIN_AUTOCORRELATION = 0.05  # at lag 2, for the noise share to use it; chosen by hand
_BLOCK_READINGS = 1 << 24  # readings processed at a time, as float64
_MAX_ALL_PAIRS = 4096  # sensors; more would need a large matrix of pairs


@dataclass(frozen=True, eq=False)
class Behaviour:
    """Statistics of n varying sensors; arrays of shape (n,).

    Attributes
    ----------
    rest : Rest
        Rest values.
    active : ndarray
        Share of frames beyond rest.
    contacts : ndarray of int
        Number of contacts: runs of frames beyond rest.
    at_ceiling : ndarray
        Share of active frames at the most extreme reading on the side of contact.
    unexplained : ndarray
        Share of active frames in which none of the most similar sensors is active.
    lag_correlation : ndarray
        Autocorrelation at a lag of one frame.
    noise_share : ndarray
        Share of white noise in the variance.
    best_match : ndarray
        Highest Pearson r with another sensor.
    shifted_match : ndarray
        Highest Pearson r with another sensor after circular shifts in time; -1 if not computed.
    n_frames : int
        Number of frames.
    """

    rest: Rest
    active: NDArray[np.float64]
    contacts: NDArray[np.intp]
    at_ceiling: NDArray[np.float64]
    unexplained: NDArray[np.float64]
    lag_correlation: NDArray[np.float64]
    noise_share: NDArray[np.float64]
    best_match: NDArray[np.float64]
    shifted_match: NDArray[np.float64]
    n_frames: int


@dataclass(frozen=True, eq=False)
class Matches:
    """The most similar sensors of each sensor.

    Attributes
    ----------
    nearest : ndarray of int, shape (n, m)
        Indices of the most similar sensors; -1 where there are fewer.
    best : ndarray of shape (n,)
        Highest Pearson r with another sensor; NaN if there is none.
    """

    nearest: NDArray[np.int64]
    best: NDArray[np.float64]

    def among(self, chosen: NDArray[np.bool_]) -> Matches:
        """Return the matches of some sensors, given as a mask, with indices renumbered."""
        number = np.append(np.where(chosen, np.cumsum(chosen) - 1, NO_SENSOR), NO_SENSOR)
        return Matches(number[self.nearest[chosen]], self.best[chosen])


@dataclass(frozen=True, eq=False)
class _Single:
    """Statistics of sensors that do not depend on other sensors."""

    rest: Rest
    active: NDArray[np.bool_]
    at_ceiling: NDArray[np.float64]
    at_one: NDArray[np.float64]
    at_two: NDArray[np.float64]


def observe(readings: NDArray[np.floating], matches: Matches | None = None) -> Behaviour:
    """Compute the statistics of sensors.

    Parameters
    ----------
    readings : ndarray of shape (T, n)
        Finite readings of sensors that vary.
    matches : Matches, optional
        The most similar sensors, if known. Circular shifts are then not computed, and
        `Behaviour.shifted_match` is -1.

    Returns
    -------
    Behaviour

    Notes
    -----
    For more than 4096 sensors, no matrix of all pairs is computed, and circular shifts are compared
    with 4096 evenly chosen sensors.
    """
    n_frames, n_sensors = readings.shape
    width = max(1, _BLOCK_READINGS // n_frames)
    parts = [
        _observe_single(readings[:, start : start + width].astype(np.float64))
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
        unexplained=_unexplained(active, found.nearest),
        lag_correlation=at_one,
        noise_share=_noise_share(at_one, at_two),
        best_match=found.best,
        shifted_match=(
            np.full(n_sensors, -1.0) if matches else _match_after_shifts(readings, found.best)
        ),
        n_frames=n_frames,
    )


_REST_FIELDS = ("value", "side", "threshold")


def _observe_single(readings: NDArray[np.float64]) -> _Single:
    rest = estimate_rest(readings)
    active = rest.active(readings)
    # A saturating sensor stays at the end of its range on the side of contact.
    towards_contact = rest.side * readings
    at_ceiling = active & (towards_contact == towards_contact.max(axis=0))
    at_one, at_two = _lag_correlations(readings, (1, 2))
    return _Single(
        rest=rest,
        active=active,
        at_ceiling=_share(at_ceiling, active),
        at_one=at_one,
        at_two=at_two,
    )


def _find_matches(readings: NDArray[np.floating]) -> Matches:
    n_sensors = readings.shape[1]
    count = min(_N_NEAREST, n_sensors - 1)
    if count < 1:
        return Matches(np.full((n_sensors, 1), NO_SENSOR), np.full(n_sensors, np.nan))
    if n_sensors > _MAX_ALL_PAIRS:
        found, r = most_similar(np.ascontiguousarray(_standardised(readings).T), count)
        return Matches(found, r[:, 0].astype(np.float64))
    correlation = pearson(readings)
    np.fill_diagonal(correlation, -np.inf)
    nearest = np.argpartition(-correlation, count - 1, axis=1)[:, :count]
    return Matches(nearest.astype(np.int64), correlation.max(axis=1))


def _unexplained(active: NDArray[np.bool_], nearest: NDArray[np.int64]) -> NDArray[np.float64]:
    """Compute the share of active frames in which none of the most similar sensors is active."""
    series = np.ascontiguousarray(active.T)
    alone = [
        np.count_nonzero(mine & ~series[others[others != NO_SENSOR]].any(axis=0))
        for mine, others in zip(series, nearest, strict=True)
    ]
    counted = np.where((nearest != NO_SENSOR).any(axis=1), alone, 0)
    return np.asarray(counted / np.maximum(np.count_nonzero(series, axis=1), 1))


def _lag_correlations(
    readings: NDArray[np.float64], lags: Iterable[int]
) -> Iterator[NDArray[np.float64]]:
    centred = readings - readings.mean(axis=0)
    centred /= np.abs(centred).max(axis=0)
    sum_of_squares = np.einsum("ti,ti->i", centred, centred)
    for lag in lags:
        yield np.einsum("ti,ti->i", centred[lag:], centred[:-lag]) / sum_of_squares


def _noise_share(at_one: NDArray[np.float64], at_two: NDArray[np.float64]) -> NDArray[np.float64]:
    """Estimate the share of white noise in the variance from lags of one and two frames.

    A signal with autocorrelation a^l and a share c of the variance, plus white noise, has
    rho_l = c a^l, so c = rho_1^2 / rho_2. Short contacts reduce both lags and do not count as
    noise. If rho_2 is near 0, c = rho_1.
    """
    signal = np.divide(at_one**2, at_two, out=at_one.copy(), where=at_two > _MIN_AUTOCORRELATION)
    return np.asarray(1 - np.clip(signal, 0, 1))


def _match_after_shifts(
    readings: NDArray[np.floating], best_match: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the highest r of a sensor with any other after circular shifts of its frames.

    Circular shifts preserve the autocorrelation, which formulas for independent frames ignore.
    Sensors with a high r are not shifted, and get -1.
    """
    n_frames, n_sensors = readings.shape
    highest = np.full(n_sensors, -1.0)
    suspects = np.flatnonzero(best_match < _MIN_CLEAR_R)
    if not suspects.size or n_frames < 2 * _N_SHIFTS:
        return highest
    others = np.unique(np.linspace(0, n_sensors - 1, min(n_sensors, _MAX_ALL_PAIRS)).astype(int))
    standard = _standardised(readings[:, others], np.float64)
    for start in range(0, suspects.size, _MAX_ALL_PAIRS):
        part = suspects[start : start + _MAX_ALL_PAIRS]
        mine = _standardised(readings[:, part], np.float64)
        for step in range(1, _N_SHIFTS + 1):
            shifted = np.roll(mine, step * n_frames // (_N_SHIFTS + 1), axis=0)
            correlation = shifted.T @ standard
            correlation[part[:, None] == others] = -1
            highest[part] = np.maximum(highest[part], correlation.max(axis=1))
    return highest


def _standardised(
    readings: NDArray[np.floating], dtype: type[np.floating] = np.float32
) -> NDArray[np.floating]:
    """Scale every sensor to mean 0 and norm 1."""
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
