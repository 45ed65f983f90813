"""Procrustes analysis: the similarity or rigid transform between two sets of points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

SINGULAR = 1e-9
"""Relative singular value below which points are flat: reflection and rotation fit equally."""

_MAX_ITERATIONS = 100  # of robust fits, which converge within about 20
_FIRST_ITERATIONS = 10  # with least absolute distances
_CONVERGED = 1e-6  # largest change of a weight
_WIDTH = 2.0  # noise scales at which the weight is 1/4; tuned with `evaluation.difference`


@dataclass(frozen=True, eq=False)
class Similarity:
    """The map ``x -> scale * rotation @ x + translation``.

    Attributes
    ----------
    rotation : ndarray of shape (k, k)
        Orthogonal; a reflection if its determinant is -1.
    scale : float
        Positive.
    translation : ndarray of shape (k,)
    """

    rotation: NDArray[np.float64]
    scale: float
    translation: NDArray[np.float64]

    @property
    def reflected(self) -> bool:
        """Whether the map is a mirror image."""
        return bool(np.linalg.det(self.rotation) < 0)

    def apply(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transform points, shape (n, k)."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)


def fit_similarity(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    weights: NDArray[np.float64] | None = None,
    *,
    scaling: bool = True,
    reflection: bool | None = None,
) -> Similarity:
    """Fit the similarity that minimises the weighted sum of squared distances to the target.

    Parameters
    ----------
    source, target : ndarray of shape (n, k)
    weights : ndarray of shape (n,), optional
        Non-negative; 1 by default.
    scaling : bool
        Whether to fit the scale; it is 1 otherwise.
    reflection : bool, optional
        Whether the result is a mirror image; by default whichever fits better, and the rotation if
        both fit equally, as for flat points in space.

    Returns
    -------
    Similarity
        Its scale is 0 if the source is a single point.

    Notes
    -----
    Umeyama (1991), IEEE Trans. PAMI 13(4): 376-380, with weights.
    """
    shares = np.ones(len(source)) if weights is None else np.asarray(weights, dtype=np.float64)
    shares = shares / shares.sum()
    source_mean, target_mean = shares @ source, shares @ target
    x, y = source - source_mean, target - target_mean
    left, singular, right = np.linalg.svd((y * shares[:, None]).T @ x)
    sign = np.ones(len(singular))
    handed = np.linalg.det(left @ right) < 0
    wanted = handed and singular[-1] > SINGULAR * singular[0] if reflection is None else reflection
    if handed != wanted:
        sign[-1] = -1.0
    rotation = (left * sign) @ right
    spread = float(shares @ np.einsum("nd,nd->n", x, x))
    scale = 1.0
    if scaling:
        scale = max(0.0, float(singular @ sign) / spread) if spread > 0 else 0.0
    return Similarity(rotation, scale, target_mean - scale * rotation @ source_mean)


def noise_scale(residuals: NDArray[np.float64], dimensions: int) -> float:
    """Estimate the standard deviation per coordinate from lengths of residuals, robustly.

    The median length over that of a standard normal vector (the median of the chi distribution).
    """
    return float(np.median(residuals) / np.sqrt(2 * gammaincinv(dimensions / 2, 0.5)))


def fit_similarity_robustly(
    source: NDArray[np.float64],
    target: NDArray[np.float64],
    *,
    scaling: bool = True,
    reflection: bool | None = None,
) -> Similarity:
    """Fit a similarity that points far from their target do not bend.

    Parameters
    ----------
    source, target : ndarray of shape (n, k)
    scaling : bool
        Whether to fit the scale; it is 1 otherwise.
    reflection : bool, optional
        Whether the result is a mirror image.

    Returns
    -------
    Similarity
        By default the rotation or the mirror image, whichever has the smaller median residual.

    Notes
    -----
    Iteratively reweighted least squares: first least absolute distances, then the weights of
    Geman & McClure (1987), which vanish for large residuals. Fewer than half of the points may be
    far off.
    """
    fits = []
    # Residuals of an exact fit are rounding errors, of which the ratios mean nothing.
    least = max(float(np.finfo(float).eps * np.ptp(target)), float(np.finfo(float).tiny))
    for hand in (False, True) if reflection is None else (reflection,):
        fit = fit_similarity(source, target, scaling=scaling, reflection=hand)
        weights = np.ones(len(source))
        for i in range(_MAX_ITERATIONS):
            residuals = np.linalg.norm(fit.apply(source) - target, axis=1)
            scale = max(noise_scale(residuals, source.shape[1]), least)
            before = weights
            if i < _FIRST_ITERATIONS:
                weights = scale / np.maximum(residuals, scale)
            else:
                weights = 1 / (1 + (residuals / (_WIDTH * scale)) ** 2) ** 2
            fit = fit_similarity(source, target, weights, scaling=scaling, reflection=hand)
            if i > _FIRST_ITERATIONS and np.abs(weights - before).max() < _CONVERGED:
                break
        fits.append((float(np.median(residuals)), hand, fit))
    return min(fits, key=lambda found: found[:2])[2]
