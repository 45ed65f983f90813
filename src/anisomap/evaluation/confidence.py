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


def _agreement(
    place: Callable[[Readings], NDArray[np.float64]], first: Readings, second: Readings
) -> float:
    try:
        x, y = place(first), place(second)
    except InputError:
        return 0.0
    placed = np.isfinite(x).all(axis=1) & np.isfinite(y).all(axis=1)
    if np.count_nonzero(placed) < MIN_SENSORS_COMPARED:
        return 0.0
    x_distances, y_distances = pdist(x[placed]), pdist(y[placed])
    if np.ptp(x_distances) == 0 or np.ptp(y_distances) == 0:
        return 0.0
    return float(np.corrcoef(x_distances, y_distances)[0, 1])
