"""Share of the correlations that no function of distance explains."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import isotonic_regression
from scipy.spatial.distance import pdist, squareform

_MAX_SENSORS = 1000  # regularly sampled sensors; their 500,000 pairs suffice for one share
_SIGNIFICANT = 2.0  # standard deviations from which a fitted correlation counts as significant
_MIN_VARIANCE_FACTOR = 1e-4  # of correlations of nearly 1; bounds rounding errors
_MIN_PAIRS = 30  # fewer significant pairs determine no share; chosen by hand


def unexplained_share(
    similarity: ArrayLike,
    positions: ArrayLike,
    noise: float,
    *,
    known: ArrayLike | None = None,
) -> float:
    """Estimate the share of the variance of correlations that distances do not explain.

    Parameters
    ----------
    similarity : array_like of shape (N, N)
        Correlations; the diagonal is ignored.
    positions : array_like of shape (N, k)
    noise : float
        Sampling variance of the correlation of unrelated sensors.
    known : array_like of bool, shape (N, N), optional
        Mask of the known correlations; all by default.

    Returns
    -------
    float
        At most 1; near or below 0 if one decreasing function of distance explains the correlations
        within their sampling noise, whatever the length of the recording. 0 for fewer than 30
        significant pairs.

    Notes
    -----
    The function is a monotone regression (Barlow et al. 1972). A correlation c has the sampling
    variance ``noise (1 - c^2)^2``; it is subtracted from the squared residuals. Only pairs whose
    fitted correlation exceeds two standard deviations count: residuals of distant pairs are noise.
    """
    values, points = np.asarray(similarity), np.asarray(positions)
    step = -(-len(values) // _MAX_SENSORS)
    values, points = values[::step, ::step], points[::step]
    distances = pdist(points)
    correlations = squareform(values.astype(np.float64), checks=False)
    if known is not None and not np.all(known):
        among = squareform(np.asarray(known)[::step, ::step].astype(np.float64), checks=False) > 0
        distances, correlations = distances[among], correlations[among]
    order = np.argsort(distances, kind="stable")
    fitted = np.empty_like(correlations)
    fitted[order] = isotonic_regression(correlations[order], increasing=False).x
    significant = fitted > _SIGNIFICANT * np.sqrt(noise)
    if np.count_nonzero(significant) < _MIN_PAIRS:
        return 0.0
    correlations, fitted = correlations[significant], fitted[significant]
    sampling = noise * np.maximum((1 - fitted**2) ** 2, _MIN_VARIANCE_FACTOR)
    spread = float(((correlations - correlations.mean()) ** 2).sum())
    residual = float(((correlations - fitted) ** 2 - sampling).sum())
    return residual / spread if spread > 0 else 0.0
