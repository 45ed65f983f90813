"""Mean of linear and rank correlation, weighted by their reliability."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.split_half import correlation_and_reliability
from anisomap.numerics.similarity.rest import estimate_rest

# Tuned on simulated skins, seeds 101-105; 3 to 10 in place of 5 give about equal maps.
_POWER_OF_RELIABILITY = 5.0
_POWER_OF_RATIO = 10.0


def blended_correlation(readings: ArrayLike) -> Reals:
    """Combine Pearson's r and Spearman's rho by their split-half reliability.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.

    Returns
    -------
    ndarray of shape (N, N)
        ``w r + (1 - w) rho``: in [-1, 1], exactly symmetric, ones on the diagonal. Invariant
        under changes of the unit and the zero of a sensor.

    Notes
    -----
    On tactile data a few deep contacts dominate Pearson's r, which makes it noisy in short
    recordings; ranks are less noisy but distort distances. Ranks are of depths beyond rest
    (`anisomap.numerics.similarity.rest.estimate_rest`), since ranks of readings at rest are noise.
    With the reliabilities p of r and q of rho, ``1 - w = (1 - p^5) min(1, q / p)^10``: rho has
    weight if r is unreliable, unless rho is even less reliable.
    """
    values = np.asarray(readings)
    blended, reliability = correlation_and_reliability(values)
    rho, reliability_of_rho = correlation_and_reliability(estimate_rest(values).depth_ranks(values))
    p, q = max(reliability, 0.0), max(reliability_of_rho, 0.0)
    ratio = 1.0 if q >= p else q / p
    weight = 1 - (1 - p**_POWER_OF_RELIABILITY) * ratio**_POWER_OF_RATIO
    blended *= weight
    rho *= 1 - weight
    blended += rho
    np.fill_diagonal(blended, 1.0)
    return blended
