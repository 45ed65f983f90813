"""Correlations of resampled blocks of frames, from moments that all resamples share."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.precision import mirror

_SENSORS_AT_ONCE = 32  # sensors scaled at a time; chosen by hand
_FLOAT32_RANGE = 1e15  # of readings that are centred in float32
_STACKED_BYTES = 1 << 24  # of products of all blocks for some sensors; chosen by hand


def resampled_correlation(
    readings: NDArray[np.floating], edges: NDArray[np.intp], weights: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Compute Pearson's r of every pair of sensors over weighted blocks of frames.

    readings (T, N), weights (R, B) -> (R, N, N).
    """
    scaled = _scaled(readings)
    n_sensors, n_blocks = len(scaled), len(edges) - 1
    share = weights / (weights @ np.diff(edges))[:, None]
    share = share.astype(np.float32)
    means = share @ np.add.reduceat(scaled, edges[:-1], axis=1).T
    found = np.zeros((len(weights), n_sensors, n_sensors), np.float32)
    blocks = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    at_once = max(8, _STACKED_BYTES // (4 * n_blocks * n_sensors))
    workspace = np.empty(n_blocks * min(at_once, n_sensors) * n_sensors, np.float32)
    for begin in range(0, n_sensors, at_once):
        # Of each sensor with itself and all later ones.
        rows, columns = slice(begin, begin + at_once), slice(begin, None)
        shape = found[0, rows, columns].shape
        products = workspace[: n_blocks * math.prod(shape)].reshape(n_blocks, *shape)
        for product, (first, end) in zip(products, blocks, strict=True):
            np.matmul(scaled[rows, first:end], scaled[columns, first:end].T, out=product)
        weighted = share @ products.reshape(n_blocks, -1)
        found[:, rows, columns] = weighted.reshape(len(weights), *shape)
    for matrix, mean in zip(found, means, strict=True):
        covariance = matrix - np.outer(mean, mean)
        variance = np.diag(covariance)
        scale = np.where(variance > 0, 1 / np.sqrt(np.where(variance > 0, variance, 1)), 0)
        np.multiply(covariance, np.outer(scale, scale), out=matrix)
        mirror(matrix, upper=True)
        np.fill_diagonal(matrix, 1.0)
    return np.asarray(np.clip(found, -1, 1, out=found))


def _scaled(readings: NDArray[np.floating]) -> NDArray[np.float32]:
    """Centre the readings of each sensor and scale them to [-1, 1], shape (N, T)."""
    scaled = np.empty(readings.shape[::-1], np.float32)
    for begin in range(0, len(scaled), _SENSORS_AT_ONCE):
        part = np.ascontiguousarray(readings[:, begin : begin + _SENSORS_AT_ONCE].T)
        # A difference of numbers in float32 is rounded relative to itself.
        single = part.dtype == np.float32 and np.abs(part).max(initial=0) < _FLOAT32_RANGE
        if not single:
            part = part.astype(np.float64)
        part = part - part[:, :1]  # exactly 0 for constant sensors
        part -= part.mean(axis=1)[:, None]
        # Squares of readings, such as in a standard deviation, might underflow.
        greatest = np.abs(part).max(axis=1)
        part /= np.where(greatest > 0, greatest, 1)[:, None]
        scaled[begin : begin + _SENSORS_AT_ONCE] = part
    return scaled
