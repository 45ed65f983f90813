"""Correlations of resampled blocks of frames, from moments that all resamples share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.precision import mirror

_MIN_FLOAT32_SENSORS = 512  # as products of `accumulators`: below, float32 saves no time
_BLOCKS_AT_ONCE = 8  # blocks whose products are held in memory; chosen by hand


def resampled_correlation(
    readings: NDArray[np.floating], edges: NDArray[np.intp], weights: NDArray[np.float64]
) -> NDArray[np.floating]:
    """Compute Pearson's r of every pair of sensors over weighted blocks of frames.

    Parameters
    ----------
    readings : ndarray of shape (T, N)
        Finite readings.
    edges : ndarray of int, shape (B + 1,)
        First frames of the blocks, and T.
    weights : ndarray of shape (R, B)
        Non-negative weight of the frames of each block, in each of R resamples.

    Returns
    -------
    ndarray of shape (R, N, N)
        Symmetric, ones on the diagonal; 0 for sensors that are constant in a resample. float32
        from 512 sensors on.
    """
    n_sensors = readings.shape[1]
    single = n_sensors >= _MIN_FLOAT32_SENSORS
    deviation = readings.std(axis=0)
    scaled = (readings - readings.mean(axis=0)) / np.where(deviation > 0, deviation, 1)
    scaled = scaled.astype(np.float32 if single else np.float64, copy=False)
    share = weights / (weights @ np.diff(edges))[:, None]
    share = share.astype(scaled.dtype, copy=False)
    sums = np.add.reduceat(scaled, edges[:-1], axis=0)
    means = share @ sums
    found = np.zeros((len(weights), n_sensors * n_sensors), scaled.dtype)
    for begin in range(0, len(edges) - 1, _BLOCKS_AT_ONCE):
        chosen = range(begin, min(begin + _BLOCKS_AT_ONCE, len(edges) - 1))
        frames = (scaled[edges[i] : edges[i + 1]] for i in chosen)
        products = np.array([(part.T @ part).ravel() for part in frames])
        found += share[:, chosen] @ products
    result = found.reshape(-1, n_sensors, n_sensors)
    for matrix, mean in zip(result, means, strict=True):
        covariance = matrix - np.outer(mean, mean)
        variance = np.diag(covariance)
        scale = np.where(variance > 0, 1 / np.sqrt(np.where(variance > 0, variance, 1)), 0)
        np.multiply(covariance, np.outer(scale, scale), out=matrix)
        mirror(matrix, upper=True)
        np.fill_diagonal(matrix, 1.0)
    return np.asarray(np.clip(result, -1, 1, out=result))
