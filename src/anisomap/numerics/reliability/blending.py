"""Pearson and Spearman correlation, weighted by their reliability."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import rankdata

from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.split_half import split_half_reliability
from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.rest import estimate_rest

_RELIANCE = 5.0


_CAUTION = 10.0


def blended_correlation(readings: ArrayLike) -> Reals:
    """Correlate readings where these can be relied on, and their ranks where they cannot.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.

    Returns
    -------
    ndarray of shape (N, N)
        ``w r + (1 - w) rho`` of Pearson's r and Spearman's rho: in [-1, 1], symmetric to the last
        bit, ones on the diagonal. Unchanged by a change of any sensor's unit or zero.

    Notes
    -----
    Pearson's r of a skin is ruled by few deep contacts: noisy in short recordings, but free of
    what ranks do to distances. Ranks are of depths beyond rest
    (`anisomap.numerics.similarity.rest.estimate_rest`), since those of a noisy rest are noise.
    With the
    reliabilities p of r and q of rho, ``1 - w = (1 - p^5) min(1, q / p)^10``: ranks are asked
    where r does not come again, unless they do so still less. The powers were chosen on simulated
    skins; 3 to 10 in place of 5 are about as good.
    """
    values = np.asarray(readings)
    ranks = rankdata(estimate_rest(values).depth(values), axis=0)
    of_values, of_ranks = (
        max(split_half_reliability(values), 0.0),
        max(split_half_reliability(ranks), 0.0),
    )
    steadier = 1.0 if of_ranks >= of_values else of_ranks / of_values
    weight = 1 - (1 - of_values**_RELIANCE) * steadier**_CAUTION
    blended, of_ranks_alone = pearson(values), pearson(ranks)
    blended *= weight
    of_ranks_alone *= 1 - weight
    blended += of_ranks_alone
    np.fill_diagonal(blended, 1.0)
    return blended
