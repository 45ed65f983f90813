"""Statistics of single sensors, from which sensor health is assessed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.health.activity import Activity, join_rests
from anisomap.health.contact_counts import count_runs
from anisomap.numerics.columns import columns
from anisomap.numerics.graph.connectivity import greatest_of_rows
from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.rest import Rest
from anisomap.numerics.similarity.search import NO_SENSOR, most_similar

MAX_ALL_PAIRS = 4096
"""Number of sensors above which no matrix of all pairs is computed: 128 MB of float64."""

_N_NEAREST = 4  # most similar sensors that are checked for the same contact; chosen by hand
_MIN_CLEAR_R = 0.6  # sensors with a higher r are never tested for isolation; chosen by hand
_ROWS_AT_ONCE = 64  # of a product; single rows would be as slow as some
_N_SHIFTS = 19  # an unrelated sensor exceeds all of them with probability 1/20
_MIN_AUTOCORRELATION = 0.05  # at lag 2, for the noise share to use it; chosen by hand


@dataclass(frozen=True, eq=False)
class Behaviour:
    """Statistics of n varying sensors; arrays of shape (n,).

    Attributes
    ----------
    rest : Rest
        Rest values.
    distinct : ndarray of int
        Number of distinct readings.
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
    distinct: NDArray[np.intp]
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
    series = np.empty((n_sensors, n_frames), dtype=bool)
    courses = []
    for column, in_contact in zip(columns(readings), series, strict=True):
        activity = Activity.of(column)
        in_contact[:] = activity.frames(column)
        courses.append(_Course.of(column, activity, in_contact))
    at_one, at_two = np.array([one.lag_correlations for one in courses]).T
    found = matches or _find_matches(readings)
    return Behaviour(
        rest=join_rests([one.rest for one in courses]),
        distinct=np.array([one.distinct for one in courses]),
        active=np.array([one.active for one in courses]),
        contacts=np.array([one.contacts for one in courses]),
        at_ceiling=np.array([one.at_ceiling for one in courses]),
        unexplained=_unexplained(series, found.nearest),
        lag_correlation=at_one,
        noise_share=_noise_share(at_one, at_two),
        best_match=found.best,
        shifted_match=(
            np.full(n_sensors, -1.0) if matches else _match_after_shifts(readings, found.best)
        ),
        n_frames=n_frames,
    )


@dataclass(frozen=True, eq=False)
class _Course:
    """Statistics of one sensor; see `Behaviour`."""

    rest: Rest
    distinct: int
    active: float
    contacts: int
    at_ceiling: float
    lag_correlations: tuple[float, float]

    @classmethod
    def of(
        cls, column: NDArray[np.floating], activity: Activity, in_contact: NDArray[np.bool_]
    ) -> _Course:
        """Compute the statistics of readings of shape (T,)."""
        # A saturating sensor stays at the end of its range on the side of contact.
        end = -1 if activity.rest.side[0] > 0 else 0
        n_highest = int(activity.counts[end]) if activity.active[end] else 0
        return cls(
            rest=activity.rest,
            distinct=activity.values.size,
            active=activity.n_active / column.size,
            contacts=count_runs(in_contact),
            at_ceiling=n_highest / max(1, activity.n_active),
            lag_correlations=_lag_correlations(column, activity),
        )


def _find_matches(readings: NDArray[np.floating]) -> Matches:
    n_sensors = readings.shape[1]
    count = min(_N_NEAREST, n_sensors - 1)
    if count < 1:
        return Matches(np.full((n_sensors, 1), NO_SENSOR), np.full(n_sensors, np.nan))
    if n_sensors > MAX_ALL_PAIRS:
        found, r = most_similar(_standardised(readings), count)
        return Matches(found, r[:, 0].astype(np.float64))
    correlation = pearson(readings)
    np.fill_diagonal(correlation, -np.inf)
    nearest = np.nonzero(greatest_of_rows(correlation, count))[1].reshape(n_sensors, count)
    return Matches(nearest, correlation.max(axis=1))


def _unexplained(series: NDArray[np.bool_], nearest: NDArray[np.int64]) -> NDArray[np.float64]:
    """Compute the share of active frames in which none of the most similar sensors is active."""
    alone = [
        np.count_nonzero(mine > series[others[others != NO_SENSOR]].any(axis=0))
        for mine, others in zip(series, nearest, strict=True)
    ]
    counted = np.where((nearest != NO_SENSOR).any(axis=1), alone, 0)
    return np.asarray(counted / np.maximum(np.count_nonzero(series, axis=1), 1))


def _lag_correlations(column: NDArray[np.floating], activity: Activity) -> tuple[float, float]:
    """Return the autocorrelations of one sensor, shape (T,), at lags of one and two frames."""
    mean = activity.counts @ activity.values / column.size
    deviations = activity.values - mean
    largest = max(deviations[-1], -deviations[0])
    centred = column - mean
    centred /= largest
    sum_of_squares = activity.counts @ (deviations / largest) ** 2
    return (
        float(centred[1:] @ centred[:-1] / sum_of_squares),
        float(centred[2:] @ centred[:-2] / sum_of_squares),
    )


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
    others = np.unique(np.linspace(0, n_sensors - 1, min(n_sensors, MAX_ALL_PAIRS)).astype(int))
    every = others.size == n_sensors
    standard = _standardised(readings if every else readings[:, others])
    shifts = [step * n_frames // (_N_SHIFTS + 1) for step in range(1, _N_SHIFTS + 1)]
    for start in range(0, suspects.size, MAX_ALL_PAIRS):
        part = suspects[start : start + MAX_ALL_PAIRS]
        mine = standard[part] if every else _standardised(readings[:, part])
        itself = part[:, None] == others
        n_at_once = max(1, _ROWS_AT_ONCE // part.size)
        for begin in range(0, _N_SHIFTS, n_at_once):
            shifted = [np.roll(mine, shift, axis=1) for shift in shifts[begin : begin + n_at_once]]
            correlation = np.concatenate(shifted) @ standard.T
            for one in correlation.reshape(-1, *itself.shape):
                one[itself] = -1
                highest[part] = np.maximum(highest[part], one.max(axis=1))
    return highest


def _standardised(readings: NDArray[np.floating]) -> NDArray[np.float32]:
    """Scale every sensor to mean 0 and norm 1, shape (n, T)."""
    standard = np.empty(readings.shape[::-1], dtype=np.float32)
    for column, row in zip(columns(readings), standard, strict=True):
        # Differences of float32 numbers are rounded relative to themselves.
        centred = column - column.mean(dtype=np.float64).astype(column.dtype)
        centred /= max(centred.max(), -centred.min())
        np.divide(centred, np.sqrt(centred @ centred), out=row, casting="same_kind")
    return standard
