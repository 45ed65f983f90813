"""Ellipses of covariances, for pictures and tables."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import gammaincinv

LEVEL = 0.95
"""Probability that an ellipse contains."""


def ellipses(
    covariances: ArrayLike, level: float = LEVEL
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the half axes of the ellipses, or ellipsoids, of covariances.

    Parameters
    ----------
    covariances : array_like of shape (n, k, k)
        Symmetric; NaN for unknown ones.
    level : float
        Probability that each contains, for a normal distribution.

    Returns
    -------
    lengths : ndarray of shape (n, k)
        Lengths of the half axes, the longest first; NaN if unknown.
    directions : ndarray of shape (n, k, k)
        Unit vectors along them, in rows.
    """
    values = np.asarray(covariances, dtype=np.float64)
    known = np.isfinite(values).all(axis=(1, 2))
    lengths = np.full(values.shape[:2], np.nan)
    directions = np.full(values.shape, np.nan)
    found, vectors = np.linalg.eigh(values[known])
    lengths[known] = radius(values.shape[1], level) * np.sqrt(np.maximum(found[:, ::-1], 0))
    directions[known] = vectors[:, :, ::-1].transpose(0, 2, 1)
    return lengths, directions


def radius(dimensions: int, level: float = LEVEL) -> float:
    """Return the radius of the ball that holds a share of a standard normal distribution."""
    return float(np.sqrt(2 * gammaincinv(dimensions / 2, level)))  # chi distribution
