"""Ordinal levels of readings, which are independent of the sensors' response curves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.similarity.rest import Rest, estimate_rest

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


def assign_levels(
    readings: ArrayLike, n_levels: int, max_gain_spread: float, rest: Rest | None = None
) -> Levels:
    """Quantise readings (T, N) above rest into at most `n_levels` levels of about equal counts.

    Sensors whose log gains spread by more than `max_gain_spread` are divided by their gains, the
    0.9 quantiles of their readings above rest, which are themselves noisy. The rest is estimated
    if it is not given.
    """
    values = np.asarray(readings)
    rest = estimate_rest(values) if rest is None else rest
    depths = np.ascontiguousarray(rest.depth(values).T)  # sensor by sensor
    ordered = [np.sort(depth[depth > 0]) for depth in depths]
    n_frames = len(values)
    typical = np.array([_quantile(one, n_frames, _RANGE_QUANTILE) for one in ordered])
    typical = np.where(typical > 0, typical, [one[-1] if one.size else 0.0 for one in ordered])
    gains = _gains(ordered, typical)
    if np.log(gains).std() > max_gain_spread:
        depths /= gains[:, None]
        ordered = [one / gain for one, gain in zip(ordered, gains, strict=True)]
        typical = typical / gains
    least_depth = _MIN_DEPTH * np.median(typical)
    pressed = np.concatenate([one[one > least_depth] for one in ordered])
    edges = pressed
    if pressed.size:
        edges = np.unique(np.quantile(pressed, np.arange(1, n_levels) / n_levels))
    edges = edges[edges < pressed.max(initial=0.0)]
    by_sensor = np.empty(depths.shape, dtype=np.int8)
    for depth, row in zip(depths, by_sensor, strict=True):
        row[:] = (depth > least_depth) * (1 + np.searchsorted(edges, depth, side="left"))
    extent = values.max(axis=0).astype(np.float64) - values.min(axis=0)
    near = np.maximum(rest.threshold, _MIN_DEPTH * extent)
    at_rest = float((np.abs(values - rest.value) <= near).mean()) if values.size else 0.0
    levels, gains = np.ascontiguousarray(by_sensor.T), gains / np.median(gains)
    for array in (levels, gains):
        array.setflags(write=False)
    return Levels(values=levels, max_level=len(edges) + 1, at_rest=at_rest, gains=gains)


def _quantile(ordered: Floats, n_values: int, level: float) -> float:
    """Return a quantile of `n_values` values of which all but the ordered ones are 0."""
    place = level * (n_values - 1) - (n_values - ordered.size)
    if place < 0:
        return max(0.0, 1 + place) * float(ordered[0]) if ordered.size else 0.0
    below = int(place)
    low, high = ordered[[below, min(below + 1, ordered.size - 1)]]
    return float(low + (place - below) * (high - low))


def _gains(ordered: list[Floats], typical: Floats) -> Floats:
    """Return the gain of each sensor; the median of all for a rarely touched sensor."""
    gains = np.full(len(ordered), np.nan)
    for i, depth in enumerate(ordered):
        touched = depth[depth > _MIN_DEPTH * typical[i]]
        if touched.size > _MIN_TOUCHES:
            gains[i] = np.quantile(touched, _GAIN_QUANTILE)
    known = np.isfinite(gains)
    return np.where(known, gains, np.median(gains[known]) if known.any() else 1.0)
