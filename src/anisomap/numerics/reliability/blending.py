"""Mean of linear and rank correlation, weighted by their reliability."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.sampling_noise import sampling_variance
from anisomap.numerics.reliability.split_half import SplitCorrelation, correlation_and_reliability
from anisomap.numerics.similarity.rest import Rest, ranks_of_depths, rest_and_ranks

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
    ranks = ranks_of_depths(values, single=True)
    return _blended(correlation_and_reliability(values), correlation_and_reliability(ranks))[0]


@dataclass(frozen=True, eq=False)
class Blend:
    """A blended correlation, and what it was blended from.

    similarity (N, N): See `blended_correlation`.
    variance (N, N): Its sampling variance for unrelated sensors.
    weight: Weight of Pearson's r, in [0, 1].
    ranks (T, N): Ranks of depths beyond rest, of float32 or float64.
    """

    similarity: Reals
    variance: Reals
    weight: float
    rest: Rest
    ranks: Reals

    def select(self, sensors: NDArray[np.bool_]) -> Blend:
        """Return the blend of some of the sensors, given as a mask of shape (N,)."""
        inside = np.ix_(sensors, sensors)
        return replace(
            self,
            similarity=self.similarity[inside],
            variance=self.variance[inside],
            rest=self.rest.select(sensors),
            ranks=self.ranks[:, sensors],
        )


def blend(readings: ArrayLike) -> Blend:
    """Compute `blended_correlation` and its sampling variance, with what they are computed from.

    readings (T, N).

    The variance is ``(w sd(r) + (1 - w) sd(rho))^2``, with the standard deviations of
    `anisomap.numerics.reliability.sampling_noise.sampling_variance` for the readings and for the
    ranks: the errors of r and rho are taken to be proportional, as they nearly are.
    """
    values = np.asarray(readings)
    rest, ranks = rest_and_ranks(values, single=True)
    similarity, weight = _blended(*(correlation_and_reliability(one) for one in (values, ranks)))
    deviation = weight * np.sqrt(sampling_variance(values))
    deviation += (1 - weight) * np.sqrt(sampling_variance(ranks))
    return Blend(similarity, np.square(deviation, out=deviation), weight, rest, ranks)


def _blended(linear: SplitCorrelation, by_rank: SplitCorrelation) -> tuple[Reals, float]:
    """Return the blended correlation, and the weight of Pearson's r; overwrite `linear`."""
    p, q = max(linear.reliability, 0.0), max(by_rank.reliability, 0.0)
    ratio = 1.0 if q >= p else q / p
    weight = 1 - (1 - p**_POWER_OF_RELIABILITY) * ratio**_POWER_OF_RATIO
    blended = linear.correlation
    blended *= weight
    blended += (1 - weight) * by_rank.correlation
    np.fill_diagonal(blended, 1.0)
    return blended, weight
