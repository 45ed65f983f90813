"""Ordinal levels of readings, which are independent of the sensors' response curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.similarity.rest import estimate_rest

# Chosen by hand on simulated skins, seeds 101 to 105.
_MIN_DEPTH = 0.02  # of a sensor's range; readings below are at rest
_RANGE_QUANTILE = 0.998  # of all readings; excludes glitches
_GAIN_QUANTILE = 0.9  # of the readings above rest
_MIN_TOUCHES = 5  # readings above rest, for an estimate of the gain


@dataclass(frozen=True, eq=False)
class Levels:
    """Readings as ordinal levels, from 0 at rest to `max_level` under the deepest contact.

    Attributes
    ----------
    values : ndarray of int8, shape (T, N)
    max_level : int
        At least 1; each level up to it occurs.
    at_rest : float
        Share of all readings within the noise of their sensor's rest.
    gains : ndarray of shape (N,)
        Gain of each sensor relative to the median.
    """

    values: NDArray[np.int8]
    max_level: int
    at_rest: float
    gains: NDArray[np.float64]


def assign_levels(readings: ArrayLike, n_levels: int, max_gain_spread: float) -> Levels:
    """Quantise readings above rest into levels of about equal counts.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.
    n_levels : int
        Number of levels above rest; there are fewer if readings have fewer distinct values.
    max_gain_spread : float
        Standard deviation of the log gains of sensors, at least 0, up to which readings are not
        normalised. Above it, each sensor is divided by its gain, the 0.9 quantile of its readings
        above rest, which is itself noisy.

    Returns
    -------
    Levels
        Rest is that of `anisomap.numerics.similarity.rest.estimate_rest`.
    """
    values = np.asarray(readings, dtype=np.float64)
    rest = estimate_rest(values)
    depth = rest.depth(values)
    typical = _typical_maximum(depth)
    gains = _gains(depth, typical)
    if np.log(gains).std() > max_gain_spread:
        depth /= gains
        typical = typical / gains
    touched = depth > _MIN_DEPTH * np.median(typical)
    levels = np.zeros(depth.shape, dtype=np.int8)
    pressed = depth[touched]
    edges = pressed
    if pressed.size:
        edges = np.unique(np.quantile(pressed, np.arange(1, n_levels) / n_levels))
    edges = edges[edges < pressed.max(initial=0.0)]
    levels[touched] = 1 + np.searchsorted(edges, pressed, side="left")
    near_rest = np.maximum(rest.threshold, _MIN_DEPTH * np.ptp(values, axis=0))
    at_rest = float((np.abs(values - rest.value) <= near_rest).mean())
    gains = gains / np.median(gains)
    for array in (levels, gains):
        array.setflags(write=False)
    return Levels(values=levels, max_level=len(edges) + 1, at_rest=at_rest, gains=gains)


def _typical_maximum(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a high quantile of the depth of each sensor, or its maximum if that is 0."""
    # Quantiles of contiguous rows take a fraction of the time that quantiles of columns take.
    by_sensor = np.array(depth.T, order="C", copy=True)
    highest = np.quantile(by_sensor, _RANGE_QUANTILE, axis=1, overwrite_input=True)
    return np.where(highest > 0, highest, depth.max(axis=0))


def _gains(depth: NDArray[np.float64], typical_maximum: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the gain of each sensor; the median of all for a rarely touched sensor."""
    touched = depth > _MIN_DEPTH * typical_maximum
    enough = np.flatnonzero(touched.sum(axis=0) > _MIN_TOUCHES)
    known = [np.quantile(depth[touched[:, i], i], _GAIN_QUANTILE) for i in enough]
    gains = np.full(depth.shape[1], np.median(known) if known else 1.0)
    gains[enough] = known
    return gains
