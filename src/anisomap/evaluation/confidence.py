"""How far a map can be trusted where nobody knows the truth: whether it would come out again.

The recording is cut in two halves of alternating stretches of time, in two ways, and each half
makes a map. Where such maps agree, so will the map of the whole with the truth, as far as chance
is concerned. What bends every map alike, they cannot show.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from anisomap.errors import InputError
from anisomap.evaluation.mantel_r import FEWEST_SENSORS
from anisomap.numerics.reliability.split_half import N_BLOCKS

DOUBTFUL = 0.9
"""Below this confidence a map is not to be relied on, and says so."""

FEWEST_TO_JUDGE = 12
"""Maps of fewer sensors agree by chance too often."""

_FEWEST_FRAMES = 4 * N_BLOCKS
_LOSS = (0.2, 0.1)  # of the disagreement of halves that is left in the whole, and what it spares
_BEND = 0.01  # what bends maps of halves alike, in the median of simulated skins
_COLLAPSE = 0.8  # halves that agree on nothing hold no evidence at all
_SUDDEN = 8.0

Readings = NDArray[np.floating]


def agreement_of_halves(
    readings: Readings, place: Callable[[Readings], NDArray[np.float64]]
) -> float:
    """Tell how alike the maps of the halves of a recording are.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
        Finite readings.
    place : callable
        Makes a map: ``place(readings)`` gives positions, shape (N, k); NaN of sensors that it
        cannot place.

    Returns
    -------
    float
        Mean Mantel r of the maps of two halves, over two ways to halve a recording; in [-1, 1].
        0 where a half makes no map; NaN if there are fewer than 80 frames.
    """
    if len(readings) < _FEWEST_FRAMES:
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
    """Tell what Mantel r a map is expected to reach whose halves agree so far.

    Parameters
    ----------
    agreement : float
        Of `agreement_of_halves`.

    Returns
    -------
    float
        In [0, 1]; NaN for NaN.

    Notes
    -----
    ``1 - r = 0.01 + 0.2 d - 0.1 d^2 + 0.8 d^8`` with the disagreement ``d = 1 - agreement``, up to
    1: the curve was fitted to simulated skins whose halves agree to 0.4 or more (halves have half
    the frames, so they err more than the whole), the last term lets confidence vanish where halves
    share nothing. How it held on other seeds stands in ``docs/results.md``.
    """
    apart = min(1 - agreement, 1.0)
    error = _BEND + _LOSS[0] * apart - _LOSS[1] * apart**2 + _COLLAPSE * apart**_SUDDEN
    return float(np.clip(1 - error, 0, 1))


def confidence_in_words(confidence: float) -> str:
    """Say in a few words what a confidence means."""
    if math.isnan(confidence):
        return "unknown: nothing tells how far this map can be trusted"
    if confidence < DOUBTFUL:
        return f"{confidence:.2f}: the evidence does not suffice"
    return f"{confidence:.2f} (Mantel r that maps as repeatable as this one reach)"


def _agreement(
    place: Callable[[Readings], NDArray[np.float64]], first: Readings, second: Readings
) -> float:
    try:
        places, others = place(first), place(second)
    except InputError:
        return 0.0
    placed = np.isfinite(places).all(axis=1) & np.isfinite(others).all(axis=1)
    if np.count_nonzero(placed) < FEWEST_SENSORS:
        return 0.0
    one, other = pdist(places[placed]), pdist(others[placed])
    if np.ptp(one) == 0 or np.ptp(other) == 0:
        return 0.0
    return float(np.corrcoef(one, other)[0, 1])
