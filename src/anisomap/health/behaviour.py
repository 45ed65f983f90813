"""What every sensor did during a recording, in the figures that verdicts are made from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.activity import Rest, estimate_rest
from anisomap.numerics.precision import Reals
from anisomap.numerics.similarity import pearson

_MATCHES = 4  # neighbours that are asked whether they felt a contact, too
_CLEAR_RELATION = 0.6  # no sensor with such a match is suspected of having none
_SHIFTS = 19  # an unrelated sensor beats all of them in one case of twenty
_MEMORY = 0.05  # autocorrelation


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


def observe(readings: NDArray[np.float64]) -> Behaviour:
    """Work out what sensors did.

    Parameters
    ----------
    readings : ndarray of shape (T, n)
        Finite readings of sensors that vary.

    Returns
    -------
    Behaviour
    """
    rest = estimate_rest(readings)
    active = rest.active(readings)
    correlation = pearson(readings)
    np.fill_diagonal(correlation, -np.inf)
    has_match = correlation.shape[0] > 1
    best_match = correlation.max(axis=1) if has_match else np.full(1, np.nan)
    at_one = _lag_correlation(readings, 1)
    # The far end of the range on the side of contact: where a sensor that saturates is held.
    ceiling = (rest.side * readings).max(axis=0)
    return Behaviour(
        rest=rest,
        active=active.mean(axis=0),
        contacts=active[0] + np.count_nonzero(active[1:] & ~active[:-1], axis=0),
        at_ceiling=_share(active & (rest.side * readings == ceiling), active),
        unexplained=_unexplained(active, correlation),
        lag_correlation=at_one,
        noise_share=_noise_share(at_one, _lag_correlation(readings, 2)),
        best_match=best_match,
        chance_match=_chance_match(readings, best_match),
        n_frames=len(readings),
    )


def _unexplained(active: NDArray[np.bool_], correlation: Reals) -> NDArray[np.float64]:
    """Share of a sensor's active frames in which none of its nearest kin is active."""
    n_sensors = active.shape[1]
    matches = min(_MATCHES, n_sensors - 1)
    if matches < 1:
        return np.zeros(n_sensors)
    kin = np.argpartition(-correlation, matches - 1, axis=1)[:, :matches]
    alone = [active[:, i] & ~active[:, kin[i]].any(axis=1) for i in range(n_sensors)]
    return _share(np.column_stack(alone), active)


def _lag_correlation(readings: NDArray[np.float64], lag: int) -> NDArray[np.float64]:
    centred = readings - readings.mean(axis=0)
    centred /= np.abs(centred).max(axis=0)
    return np.asarray((centred[lag:] * centred[:-lag]).sum(axis=0) / (centred**2).sum(axis=0))


def _noise_share(at_one: NDArray[np.float64], at_two: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give the share of a sensor's variance that is white noise, from lags of one and two frames.

    Beside white noise, a signal whose autocorrelation falls as a^l and that holds a share c of the
    variance has rho_l = c a^l, so that c = rho_1^2 / rho_2. Contacts that are merely short fall
    fast at both lags, and are no noise. Without memory at lag two, lag one speaks for itself.
    """
    signal = np.divide(at_one**2, at_two, out=at_one.copy(), where=at_two > _MEMORY)
    return np.asarray(1 - np.clip(signal, 0, 1))


def _chance_match(
    readings: NDArray[np.float64], best_match: NDArray[np.float64]
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
    standard = readings - readings.mean(axis=0)
    standard /= np.abs(standard).max(axis=0)
    standard /= np.linalg.norm(standard, axis=0)
    for step in range(1, _SHIFTS + 1):
        shifted = np.roll(standard[:, suspects], step * n_frames // (_SHIFTS + 1), axis=0)
        correlation = shifted.T @ standard
        correlation[np.arange(suspects.size), suspects] = -1
        chance[suspects] = np.maximum(chance[suspects], correlation.max(axis=1))
    return chance


def _share(part: NDArray[np.bool_], whole: NDArray[np.bool_]) -> NDArray[np.float64]:
    counts = np.count_nonzero(whole, axis=0)
    return np.asarray(np.count_nonzero(part, axis=0) / np.maximum(counts, 1))
