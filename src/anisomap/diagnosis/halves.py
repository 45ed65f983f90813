"""Repeatability of a map, from maps of halves of the recording.

The recording is split into two halves of alternating blocks of time, and each half is mapped. The
differences of these maps measure random errors, not systematic ones, which all share.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.evaluation.alignment import align
from anisomap.evaluation.mantel_r import MIN_SENSORS_COMPARED
from anisomap.evaluation.neighbourhood import median_spacing
from anisomap.numerics.reliability.split_half import N_BLOCKS, split_blocks

MIN_SENSORS = 12
"""Minimum number of sensors: maps of fewer agree too often by chance."""

MIN_FRAMES = 4 * N_BLOCKS
"""Minimum number of frames."""

Frames = NDArray[np.intp]


def repeatability_of_halves(
    n_frames: int,
    positions: NDArray[np.float64],
    place: Callable[[Frames], NDArray[np.float64]],
) -> float:
    """Measure the random error of a map by maps of halves of the recording.

    Parameters
    ----------
    n_frames : int
        Number of frames of the recording, at least `MIN_FRAMES`.
    positions : ndarray of shape (N, k)
        The map.
    place : callable
        ``place(frames)`` returns positions, shape (N, k), from the frames of given indices; NaN for
        sensors that it cannot place.

    Returns
    -------
    float
        RMS error of the positions, in spacings of the map; infinite if a half cannot be mapped.

    Notes
    -----
    If a map of all frames has errors of variance v, those of a half have 2 v. Both share frames:
    their difference has a variance of v, which is that of the map.
    """
    squares = [_squared_difference(place, frames, positions) for frames in split_blocks(n_frames)]
    spacing = median_spacing(positions)
    return math.sqrt(float(np.mean(squares))) / spacing if spacing > 0 else math.inf


def _squared_difference(
    place: Callable[[Frames], NDArray[np.float64]],
    frames: Frames,
    positions: NDArray[np.float64],
) -> float:
    """Mean squared difference of the map of some frames and the map; infinite if there is none."""
    try:
        made = place(frames)
        placed = np.isfinite(made).all(axis=1)
        if np.count_nonzero(placed) < MIN_SENSORS_COMPARED:
            return math.inf
        return align(made[placed], positions[placed]).rms ** 2
    except InputError:  # the half cannot be mapped, or all its positions coincide
        return math.inf
