"""Split-half repeatability of a map, and the Mantel r with the truth that it predicts.

The recording is split into two halves of alternating blocks of time, in two ways, and each half is
mapped. The agreement of these maps measures random errors of the map, not systematic distortions,
which both halves share.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from anisomap.errors import InputError
from anisomap.evaluation.mantel_r import MIN_SENSORS_COMPARED
from anisomap.numerics.reliability.split_half import N_BLOCKS

DOUBTFUL = 0.9
"""Confidence below which a map carries a note that the evidence is insufficient."""

MIN_SENSORS = 12
"""Minimum number of sensors: maps of fewer agree too often by chance."""

N_HALVES = 4
"""Number of halves that are mapped: two splits of the recording."""

_MIN_FRAMES = 4 * N_BLOCKS
# Coefficients of the curve in `expected_mantel_r`, fitted to simulated skins, seeds 101 to 105.
_CONSTANT, _LINEAR, _QUADRATIC, _COLLAPSE, _COLLAPSE_POWER = 0.01, 0.2, 0.1, 0.8, 8.0

Readings = NDArray[np.floating]


def agreement_of_halves(
    readings: Readings, place: Callable[[Readings], NDArray[np.float64]]
) -> float:
    """Measure how well maps of the halves of a recording agree.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
        Finite readings.
    place : callable
        ``place(readings)`` returns positions, shape (N, k); NaN for sensors that it cannot place.

    Returns
    -------
    float
        Mean Mantel r between the maps of the two halves, over two splits; in [-1, 1]. A split
        counts as 0 if a half cannot be mapped; NaN if there are fewer than 80 frames.
    """
    if len(readings) < _MIN_FRAMES:
        return math.nan
    blocks = np.array_split(np.arange(len(readings)), N_BLOCKS)
    number = np.arange(N_BLOCKS)
    return float(
        np.mean(
            [
                _agreement(
                    place,
                    *(
                        readings[np.concatenate([blocks[i] for i in np.flatnonzero(half)])]
                        for half in (side, ~side)
                    ),
                )
                for side in (number % 2 == 0, number % 4 < 2)
            ]
        )
    )


def expected_mantel_r(agreement: float) -> float:
    """Predict the Mantel r of a map with the truth from the agreement of its halves.

    Parameters
    ----------
    agreement : float
        From `agreement_of_halves`.

    Returns
    -------
    float
        In [0, 1]; NaN for NaN.

    Notes
    -----
    ``1 - r = 0.01 + 0.2 d - 0.1 d^2 + 0.8 d^8`` with the disagreement ``d = 1 - agreement``,
    clipped at 1. The curve was fitted to simulated skins with an agreement of 0.4 or more; the
    last term lets the confidence vanish as the halves become unrelated. For other seeds see
    ``docs/explanation/results.md``.
    """
    d = min(1 - agreement, 1.0)
    error = _CONSTANT + _LINEAR * d - _QUADRATIC * d**2 + _COLLAPSE * d**_COLLAPSE_POWER
    return float(np.clip(1 - error, 0, 1))


def confidence_in_words(confidence: float) -> str:
    """Describe a confidence in a few words."""
    if math.isnan(confidence):
        return "unknown"
    if confidence < DOUBTFUL:
        return f"{confidence:.2f}: insufficient evidence"
    return f"{confidence:.2f} (expected Mantel r; systematic distortion is not included)"


def map_agreement(first: NDArray[np.float64], second: NDArray[np.float64]) -> float:
    """Compute the Mantel r of two maps over the sensors that both place.

    Parameters
    ----------
    first, second : ndarray of shape (N, k)
        Positions; NaN for sensors without one.

    Returns
    -------
    float
        In [-1, 1]; 0 if fewer than 4 sensors are shared, or all distances of a map are equal.
    """
    placed = np.isfinite(first).all(axis=1) & np.isfinite(second).all(axis=1)
    if np.count_nonzero(placed) < MIN_SENSORS_COMPARED:
        return 0.0
    one, other = pdist(first[placed]), pdist(second[placed])
    if np.ptp(one) == 0 or np.ptp(other) == 0:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])


def _agreement(
    place: Callable[[Readings], NDArray[np.float64]], first: Readings, second: Readings
) -> float:
    try:
        return map_agreement(place(first), place(second))
    except InputError:
        return 0.0
