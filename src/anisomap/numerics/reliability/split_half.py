"""Split-half reliability of correlations."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.precision import Reals
from anisomap.numerics.similarity.correlation import moments, scale_extremes

N_BLOCKS = 20
"""Number of blocks of consecutive frames that form the two halves; chosen by hand."""

MIN_FRAMES = 4
"""Minimum number of frames for a reliability: 2 per half."""

MIN_SENSORS = 3
"""Minimum number of sensors for a reliability: a correlation over 3 pairs."""

_MAX_SENSORS = 4000  # sampled sensors; their 8 million pairs determine the reliability


def split_blocks(n_frames: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Split frames into two halves of alternating blocks of consecutive frames.

    Halves of alternating frames would be nearly equal, since contacts last several frames; halves
    of alternating blocks are nearly independent.

    Parameters
    ----------
    n_frames : int
        T >= 2.

    Returns
    -------
    even, odd : ndarray of int
        Frames of the even and the odd of `N_BLOCKS` blocks, or of T blocks if T is smaller.

    Raises
    ------
    InputError
        If there are fewer than 2 frames.
    """
    if n_frames < 2:
        raise InputError(f"split-half needs at least 2 frames, got {n_frames}")
    blocks = np.array_split(np.arange(n_frames), min(N_BLOCKS, n_frames))
    return np.concatenate(blocks[::2]), np.concatenate(blocks[1::2])


def correlation_and_reliability(readings: ArrayLike) -> tuple[Reals, float]:
    """Compute Pearson's r, and correlate it between the two halves, over pairs of sensors.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.

    Returns
    -------
    correlation : ndarray of shape (N, N)
        Of all frames: see `anisomap.numerics.similarity.correlation.pearson`.
    reliability : float
        Correlation between the halves, in [-1, 1]. 0 for fewer than 4 frames or 3 sensors, and if
        all pairs of a half are equal. For more than 4,000 sensors, a regular sample is used.
    """
    values = scale_extremes(readings)
    n_frames, n_sensors = values.shape
    if n_frames < MIN_FRAMES or n_sensors < MIN_SENSORS:
        return moments(values).correlation(), 0.0
    step = -(-n_sensors // _MAX_SENSORS)
    sampled = values[:, ::step]
    halves = [moments(sampled[half]) for half in split_blocks(n_frames)]
    # Merging the halves takes a tenth of the time of multiplying all frames again.
    whole = halves[0].merged(halves[1]) if step == 1 else moments(values)
    pairs = np.triu(np.ones((sampled.shape[1],) * 2, dtype=bool), 1)
    first, second = (half.correlation()[pairs] for half in halves)
    correlation = whole.correlation()
    if np.ptp(first) == 0 or np.ptp(second) == 0:
        return correlation, 0.0
    return correlation, float(np.corrcoef(first, second)[0, 1])
