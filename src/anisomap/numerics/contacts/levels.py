"""Ordinal levels of readings, which are independent of the sensors' response curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.columns import columns, find_levels
from anisomap.numerics.similarity.rest import quantile_from_counts, rest_from_counts

Floats = NDArray[np.float64]

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
    values = np.asarray(readings)
    # Of each sensor, only distinct readings are examined.
    found = [find_levels(column) for column in columns(values)]
    distinct = [one.values.astype(np.float64) for one in found]
    counts = [one.counts for one in found]
    rest = rest_from_counts(zip(distinct, counts, strict=True))
    own = list(zip(distinct, rest.value, rest.side, rest.threshold, strict=True))
    depths = [np.maximum(side * (x - value) - least, 0) for x, value, side, least in own]
    typical = np.array(
        [quantile_from_counts(*pair, _RANGE_QUANTILE) for pair in zip(depths, counts, strict=True)]
    )
    typical = np.where(typical > 0, typical, [depth.max() for depth in depths])
    gains = _gains(depths, counts, typical)
    if np.log(gains).std() > max_gain_spread:
        depths = [depth / gain for depth, gain in zip(depths, gains, strict=True)]
        typical = typical / gains
    least_depth = _MIN_DEPTH * np.median(typical)
    touched = [depth > least_depth for depth in depths]
    pressed = np.repeat(np.concatenate(depths), np.concatenate(counts) * np.concatenate(touched))
    edges = pressed
    if pressed.size:
        edges = np.unique(np.quantile(pressed, np.arange(1, n_levels) / n_levels))
    edges = edges[edges < pressed.max(initial=0.0)]
    by_sensor = np.empty(values.shape[::-1], dtype=np.int8)
    for level, depth, above, row in zip(found, depths, touched, by_sensor, strict=True):
        own_levels = above * (1 + np.searchsorted(edges, depth, side="left"))
        level.expand(own_levels.astype(np.int8), out=row)
    near_rest = [
        count[np.abs(x - value) <= max(least, _MIN_DEPTH * (x[-1] - x[0]))].sum()
        for (x, value, _, least), count in zip(own, counts, strict=True)
    ]
    at_rest = float(sum(near_rest)) / max(values.size, 1)
    levels, gains = np.ascontiguousarray(by_sensor.T), gains / np.median(gains)
    for array in (levels, gains):
        array.setflags(write=False)
    return Levels(values=levels, max_level=len(edges) + 1, at_rest=at_rest, gains=gains)


def _gains(depths: list[Floats], counts: list[NDArray[np.int64]], typical: Floats) -> Floats:
    """Return the gain of each sensor; the median of all for a rarely touched sensor."""
    gains = np.full(len(depths), np.nan)
    for i, (depth, count) in enumerate(zip(depths, counts, strict=True)):
        touched = depth > _MIN_DEPTH * typical[i]
        if count[touched].sum() > _MIN_TOUCHES:
            gains[i] = quantile_from_counts(depth[touched], count[touched], _GAIN_QUANTILE)
    known = np.isfinite(gains)
    return np.where(known, gains, np.median(gains[known]) if known.any() else 1.0)
