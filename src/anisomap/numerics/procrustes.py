"""Procrustes analysis: similarity transforms and their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import gammaincinv

from anisomap.errors import InputError
from anisomap.numerics.precision import Floats

SINGULAR = 1e-9
"""Relative singular value below which points are flat: reflection and rotation fit equally."""

_MAX_ITERATIONS = 100  # of robust fits, which converge within about 20
_FIRST_ITERATIONS = 10  # with least absolute distances
_CONVERGED = 1e-6  # largest change of a weight
_WIDTH = 2.0  # noise scales at which the weight is 1/4; tuned with `evaluation.difference`


@dataclass(frozen=True, eq=False)
class Similarity:
    """The map ``x -> scale * rotation @ x + translation``.

    rotation (k, k): Orthogonal; a reflection if its determinant is -1.
    scale: Positive.
    translation (k,)
    """

    rotation: Floats
    scale: float
    translation: Floats

    @property
    def reflected(self) -> bool:
        """Whether the map is a mirror image."""
        return bool(np.linalg.det(self.rotation) < 0)

    def apply(self, points: Floats) -> Floats:
        """Transform points, shape (n, k)."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)


def fit_similarity(
    source: Floats,
    target: Floats,
    weights: Floats | None = None,
    *,
    scaling: bool = True,
    reflection: bool | None = None,
) -> Similarity:
    """Fit the similarity with the least weighted sum of squared distances to the target.

    source, target (n, k), weights (n,). Umeyama (1991), IEEE Trans. PAMI 13(4): 376-380.
    """
    shares = np.ones(len(source)) if weights is None else np.asarray(weights, dtype=np.float64)
    shares = shares / shares.sum()
    source_mean, target_mean = shares @ source, shares @ target
    x, y = source - source_mean, target - target_mean
    with np.errstate(over="ignore", invalid="ignore"):
        covariance = (y * shares[:, None]).T @ x
    if not np.isfinite(covariance).all():
        raise InputError("positions that are aligned are not finite, or their squares are not")
    left, singular, right = np.linalg.svd(covariance)
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


def similarity_freedom(n_points: int, dimensions: int, *, scaling: bool = True) -> int:
    """Return the degrees of freedom of the residuals of a similarity, at least 0."""
    k = dimensions
    return max(0, n_points * k - k - k * (k - 1) // 2 - scaling)


def extent(points: Floats) -> float:
    """Return the root of the summed variance of the coordinates. points (n, k)."""
    return float(np.sqrt(np.sum(np.var(points, axis=0))))


def noise_scale(residuals: Floats, dimensions: int) -> float:
    """Robustly estimate the standard deviation per coordinate from lengths of residuals.

    It is the median length divided by the median of the chi distribution.
    """
    return float(np.median(residuals) / np.sqrt(2 * gammaincinv(dimensions / 2, 0.5)))


def fit_similarity_robustly(source: Floats, target: Floats) -> Similarity:
    """Fit a similarity that is robust to points far from their target. source, target (n, k).

    Iteratively reweighted least squares: first least absolute distances, then the weights of Geman
    & McClure (1987), which vanish for large residuals. Fewer than half of the points may be far
    from their targets.
    """
    fits = []
    # Residuals of an exact fit are rounding errors, whose ratios are meaningless.
    least = max(float(np.finfo(float).eps * np.ptp(target)), float(np.finfo(float).tiny))
    for hand in (False, True):
        fit = fit_similarity(source, target, reflection=hand)
        weights = np.ones(len(source))
        for i in range(_MAX_ITERATIONS):
            residuals = np.linalg.norm(fit.apply(source) - target, axis=1)
            scale = max(noise_scale(residuals, source.shape[1]), least)
            before = weights
            if i < _FIRST_ITERATIONS:
                weights = scale / np.maximum(residuals, scale)
            else:
                weights = 1 / (1 + (residuals / (_WIDTH * scale)) ** 2) ** 2
            fit = fit_similarity(source, target, weights, reflection=hand)
            if i > _FIRST_ITERATIONS and np.abs(weights - before).max() < _CONVERGED:
                break
        fits.append((float(np.median(residuals)), hand, fit))
    return min(fits, key=lambda found: found[:2])[2]


def rotations(angles: Floats) -> Floats:
    """Return rotations by angles in the plane, (B, 1), or rotation vectors, (B, 3): (B, k, k)."""
    if angles.shape[1] == 3:
        return Rotation.from_rotvec(angles).as_matrix()
    return Rotation.from_rotvec(np.pad(angles, ((0, 0), (2, 0)))).as_matrix()[:, :2, :2]


def similarity_derivatives(points: Floats) -> Floats:
    """Return derivatives of points by shift, rotation and scale, in this order, (n, k, p)."""
    n, k = points.shape
    columns = [np.tile(np.eye(k), (n, 1, 1))]
    for i in range(k):
        for j in range(i):
            turn = np.zeros((n, k, 1))
            turn[:, i, 0], turn[:, j, 0] = points[:, j], -points[:, i]
            columns.append(turn)
    return np.concatenate([*columns, points[:, :, None]], axis=2)


def leverage(fitted: Floats, points: Floats) -> Floats:
    """Return the variances of points (m, k) under a similarity fitted to points (n, k), (m,).

    Each is a sum over coordinates; errors of coordinates are independent and of variance 1.
    """
    centre, size = fitted.mean(axis=0), extent(fitted)
    here, there = (similarity_derivatives((one - centre) / size) for one in (fitted, points))
    spread = np.linalg.pinv(np.einsum("nki,nkj->ij", here, here), rcond=1e-9)
    return np.asarray(np.einsum("mki,ij,mkj->m", there, spread, there))
