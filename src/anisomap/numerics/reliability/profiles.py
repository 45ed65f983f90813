"""Agreement of the similarity of sensors to all others between two sets of data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.precision import Reals

_MAX_CORRELATION = 0.999  # a profile hardly repeats better; Fisher's z stays finite


def profile_agreement(
    first: Reals,
    second: Reals,
    known_first: NDArray[np.bool_],
    known_second: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Correlate the profile of each sensor in one similarity with each profile in another.

    Parameters
    ----------
    first, second : ndarray of shape (N, N)
        Similarities of the same sensors; symmetric.
    known_first, known_second : ndarray of bool, shape (N, N)
        Pairs that are known.

    Returns
    -------
    ndarray of shape (N, N)
        Fisher's z of the correlation of row i of `first` with row j of `second` over the other
        sensors; 0 where a profile is constant.
    """
    others = ~np.eye(len(first), dtype=bool)
    a_known, b_known = (
        (known & others).astype(np.float64) for known in (known_first, known_second)
    )
    a, b = first * a_known, second * b_known
    count = np.maximum(a_known @ b_known.T, 1.0)
    sum_a, sum_b = a @ b_known.T, a_known @ b.T
    covariance = a @ b.T - sum_a * sum_b / count
    variance_a = (a * a) @ b_known.T - sum_a**2 / count
    variance_b = a_known @ (b * b).T - sum_b**2 / count
    size = np.sqrt(np.maximum(variance_a, 0) * np.maximum(variance_b, 0))
    least = np.finfo(np.float64).eps * len(first)
    found = np.divide(covariance, size, out=np.zeros_like(size), where=size > least)
    return np.asarray(np.arctanh(np.clip(found, -_MAX_CORRELATION, _MAX_CORRELATION)))
