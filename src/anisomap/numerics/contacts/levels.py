"""Readings as a few ordered levels, so that no law of pressure has to be known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.similarity.rest import estimate_rest

_LIGHTEST = 0.02  # of a sensor's range; less is rest
_DEEPEST = 0.998  # quantile of all readings; beyond it may be a glitch
_TYPICAL = 0.9  # quantile of the readings that are not at rest
_FEWEST_TOUCHES = 5  # readings; fewer tell no gain


@dataclass(frozen=True, eq=False)
class Levels:
    """Readings in steps from rest, 0, up to the max_level contact, `max_level`.

    Attributes
    ----------
    values : ndarray of int8, shape (T, N)
    max_level : int
        At least 1; every level up to it occurs.
    at_rest : float
        Share of all readings that lie where their sensor rests, noise included.
    gains : ndarray of shape (N,)
        How strongly each sensor reads, over the median.
    """

    values: NDArray[np.int8]
    max_level: int
    at_rest: float
    gains: NDArray[np.float64]


def assign_levels(readings: ArrayLike, most: int, alike: float) -> Levels:
    """Sort readings into levels that hold about equally many each, rest aside.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.
    most : int
        Levels, rest aside; there are fewer where readings have fewer values.
    alike : float
        Standard deviation of the logarithms of the gains of sensors, at least 0, up to which
        readings of different sensors are compared as they are. Else each sensor is divided by its
        gain: the .9 quantile of its readings beyond rest, which itself is noisy.

    Returns
    -------
    Levels
        Rest is that of `anisomap.numerics.similarity.rest.estimate_rest`.
    """
    values = np.asarray(readings, dtype=np.float64)
    rest = estimate_rest(values)
    depth = rest.depth(values)
    gains = _gains(depth)
    if np.log(gains).std() > alike:
        depth /= gains
    touched = depth > _LIGHTEST * np.median(_reach(depth))
    levels = np.zeros(depth.shape, dtype=np.int8)
    pressed = depth[touched]
    edges = np.unique(np.quantile(pressed, np.arange(1, most) / most)) if pressed.size else pressed
    edges = edges[edges < pressed.max(initial=0.0)]
    levels[touched] = 1 + np.searchsorted(edges, pressed, side="left")
    near_rest = np.maximum(rest.threshold, _LIGHTEST * np.ptp(values, axis=0))
    at_rest = float((np.abs(values - rest.value) <= near_rest).mean())
    gains = gains / np.median(gains)
    for array in (levels, gains):
        array.setflags(write=False)
    return Levels(values=levels, max_level=len(edges) + 1, at_rest=at_rest, gains=gains)


def _reach(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Tell how deep each sensor is pressed, hardly ever deeper."""
    usual = np.quantile(depth, _DEEPEST, axis=0)
    return np.where(usual > 0, usual, depth.max(axis=0))


def _gains(depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Give each sensor's gain; the median of all where it is hardly ever touched."""
    touched = depth > _LIGHTEST * _reach(depth)
    enough = np.flatnonzero(touched.sum(axis=0) > _FEWEST_TOUCHES)
    known = [np.quantile(depth[touched[:, i], i], _TYPICAL) for i in enough]
    gains = np.full(depth.shape[1], np.median(known) if known else 1.0)
    gains[enough] = known
    return gains
