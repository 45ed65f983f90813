"""Split-half reliability of correlations."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.similarity.correlation import pearson

_ENOUGH = 4000  # sensors, to tell what pairs are like


N_BLOCKS = 20
"""Stretches of time that a recording is cut into, to compare one half of them with the other."""


_FEWEST_FRAMES = 4


_FEWEST_SENSORS = 3


def split_blocks(n_frames: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Share the frames out into two halves of alternating stretches of time.

    Parameters
    ----------
    n_frames : int
        T >= 2.

    Returns
    -------
    even, odd : ndarray of int
        Frames of the blocks 0, 2, ... and 1, 3, ... of `N_BLOCKS` (fewer if T is smaller). The
        halves are nearly independent, where alternating frames would be nearly the same.
    """
    if n_frames < 2:
        raise InputError(f"{n_frames} frames have no halves; give 2 or more")
    blocks = np.array_split(np.arange(n_frames), min(N_BLOCKS, n_frames))
    return np.concatenate(blocks[::2]), np.concatenate(blocks[1::2])


def split_half_reliability(readings: ArrayLike) -> float:
    """Tell how well the correlations of one half of a recording predict those of the other.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings, T >= 4, N >= 3.

    Returns
    -------
    float
        Correlation over pairs of sensors of Pearson's r in the two halves of `split_blocks`; in
        [-1, 1]. Of more than 4,000 sensors, evenly chosen ones are compared. 0 where all pairs are
        alike in a half, and where there are fewer than 4 frames or 3 sensors.
    """
    values = np.asarray(readings)
    if len(values) < _FEWEST_FRAMES or values.shape[1] < _FEWEST_SENSORS:
        return 0.0
    values = values[:, :: -(-values.shape[1] // _ENOUGH)]
    pairs = np.triu_indices(values.shape[1], 1)
    first, second = (pearson(values[half])[pairs] for half in split_blocks(len(values)))
    if np.ptp(first) == 0 or np.ptp(second) == 0:
        return 0.0
    return float(np.corrcoef(first, second)[0, 1])
