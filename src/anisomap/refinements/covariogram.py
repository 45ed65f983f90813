"""Positions at which one function of distance explains all correlations."""

from __future__ import annotations

import logging

from anisomap.evidence import PairStatistics
from anisomap.numerics.covariogram.covariogram_fit import fit_covariogram
from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.sampling_noise import typical_variance
from anisomap.options import MethodOptions
from anisomap.refinements.chain import MIN_SENSORS, Proposal

logger = logging.getLogger(__name__)


def by_covariogram(
    pairs: PairStatistics, metric: Reals, positions: Reals, options: MethodOptions
) -> Proposal | None:
    """Fit a covariogram and the positions; nothing for fewer than 8 sensors."""
    if len(positions) < MIN_SENSORS:
        return None
    fit = fit_covariogram(
        pairs.similarity,
        positions,
        metric,
        noise=typical_variance(pairs.noise),
        known=pairs.known,
        options=options.covariogram,
        near=pairs.near,
    )
    logger.debug(
        "covariogram %.2f exp(-d^%.2f) %+.2f after %d steps",
        fit.amplitude,
        fit.exponent,
        fit.offset,
        fit.iterations,
    )
    return Proposal(fit.positions, precision=1.0, fit=fit)
