"""Block bootstrap: blocks of consecutive frames, and weights that resample them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.reliability.sampling_noise import correlation_time

MAX_BLOCKS = 100
"""Maximum number of blocks: more estimate a variance hardly better and take more time."""

MIN_BLOCKS = 8
"""Minimum number of blocks: fewer have hardly different resamples; chosen by hand."""

_BLOCK_FACTOR = 4  # block length / lag at which autocorrelations fade; see `block_edges`
_MAX_SENSORS = 64  # regularly sampled sensors whose autocorrelations give the length of blocks


def block_edges(readings: ArrayLike) -> NDArray[np.intp]:
    """Split a recording into blocks that are long against the autocorrelation of its readings.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings, T >= 8.

    Returns
    -------
    ndarray of int, shape (B + 1,)
        First frame of each of B blocks, and T. Blocks are 4 times as long as the lag at which the
        median autocorrelation falls below .1, but 8 to 100 in number.

    Notes
    -----
    Kuensch (1989), doi:10.1214/aos/1176347265: resampling blocks of frames estimates variances if
    blocks are long against the autocorrelation and few against the recording. Blocks of 2 to 8
    times that lag gave about equal variances on simulated skins, seeds 201 to 212.
    """
    values = np.asarray(readings)
    length = _BLOCK_FACTOR * max(1, _time(values))
    count = min(max(len(values) // length, MIN_BLOCKS), MAX_BLOCKS, len(values))
    return np.linspace(0, len(values), count + 1).astype(np.intp)


def balanced_weights(
    n_blocks: int, n_resamples: int, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Draw how often each block occurs in each resample.

    Parameters
    ----------
    n_blocks, n_resamples : int
    rng : numpy.random.Generator

    Returns
    -------
    ndarray of shape (R, B)
        Whole numbers; each row sums to B, each column to R.

    Notes
    -----
    The balanced bootstrap of Davison, Hinkley & Schechtman (1986), doi:10.1093/biomet/73.3.555:
    every block is drawn equally often over all resamples, so that their mean is unbiased.
    """
    drawn = rng.permutation(np.tile(np.arange(n_blocks), n_resamples)).reshape(-1, n_blocks)
    return np.array([np.bincount(row, minlength=n_blocks) for row in drawn], dtype=np.float64)


def _time(readings: NDArray[Any]) -> int:
    step = -(-readings.shape[1] // _MAX_SENSORS)
    return correlation_time(readings[:, ::step])
