"""The refinement of a map: the map of the covariogram, averaged with a map of path lengths.

The map of the covariogram assumes that one function of distance explains all correlations. The
larger the unexplained share of the correlations, the larger the weight of path lengths.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from time import monotonic

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist, squareform

from anisomap.method.dimensions import PLANE
from anisomap.method.evidence import Evidence, log_stage
from anisomap.numerics.covariogram.covariogram_fit import Covariogram, fit_covariogram
from anisomap.numerics.covariogram.objective import CovariogramOptions
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.graph.neighbour_graphs import local_path_lengths
from anisomap.numerics.neighbours import spanning_tree
from anisomap.numerics.precision import Reals
from anisomap.numerics.procrustes import fit_similarity
from anisomap.numerics.scaling.multidimensional_scaling import SmacofOptions, smacof
from anisomap.numerics.signals import unit_rows

logger = logging.getLogger(__name__)

MIN_SENSORS = 8
"""Minimum number of sensors of a refined map: fewer have hardly more pairs than coordinates."""

DIFFERENT = 0.04
"""Unexplained share of the variance of the correlations from which contacts differ between places:
it was at least .045 on skins on which contacts differed, and at most .02 on other skins.
"""

_PATHS_UNEXPLAINED = 0.05
"""Unexplained share that is due to errors of path lengths, by noise and bends; .02 to .1 result in
similar maps (``python -m benchmarks.accuracy.steps``)."""

_LEAST_SHARE = 0.02  # unexplained by a map of a resample, in which paths weigh at most .22 if less
_METRIC_SHARE, _LARGE = 2.5e-4, 500
"""Weight of the metric per sensor, times the variance of its ratios, and the number of sensors from
which the weight grows with its square: residuals are then not whitened, and count as independent.
Below it, 1e-4 to 4e-4 result in similar maps; spheres of 1,000 gain from up to 16 times the weight.
"""
_LEAST_VARIANCE = 1e-4  # of ratios: the relative error of a metric is at least 1 %
_ADJACENT, _SIGNIFICANT, _DETOUR = 1.5, 3.0, 1.2
"""Distance of adjacent sensors in spacings, standard deviations of a significant correlation, and
ratio of path and distance above which a path is not straight (at most 1.08 on lattices). With 1.4
to 1.7, 3 to 4, and 1.15 to 1.25, maps are similar.
"""
_ROUGH = 1e-4  # tolerance of the first fit, which gives the unit of the metric

_AFTER_ROUGH, _AFTER_FITS = 1.5, 0.3  # remaining time relative to elapsed; with 2,000 sensors
_NEAR_MINIMUM = SmacofOptions(tolerance=1e-6)


@dataclass(frozen=True, eq=False)
class Refinement:
    """A refined map of n sensors.

    positions (n, k): In the unit of the covariogram.
    fit: The covariogram and its positions.
    unexplained: Share of the variance of the correlations that `fit` does not explain.
    path_weight: Weight of path lengths in the positions, in [0, 1].
    """

    positions: Reals
    fit: Covariogram
    unexplained: float
    path_weight: float

    @property
    def distorted(self) -> bool:
        """Whether contacts differ between places, which distorts all maps in the same way."""
        return self.unexplained > DIFFERENT


def refine(
    evidence: Evidence,
    metric: Reals,
    positions: Reals,
    options: CovariogramOptions,
    near: Covariogram | None = None,
) -> Refinement | None:
    """Refine positions, (n, k), by all correlations; None if there are too few sensors.

    metric (n, n). near: A fit to nearly the same evidence, from which the search starts.
    """
    if len(positions) < MIN_SENSORS:
        return None

    fit = partial(
        fit_covariogram,
        evidence.similarity,
        noise=evidence.noise,
        known=evidence.known,
        options=options,
    )
    begun = monotonic()
    first = fit(positions, metric, least_tolerance=_ROUGH) if near is None else near
    if near is None:
        seconds = _AFTER_ROUGH * (monotonic() - begun)
        log_stage("fitting positions to the metric as well", len(positions), seconds)
    lengths, prior_weight = _in_unit_of(first.positions, metric)
    if first.positions.shape[1] == PLANE:
        lengths = np.where(_detours(evidence, first.positions), np.inf, lengths)
    found = fit(first.positions, lengths, least_prior=prior_weight, near=first)
    logger.debug("covariogram with exponent %.2f, %d steps", found.exponent, found.iterations)
    share = evidence.unexplained(found.positions)
    if share <= (0 if near is None else _LEAST_SHARE):
        return Refinement(found.positions, found, share, 0.0)
    if near is None:
        seconds = _AFTER_FITS * (monotonic() - begun)
        log_stage("scaling paths between neighbours", len(positions), seconds)
    proposed = _by_paths(evidence, found.positions)
    # The variance of each map is assumed to be proportional to its unexplained share, plus a
    # constant for paths; a mean weighted by precisions has the smallest variance.
    precision = share / (max(share, evidence.unexplained(proposed)) + _PATHS_UNEXPLAINED)
    weight = precision / (1 + precision)
    mean = (1 - weight) * found.positions + weight * proposed
    return Refinement(mean, found, share, weight)


def _in_unit_of(positions: Reals, metric: Reals) -> tuple[Reals, float]:
    """Return a metric, (n, n), in the unit of a map, (n, k), and its weight in a fit of the map.

    The weight is inversely proportional to the variance of the ratios of distances on the map to
    the metric. It grows with the number of sensors: errors of short distances add up over a map.
    """
    ratios = pdist(positions) / squareform(metric, checks=False)
    mean = float(ratios.mean())
    variance = max(float(ratios.var()) / mean**2, _LEAST_VARIANCE)
    weight = _METRIC_SHARE * len(metric) * max(1, len(metric) / _LARGE) / variance
    return mean * metric, weight


def _detours(evidence: Evidence, positions: Reals) -> NDArray[np.bool_]:
    """Mark pairs of sensors whose straight line leaves a flat map. positions (n, 2) -> (n, n).

    The metric follows the skin, so that it exceeds the distance of such pairs, as of two fingers of
    a hand. Paths on the map join adjacent sensors and those with significant correlations.
    """
    distances = squareform(pdist(positions))
    spacing = np.partition(distances, 2, axis=1)[:, 2]  # to the second nearest, as along a finger
    linked = distances <= _ADJACENT * np.maximum.outer(spacing, spacing)
    linked |= evidence.similarity > _SIGNIFICANT * np.sqrt(evidence.noise)
    linked |= spanning_tree(distances)
    return metricise(np.where(linked, distances, np.inf)) > _DETOUR * distances


def _by_paths(evidence: Evidence, positions: Reals) -> Reals:
    """Scale path lengths, starting near a map, in its frame. positions (n, k) -> (n, k).

    The covariogram compresses regions of wide contacts. Paths follow bends, but make no assumption
    about distant regions. Each kind of path has the weight of its correlation with the map.
    """
    similarities = [evidence.similarity]
    if evidence.readings is not None:
        similarities.append(evidence.rank_correlation)
    paths = [squareform(local_path_lengths(one), checks=False) for one in similarities]
    distances = pdist(positions)
    # Noise at rest ruins ranks where contacts are rare, and spikes ruin linear correlations.
    of_map, *of_paths = unit_rows(np.column_stack([distances, *paths]))
    weights = np.maximum(np.stack(of_paths) @ of_map, np.finfo(np.float32).tiny)
    mean = np.average([one / one.mean() for one in paths], axis=0, weights=weights)
    lengths = distances.mean() * mean
    # The start is the scaling of the mean of both, in which neither map is folded.
    given = scaled = np.asarray(positions, dtype=np.float64)
    for target in map(squareform, ((distances + lengths) / 2, lengths)):
        found = smacof(target, dimensions=given.shape[1], start=scaled, options=_NEAR_MINIMUM)
        scaled = found.positions
    return fit_similarity(scaled, given).apply(scaled)
