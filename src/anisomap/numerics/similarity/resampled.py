"""Correlations of resampled blocks of frames, from moments that all resamples share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.precision import mirror

_MIN_FLOAT32_SENSORS = 512  # below, matrices are small
_SENSORS_AT_ONCE = 32  # sensors standardised at a time; chosen by hand
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
        Symmetric, ones on the diagonal; 0 for sensors that are constant in a resample. Accurate
        to 1e-5; float32 from 512 sensors on.
    """
    n_sensors = readings.shape[1]
    scaled = np.empty(readings.shape, np.float32)
    for begin in range(0, n_sensors, _SENSORS_AT_ONCE):
        part = readings[:, begin : begin + _SENSORS_AT_ONCE].astype(np.float64)
        part -= part.mean(axis=0)
        deviation = np.sqrt(np.einsum("ti,ti->i", part, part) / len(part))
        part /= np.where(deviation > 0, deviation, 1)
        scaled[:, begin : begin + _SENSORS_AT_ONCE] = part
    share = weights / (weights @ np.diff(edges))[:, None]
    share = share.astype(np.float32)
    sums = np.add.reduceat(scaled, edges[:-1], axis=0)
    means = share @ sums
    found = np.zeros((len(weights), n_sensors * n_sensors), np.float32)
    for begin in range(0, len(edges) - 1, _BLOCKS_AT_ONCE):
        chosen = range(begin, min(begin + _BLOCKS_AT_ONCE, len(edges) - 1))
        frames = (scaled[edges[i] : edges[i + 1]] for i in chosen)
        products = np.array([(part.T @ part).ravel() for part in frames])
        found += share[:, chosen] @ products
    single = n_sensors >= _MIN_FLOAT32_SENSORS
    result = found.reshape(-1, n_sensors, n_sensors)
    result = result.astype(np.float32 if single else np.float64, copy=False)
    for matrix, mean in zip(result, means, strict=True):
        covariance = matrix - np.outer(mean, mean)
        variance = np.diag(covariance)
        scale = np.where(variance > 0, 1 / np.sqrt(np.where(variance > 0, variance, 1)), 0)
        np.multiply(covariance, np.outer(scale, scale), out=matrix)
        mirror(matrix, upper=True)
        np.fill_diagonal(matrix, 1.0)
    return np.asarray(np.clip(result, -1, 1, out=result))
