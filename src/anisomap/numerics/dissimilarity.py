"""From how alike sensors are to how far apart: similarities turned into dissimilarities."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError

NUMERICAL_ZERO = 1e-12
"""A similarity below this is rounding error: its reciprocal would be no distance but noise."""

_SHARE_OF_INDIRECT = 0.1
_CAUTION = 5.0


def symmetric(matrix: ArrayLike, what: str) -> NDArray[np.float64]:
    """Check that a matrix is square, free of NaN and symmetric, and make it so to the last bit.

    Parameters
    ----------
    matrix : array_like of shape (N, N)
        Infinities are allowed.
    what : str
        What to call it in an error: ``"similarity"``.

    Returns
    -------
    ndarray of shape (N, N)
        A copy in which (i, j) and (j, i) are the same number: one bit of difference can mislead a
        shortest path.

    Raises
    ------
    InputError
        If it is not square, holds NaN, or differs from its transpose by more than rounding.
    """
    values = np.array(matrix, dtype=np.float64)
    if values.ndim != 2 or values.shape[0] != values.shape[1] or not values.size:
        raise InputError(f"the {what} matrix has shape {values.shape}; it must be square, (N, N)")
    if np.isnan(values).any():
        i, j = np.argwhere(np.isnan(values))[0]
        raise InputError(f"the {what} of sensors {i} and {j} is NaN; it must be a number")
    if np.array_equal(values, values.T):
        return values
    finite = np.abs(values[np.isfinite(values)])
    if not np.allclose(values, values.T, rtol=1e-7, atol=1e-9 * finite.max(initial=0)):
        raise InputError(f"the {what} matrix is not symmetric; average it with its transpose first")
    return np.asarray((values + values.T) / 2)


def regularised_reciprocal(similarity: ArrayLike, mu: float = 1.0) -> NDArray[np.float64]:
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
        everywhere if no pair has a positive similarity.

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
    values = symmetric(similarity, "similarity")
    np.fill_diagonal(values, 0)
    values[values < NUMERICAL_ZERO] = 0
    smallest = values.min(where=values > 0, initial=np.inf)
    regularisation = mu * smallest if np.isfinite(smallest) else 0.0
    with np.errstate(divide="ignore"):
        dissimilarity = 1 / (values + regularisation)
    np.fill_diagonal(dissimilarity, 0)
    return np.asarray(dissimilarity)


def direct_dissimilarity(similarity: ArrayLike, noise: ArrayLike) -> NDArray[np.float64]:
    """Turn correlations into a dissimilarity that trusts direct neighbours most.

    Parameters
    ----------
    similarity : array_like of shape (N, N)
        Correlations S in [-1, 1]. Negative ones count as 0. The diagonal is not looked at.
    noise : array_like of shape (N, N)
        Sampling variance s_ij^2 of each correlation: see
        `anisomap.numerics.evidence.sampling_variance`.

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
    values = symmetric(similarity, "similarity")
    variance = symmetric(noise, "noise")
    if variance.shape != values.shape:
        raise InputError(f"the noise has shape {variance.shape}, the similarity {values.shape}")
    partial = partial_correlation(values)
    pairs = ~np.eye(len(values), dtype=bool)
    values[~pairs | (values < NUMERICAL_ZERO)] = 0
    kinship = np.sqrt(values * (np.maximum(partial, 0) + _SHARE_OF_INDIRECT * values))
    if not (kinship > 0).any():
        return np.where(pairs, np.inf, 0.0)
    kinship += kinship.min(where=kinship > 0, initial=np.inf)
    variance = np.maximum(variance, np.median(variance[pairs]))
    dissimilarity = (1 + _CAUTION * variance / kinship**2) / np.sqrt(kinship)
    np.fill_diagonal(dissimilarity, 0)
    return np.asarray((dissimilarity + dissimilarity.T) / 2)


def partial_correlation(correlation: ArrayLike, ridge: float = 1.0) -> NDArray[np.float64]:
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
    covariance = symmetric(correlation, "correlation")
    np.fill_diagonal(covariance, 1 + ridge)
    try:
        precision = np.linalg.inv(covariance)
    except np.linalg.LinAlgError:  # not a matrix of correlations
        precision = np.linalg.pinv(covariance, hermitian=True)
    scale = np.sqrt(np.abs(np.diag(precision)))
    scale[scale == 0] = 1.0
    return np.asarray(-precision / np.outer(scale, scale))


def information_distance(information: ArrayLike) -> NDArray[np.float64]:
    """Give the information distance of every pair of sensors.

    Parameters
    ----------
    information : array_like of shape (N, N)
        Mutual information in nats, with the entropies on the diagonal, as from
        `anisomap.numerics.similarity.mutual_information`.

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
    values = symmetric(information, "mutual information")
    entropy = np.diag(values)
    distance = np.maximum(np.add.outer(entropy, entropy) - 2 * values, 0)
    distance[distance < NUMERICAL_ZERO] = 0
    return np.asarray(distance)
