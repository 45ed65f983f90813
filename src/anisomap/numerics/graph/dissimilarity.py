"""From how alike sensors are to how far apart: similarities turned into dissimilarities."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dpotrf, dpotri, spotrf, spotri

from anisomap.errors import InputError
from anisomap.numerics.precision import Reals, as_reals, is_symmetric, mirror, row_blocks
from anisomap.numerics.reliability.sampling_noise import typical_variance

NUMERICAL_ZERO = 1e-12
"""A similarity below this is rounding error: its reciprocal would be no distance but noise."""

_ROUNDING = {np.float64: 1e-7, np.float32: 1e-5}
_SHARE_OF_INDIRECT = 0.1
_CAUTION = 5.0


def as_symmetric(matrix: ArrayLike, what: str, *, copy: bool = True) -> Reals:
    """Check that a matrix is square, free of NaN and symmetric, and make it so to the last bit.

    Parameters
    ----------
    matrix : array_like of shape (N, N)
        Infinities are allowed.
    what : str
        What to call it in an error: ``"similarity"``.
    copy : bool
        If not, the matrix itself may be returned, which must not be changed then.

    Returns
    -------
    ndarray of shape (N, N)
        A copy in which (i, j) and (j, i) are the same number: one bit of difference can mislead a
        shortest path. In float64, or in float32 if that is what was given.

    Raises
    ------
    InputError
        If it is not square, holds NaN, or differs from its transpose by more than rounding.
    """
    values = as_reals(matrix, copy=copy)
    if values.ndim != 2 or values.shape[0] != values.shape[1] or not values.size:
        raise InputError(f"the {what} matrix has shape {values.shape}; it must be square, (N, N)")
    if np.isnan(values.min()):
        i, j = np.argwhere(np.isnan(values))[0]
        raise InputError(f"the {what} of sensors {i} and {j} is NaN; it must be a number")
    if is_symmetric(values):
        return values
    finite = np.abs(values[np.isfinite(values)])
    slack = _ROUNDING[values.dtype.type]
    if not np.allclose(values, values.T, rtol=slack, atol=slack / 100 * finite.max(initial=0)):
        raise InputError(f"the {what} matrix is not symmetric; average it with its transpose first")
    return np.asarray((values + values.T) / 2)


def regularised_reciprocal(similarity: ArrayLike, mu: float = 1.0) -> Reals:
    """Turn a similarity into a dissimilarity that grows without bound as similarity vanishes.

    Parameters
    ----------
    similarity : array_like of shape (N, N)
        Correlations, information, or anything that is greater the more alike. Negative ones count
        as 0. The diagonal is not looked at.
    mu : float
        Weight of the regularisation, at least 0. With 0, unrelated pairs are infinitely apart.

    Returns
    -------
    ndarray of shape (N, N)
        A semi-metric: symmetric, zero diagonal, elsewhere positive or infinite. Infinite
        everywhere if no pair has a positive similarity. In float32 if that is what was given.

    Raises
    ------
    InputError
        If `mu` is negative or not finite, or the matrix is not symmetric.

    Notes
    -----
    McGregor et al. (2011), section "r-ANISOMAP and I-ANISOMAP":
    ``M_ij = 1 / (max(s_ij, 0) + mu s_min)``, where s_min is the smallest positive element. The
    paper gives no value of mu; 1, 0.1 and 0.01 gave the same map to three digits of its score.
    """
    if not (np.isfinite(mu) and mu >= 0):
        raise InputError(f"mu is {mu}; it must be a number of at least 0")
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
    """Turn correlations into a dissimilarity that trusts direct neighbours most.

    Parameters
    ----------
    similarity : array_like of shape (N, N)
        Correlations S in [-1, 1]. Negative ones count as 0. The diagonal is not looked at.
    noise : array_like of shape (N, N)
        Sampling variance s_ij^2 of each correlation: see
        `anisomap.numerics.reliability.sampling_noise.sampling_variance`.

    Returns
    -------
    ndarray of shape (N, N)
        A semi-metric: symmetric, zero diagonal, elsewhere positive; infinite everywhere if no
        pair has a positive correlation.

    Raises
    ------
    InputError
        If a matrix is not symmetric, or their shapes disagree.

    Notes
    -----
    ``M = A^(-1/2) (1 + 5 s^2 / A^2)`` with ``A = (S (Q + S / 10))^(1/2)``, regularised by its
    smallest positive element. Q are partial correlations, those that no other sensors explain, of
    ``S + I`` (a ridge): high between neighbours alone. The second factor lengthens what may be
    there by chance, so that shortest paths do not collect lucky pairs. The variance of a pair
    counts as at least the typical one: sensors that were hardly touched look steadier than they
    are.
    """
    values = as_symmetric(similarity, "similarity")
    variance = as_symmetric(noise, "noise")
    if variance.shape != values.shape:
        raise InputError(f"the noise has shape {variance.shape}, the similarity {values.shape}")
    kinship = partial_correlation(values)
    np.fill_diagonal(values, 0)
    values[values < NUMERICAL_ZERO] = 0
    smallest = np.inf
    for rows in row_blocks(len(values)):
        direct = np.maximum(kinship[rows], 0) + _SHARE_OF_INDIRECT * values[rows]
        kinship[rows] = np.sqrt(values[rows] * direct)
        smallest = min(smallest, kinship[rows].min(where=kinship[rows] > 0, initial=np.inf))
    if not np.isfinite(smallest):
        return np.where(np.eye(len(values), dtype=bool), 0.0, np.inf)
    least = typical_variance(variance)
    dissimilarity = values
    for rows in row_blocks(len(values)):
        regularised = kinship[rows] + smallest
        cautious = 1 + _CAUTION * np.maximum(variance[rows], least) / regularised**2
        dissimilarity[rows] = cautious / np.sqrt(regularised)
    np.fill_diagonal(dissimilarity, 0)
    return dissimilarity


def partial_correlation(correlation: ArrayLike, ridge: float = 1.0) -> Reals:
    """Tell what every pair of sensors shares that no other sensor explains.

    Parameters
    ----------
    correlation : array_like of shape (N, N)
        Symmetric; the diagonal is not looked at.
    ridge : float
        Variance, above 0, that is added to every sensor as a share of its own.

    Returns
    -------
    ndarray of shape (N, N)
        ``-P_ij / (P_ii P_jj)^(1/2)`` with the precision ``P = (S + ridge I)^-1``; -1 on the
        diagonal. A greater ridge lets sensors explain less of each other.

    Notes
    -----
    Whittaker (1990), Graphical Models in Applied Multivariate Statistics, chapter 5.
    """
    covariance = as_symmetric(correlation, "correlation")
    np.fill_diagonal(covariance, 1 + ridge)
    precision = _inverse(covariance)
    scale = np.sqrt(np.abs(np.diag(precision)))
    scale[scale == 0] = 1.0
    for rows in row_blocks(len(precision)):
        precision[rows] /= np.outer(-scale[rows], scale)
    return precision


def _inverse(covariance: Reals) -> Reals:
    """Invert a symmetric matrix in its own place, by Cholesky's factors where it has them."""
    diagonal = np.diag(covariance).copy()
    double = covariance.dtype == np.float64
    factorise, invert = (dpotrf, dpotri) if double else (spotrf, spotri)
    _, failed = factorise(covariance.T, lower=True, overwrite_a=True, clean=False)
    if not failed:
        invert(covariance.T, lower=True, overwrite_c=True)
        mirror(covariance, upper=True)
        return covariance
    mirror(covariance, upper=False)  # what was overwritten is the other half
    np.fill_diagonal(covariance, diagonal)
    try:
        inverse = np.linalg.inv(covariance)
    except np.linalg.LinAlgError:  # not a matrix of correlations
        inverse = np.linalg.pinv(covariance, hermitian=True)
    return np.asarray((inverse + inverse.T) / 2)


def information_distance(information: ArrayLike) -> Reals:
    """Give the information distance of every pair of sensors.

    Parameters
    ----------
    information : array_like of shape (N, N)
        Mutual information in nats, with the entropies on the diagonal, as from
        `anisomap.numerics.similarity.information.mutual_information`.

    Returns
    -------
    ndarray of shape (N, N)
        ``D(A, B) = H(A, B) - I(A; B) = H(A) + H(B) - 2 I(A; B)`` in nats: a metric (but for
        sensors that determine each other, which are 0 apart).

    Raises
    ------
    InputError
        If the matrix is not symmetric.

    Notes
    -----
    McGregor et al. (2011), section "Information Distance"; Crutchfield (1990).
    """
    values = as_symmetric(information, "mutual information")
    entropy = np.diag(values).copy()
    for rows in row_blocks(len(values)):
        values[rows] = np.add.outer(entropy[rows], entropy) - 2 * values[rows]
    values[values < NUMERICAL_ZERO] = 0
    return values
