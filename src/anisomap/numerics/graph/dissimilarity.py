"""Dissimilarities from similarities."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dpotrf, dpotri, spotrf, spotri

from anisomap.errors import InputError
from anisomap.numerics.precision import Reals, row_blocks, symmetric_from_upper
from anisomap.numerics.reliability.sampling_noise import typical_variance

NUMERICAL_ZERO = 1e-12
"""Similarities below this are rounding errors and count as 0."""

_ROUNDING = {np.float64: 1e-7, np.float32: 1e-5}  # relative asymmetry that is averaged out
# Tuned on simulated skins, seeds 101-105.
_INDIRECT_SHARE = 0.1  # weight of the correlation relative to the partial correlation
_NOISE_FACTOR = 5.0  # weight of the sampling variance
# Minimum of A in standard errors. Smaller similarities do not determine a length, which would be
# proportional to their power of -2.5. With .15, sensors without evidence were at 44 median radii;
# 1 lowered Mantel r by .02.
_LEAST_DIRECT = 0.3


def as_symmetric(matrix: ArrayLike, name: str, *, copy: bool = True) -> Reals:
    """Check that a matrix is square, symmetric and free of NaN, and make it exactly symmetric.

    matrix (N, N) -> (N, N), of float32 if the input is, else of float64; C-contiguous.
    """
    dtype = np.float32 if getattr(matrix, "dtype", None) == np.float32 else np.float64
    values: Reals = np.array(matrix, dtype, copy=copy or None, order="C")
    if values.ndim != 2 or values.shape[0] != values.shape[1] or not values.size:
        raise InputError(f"the {name} matrix has shape {values.shape}; it must be square, (N, N)")
    if np.isnan(values.min()):
        i, j = np.argwhere(np.isnan(values))[0]
        raise InputError(f"the {name} of sensors {i} and {j} is NaN; it must be a number")
    if np.array_equal(values, values.T):
        return values
    finite = np.abs(values[np.isfinite(values)])
    slack = _ROUNDING[values.dtype.type]
    if not np.allclose(values, values.T, rtol=slack, atol=slack / 100 * finite.max(initial=0)):
        raise InputError(f"the {name} matrix is not symmetric; average it with its transpose first")
    return np.asarray((values + values.T) / 2)


def regularised_reciprocal(similarity: ArrayLike, mu: float = 1.0) -> Reals:
    """Return the regularised reciprocal of a similarity, (N, N) -> (N, N).

    Negative similarities count as 0; the diagonal is ignored. mu: Weight of the regularisation, at
    least 0. With 0, unrelated pairs are infinitely far apart; so are all if none is positive.

    McGregor et al. (2011), section "r-ANISOMAP and I-ANISOMAP":
    ``M_ij = 1 / (max(s_ij, 0) + mu s_min)``, where s_min is the smallest positive element. The
    paper gives no value of mu. With 1, 0.1 and 0.01, Mantel r of maps by r- and I-ANISOMAP agreed
    within .002, except on rolling cylinders: within .04 and .09 (seeds 1 and 2).
    """
    if not (np.isfinite(mu) and mu >= 0):
        raise InputError(f"mu must be a finite number of at least 0, got {mu}")
    values = as_symmetric(similarity, "similarity")
    np.fill_diagonal(values, 0)
    values[values < NUMERICAL_ZERO] = 0
    smallest = float(values.min(where=values > 0, initial=np.inf))
    if np.isfinite(smallest):
        values += mu * smallest
    with np.errstate(divide="ignore"):
        dissimilarity = np.reciprocal(values, out=values)
    np.fill_diagonal(dissimilarity, 0)
    return dissimilarity


def direct_dissimilarity(similarity: ArrayLike, noise: ArrayLike) -> Reals:
    """Return a dissimilarity, (N, N), that is smallest between direct neighbours.

    similarity (N, N): Correlations S in [-1, 1]. Negative values count as 0; the diagonal is
        ignored. If none is positive, all sensors are infinitely far apart.
    noise (N, N): Sampling variance s_ij^2 of each correlation: see `sampling_variance`.

    ``M = A^(-1/2) (1 + 5 w s^2 / A^2)`` with ``A = (S (w Q + (1.1 - w) S))^(1/2)``, regularised by
    its smallest positive element, and at least .3 s. Q are the partial correlations of ``S + I``
    (a ridge), which are high only between neighbours. The second factor lengthens pairs with
    correlations within the noise, so that shortest paths do not prefer coincidental correlations.
    Each variance is at least the median variance, since variances of rarely touched sensors are
    underestimated.

    Partial correlations accumulate the noise of all correlations, and noise alone leaves no link
    certainly direct. Both terms therefore have the weight ``w = 1 - (1 - p)^2``, where p is the
    share of the variance of the correlations that is not sampling noise.
    """
    values = as_symmetric(similarity, "similarity")
    variance = as_symmetric(noise, "noise")
    if variance.shape != values.shape:
        raise InputError(f"the noise must have shape {values.shape}, got {variance.shape}")
    least = typical_variance(variance)
    weight = 1 - (1 - _reliability(values, least)) ** 2
    direct = partial_correlation(values)
    np.fill_diagonal(values, 0)
    values[values < NUMERICAL_ZERO] = 0
    smallest = np.inf
    for rows in row_blocks(len(values)):
        mixed = weight * np.maximum(direct[rows], 0)
        mixed += (1 - weight + _INDIRECT_SHARE) * values[rows]
        direct[rows] = np.sqrt(values[rows] * mixed)
        smallest = min(smallest, direct[rows].min(where=direct[rows] > 0, initial=np.inf))
    if not np.isfinite(smallest):
        return np.where(np.eye(len(values), dtype=bool), 0.0, np.inf)
    dissimilarity = values
    for rows in row_blocks(len(values)):
        noise_power = np.maximum(variance[rows], least)
        regularised = np.maximum(direct[rows] + smallest, _LEAST_DIRECT * np.sqrt(noise_power))
        stretch = 1 + weight * _NOISE_FACTOR * noise_power / regularised**2
        dissimilarity[rows] = stretch / np.sqrt(regularised)
    np.fill_diagonal(dissimilarity, 0)
    return dissimilarity


def _reliability(similarity: Reals, noise: float) -> float:
    """Return the share of the variance of similarities over pairs that is not sampling noise."""
    n_sensors = len(similarity)
    n_pairs = n_sensors * (n_sensors - 1)
    if n_pairs == 0:
        return 1.0
    diagonal = np.diag(similarity).astype(np.float64)
    mean = (similarity.sum(dtype=np.float64) - diagonal.sum()) / n_pairs
    squares = float(np.vdot(similarity, similarity)) - float(diagonal @ diagonal)
    spread = squares / n_pairs - mean**2
    return float(np.clip(1 - noise / spread, 0, 1)) if spread > 0 else 0.0


def partial_correlation(correlation: ArrayLike, ridge: float = 1.0) -> Reals:
    """Return the partial correlation of every pair of sensors given all others, (N, N) -> (N, N).

    ``-P_ij / (P_ii P_jj)^(1/2)`` with the precision ``P = (S + ridge I)^-1``; -1 on the diagonal,
    which is ignored in S. A greater ridge gives other sensors less influence.

    Whittaker (1990), Graphical Models in Applied Multivariate Statistics, chapter 5.
    """
    covariance = as_symmetric(correlation, "correlation")
    np.fill_diagonal(covariance, 1 + ridge)
    precision = invert_definite(covariance.copy())
    if precision is None:
        try:
            precision = np.linalg.inv(covariance)
        except np.linalg.LinAlgError:  # singular: not a matrix of correlations
            precision = np.linalg.pinv(covariance, hermitian=True)
        precision = (precision + precision.T) / 2
    scale = np.sqrt(np.abs(np.diag(precision)))
    scale[scale == 0] = 1.0
    for rows in row_blocks(len(precision)):
        precision[rows] /= np.outer(-scale[rows], scale)
    return precision


def invert_definite(matrix: Reals) -> Reals | None:
    """Invert a symmetric matrix (n, n), which is overwritten; None if it is not definite."""
    double = matrix.dtype == np.float64
    factorise, invert = (dpotrf, dpotri) if double else (spotrf, spotri)
    # For LAPACK, the upper triangle of a C-contiguous matrix is the lower one of its transpose.
    if factorise(matrix.T, lower=True, overwrite_a=True, clean=False)[1]:
        return None
    invert(matrix.T, lower=True, overwrite_c=True)
    return symmetric_from_upper(matrix)


def information_distance(information: ArrayLike) -> Reals:
    """Return the information distance of every pair of sensors, in nats, (N, N).

    ``D(A, B) = H(A, B) - I(A; B) = H(A) + H(B) - 2 I(A; B)``: a metric, except that the distance of
    sensors that determine each other is 0. information (N, N): See `mutual_information`.

    McGregor et al. (2011), section "Information Distance"; Crutchfield (1990), Information and its
    metric.
    """
    values = as_symmetric(information, "mutual information")
    entropy = np.diag(values).copy()
    for rows in row_blocks(len(values)):
        values[rows] = np.add.outer(entropy[rows], entropy) - 2 * values[rows]
    values[values < NUMERICAL_ZERO] = 0
    return values
