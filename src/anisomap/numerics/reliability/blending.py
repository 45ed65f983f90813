"""Mean of linear and rank correlation, weighted by their reliability."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.sampling_noise import sampling_variance
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
    return _blended(values, estimate_rest(values).depth_ranks(values))[0]


@dataclass(frozen=True, eq=False)
class Blend:
    """A blended correlation, and what it was blended from.

    Attributes
    ----------
    similarity : ndarray of shape (N, N)
        See `blended_correlation`.
    variance : ndarray of shape (N, N)
        Its sampling variance for unrelated sensors.
    weight : float
        Weight of Pearson's r, in [0, 1].
    ranks : ndarray of shape (T, N)
        Ranks of depths beyond rest.
    """

    similarity: Reals
    variance: Reals
    weight: float
    ranks: NDArray[np.float64]

    def select(self, sensors: NDArray[np.bool_]) -> Blend:
        """Return the blend of some of the sensors, given as a mask of shape (N,)."""
        inside = np.ix_(sensors, sensors)
        return Blend(
            self.similarity[inside], self.variance[inside], self.weight, self.ranks[:, sensors]
        )


def blend(readings: ArrayLike) -> Blend:
    """Compute `blended_correlation` and its sampling variance, with what they are computed from.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings, T >= 2.

    Returns
    -------
    Blend

    Raises
    ------
    InputError
        If there are fewer than 2 frames.

    Notes
    -----
    The variance is ``(w sd(r) + (1 - w) sd(rho))^2``, with the standard deviations of
    `anisomap.numerics.reliability.sampling_noise.sampling_variance` for the readings and for the
    ranks: the errors of r and rho are taken to be proportional, as they nearly are.
    """
    values = np.asarray(readings)
    ranks = estimate_rest(values).depth_ranks(values)
    blended, weight = _blended(values, ranks)
    deviation = weight * np.sqrt(sampling_variance(values))
    deviation += (1 - weight) * np.sqrt(sampling_variance(ranks))
    return Blend(blended, np.square(deviation, out=deviation), weight, ranks)


def _blended(values: NDArray[np.generic], ranks: NDArray[np.float64]) -> tuple[Reals, float]:
    """Return the blended correlation, and the weight of Pearson's r."""
    blended, reliability = correlation_and_reliability(values)
    rho, reliability_of_rho = correlation_and_reliability(ranks)
    p, q = max(reliability, 0.0), max(reliability_of_rho, 0.0)
    ratio = 1.0 if q >= p else q / p
    weight = 1 - (1 - p**_POWER_OF_RELIABILITY) * ratio**_POWER_OF_RATIO
    blended *= weight
    rho *= 1 - weight
    blended += rho
    np.fill_diagonal(blended, 1.0)
    return blended, weight
