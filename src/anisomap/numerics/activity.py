"""Rest and touch: which value a sensor has when nothing presses it, and when something does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

ATOM = 0.1
"""A value that holds at least this share of a sensor's frames is a rest, not a coincidence."""

NOISE_QUANTILE = 0.99
"""Share of the readings on the quiet side of rest that noise must explain: 2.6 sigma if normal."""

SKEW = 2.0
"""Contact reaches at least so many times as far as noise, or it cannot be told from noise."""


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
        return np.asarray(self.depth(readings) > 0)


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
    values = np.asarray(readings, dtype=np.float64)
    rest, side, threshold = np.array([_rest_of(column) for column in values.T]).T
    return Rest(value=rest, side=side, threshold=threshold)


def _rest_of(column: NDArray[np.float64]) -> tuple[float, float, float]:
    distinct, counts = np.unique(column, return_counts=True)
    resting = counts.max() >= max(2, ATOM * column.size)
    value = distinct[counts.argmax()] if resting else np.median(column)
    side = -1.0 if column.mean() < value else 1.0
    beyond = side * (column - value)
    noise = np.quantile(-beyond[beyond <= 0], NOISE_QUANTILE)
    contact = np.quantile(beyond[beyond >= 0], NOISE_QUANTILE)
    if not resting and contact < SKEW * noise:
        return float(value), 1.0, 0.0
    return float(value), side, float(noise)
