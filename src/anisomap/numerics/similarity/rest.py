"""Rest and touch: which value a sensor has when nothing presses it, and when something does."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.columns import columns, count_values

ATOM = 0.1
"""A value that holds at least this share of a sensor's frames is a rest, not a coincidence."""

NOISE_QUANTILE = 0.99
"""Share of the readings on the quiet side of rest that noise must explain: 2.6 sigma if normal."""

SKEW = 2.0
"""Contact reaches at least so many times as far as noise, or it cannot be told from noise."""

_CHUNK_FRAMES = 256  # what is worked out on the way stays in the processor's cache


@dataclass(frozen=True, eq=False)
class Rest:
    """Where each of N sensors rests, and what counts as leaving it.

    Attributes
    ----------
    value : ndarray of shape (N,)
        The most frequent reading; the median where readings are continuous, so that no value is
        frequent.
    side : ndarray of shape (N,)
        1 where contact raises the reading, -1 where it lowers it (raw capacitive skins).
    threshold : ndarray of shape (N,)
        How far a reading strays from rest by noise alone, in units of the reading; 0 where none
        ever lies on the other side of rest than contact, and where there is no rest.
    """

    value: NDArray[np.float64]
    side: NDArray[np.float64]
    threshold: NDArray[np.float64]

    def depth(self, readings: ArrayLike) -> NDArray[np.float64]:
        """Tell how far beyond rest each reading is.

        Parameters
        ----------
        readings : array_like of shape (T, N)

        Returns
        -------
        ndarray of shape (T, N)
            At least 0; exactly 0 at rest. In units of the reading, from the threshold on.
        """
        beyond = self.side * (np.asarray(readings, dtype=np.float64) - self.value) - self.threshold
        return np.asarray(np.maximum(beyond, 0))

    def active(self, readings: ArrayLike) -> NDArray[np.bool_]:
        """Tell which readings are beyond rest, as booleans of shape (T, N)."""
        values = np.asarray(readings)
        beyond = np.empty(values.shape, dtype=bool)
        for start in range(0, len(values), _CHUNK_FRAMES):
            frames = slice(start, start + _CHUNK_FRAMES)
            beyond[frames] = self.depth(values[frames]) > 0
        return beyond


def estimate_rest(readings: ArrayLike) -> Rest:
    """Estimate where each sensor rests.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.

    Returns
    -------
    Rest
        `depth` and `active` under it do not change if a reading's unit or zero changes.

    Notes
    -----
    Noise reaches equally far on both sides of rest, contact only on one. So contact is on the
    side where the mean lies, and the other side shows how far noise reaches. Continuous readings
    that reach about equally far on both sides (the pixels of a camera) have no rest to leave:
    what is beyond their median counts as active.
    """
    found = map(count_values, columns(np.asarray(readings)))
    return rest_from_counts((values.astype(np.float64), counts) for values, counts in found)


def rest_from_counts(
    values_and_counts: Iterable[tuple[NDArray[np.float64], NDArray[np.integer[Any]]]],
) -> Rest:
    """Estimate where each sensor rests from which values it read how often.

    Parameters
    ----------
    values_and_counts : iterable of (ndarray, ndarray of int)
        For each sensor its distinct values, in increasing order, and how often each occurred.

    Returns
    -------
    Rest
        As from `estimate_rest`.
    """
    rest, side, threshold = np.array([_rest_of(*pair) for pair in values_and_counts]).T
    return Rest(value=rest, side=side, threshold=threshold)


def _rest_of(
    values: NDArray[np.float64], counts: NDArray[np.integer[Any]]
) -> tuple[float, float, float]:
    n_frames = int(counts.sum())
    resting = counts.max() >= max(2, ATOM * n_frames)
    value = values[counts.argmax()] if resting else _quantile(values, counts, 0.5)
    side = -1.0 if (counts * (values - value)).sum() < 0 else 1.0
    beyond = side * (values - value)
    quiet, touched = beyond <= 0, beyond >= 0
    noise = _quantile(-beyond[quiet], counts[quiet], NOISE_QUANTILE)
    contact = _quantile(beyond[touched], counts[touched], NOISE_QUANTILE)
    if not resting and contact < SKEW * noise:
        return float(value), 1.0, 0.0
    return float(value), side, noise


def _quantile(values: NDArray[np.float64], counts: NDArray[np.integer[Any]], level: float) -> float:
    """Give a quantile of values that occur several times, as `numpy.quantile` interpolates it."""
    order = np.argsort(values)
    ends = np.cumsum(counts[order])
    place = level * (int(ends[-1]) - 1)
    below = int(place)
    at = np.searchsorted(ends, [below, min(below + 1, int(ends[-1]) - 1)], side="right")
    low, high = values[order[at]]
    return float(low + (place - below) * (high - low))
