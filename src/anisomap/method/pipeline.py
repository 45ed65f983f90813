"""The method on one page: from readings to positions.

Readings are compared, similarities converted to a dissimilarity and a metric, and each connected
component is scaled and refined. A recording, a part of it and a resample pass the same stages.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.method.dimensions import (
    AUTO,
    SPATIAL,
    DimensionPlan,
    Dimensions,
    plan_dimensions,
)
from anisomap.method.evidence import PairStatistics, compare
from anisomap.method.named import METHODS, Method, find_method
from anisomap.method.options import MethodOptions
from anisomap.method.refinements import RefinedMap, Step, refine
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.graph.neighbour_graphs import components
from anisomap.numerics.precision import Floats, Reals, row_blocks
from anisomap.numerics.scaling.multidimensional_scaling import Scaling, SmacofOptions, smacof
from anisomap.recording import Recording

logger = logging.getLogger(__name__)


_START_TOLERANCE = 1e-5  # of a scaling that only starts the covariogram fit


@dataclass(frozen=True, eq=False)
class Configuration:
    """Positions of n sensors in one or several connected components.

    positions (n, k): In the unit of the metric; components share no frame of reference.
    component: The component of each sensor; 0 is the largest.
    stress: Stress-1 of all pairs within components.
    converged: Whether the scaling of every component converged.
    n_iterations: Number of SMACOF iterations, the maximum over components.
    refinements: How each component was refined, before it was rescaled; empty if none was.
    """

    positions: Floats
    component: NDArray[np.intp]
    stress: float
    converged: bool
    n_iterations: int
    refinements: tuple[RefinedMap | None, ...] = ()

    @property
    def largest(self) -> RefinedMap | None:
        """How the largest component was refined; None if it was not."""
        return self.refinements[0] if self.refinements else None

    @property
    def notes(self) -> tuple[str, ...]:
        """Caveats of the refinement of any component, each once."""
        refined = [one for one in self.refinements if one is not None]
        return tuple(dict.fromkeys(note for one in refined for note in one.notes))


@dataclass(frozen=True, eq=False)
class Stages:
    """The stages of a map. pairs: Of the n mapped sensors."""

    pairs: PairStatistics
    configuration: Configuration
    plan: DimensionPlan


def compute_stages(
    runs: Sequence[Recording], recipe: Method, dimensions: Dimensions, options: MethodOptions
) -> Stages:
    """Compute the configuration of all sensors of some recordings."""
    refined = bool(recipe.refinements)
    with limited_blas(max(run.n_sensors for run in runs)):
        pairs = compare(
            runs, recipe.similarity_of(runs), bins=options.entropy_bins, with_noise=refined
        )
        metric = recipe.metric(recipe.dissimilarity_of(pairs, options))
        if dimensions == AUTO and recipe.dissimilarity != METHODS[DEFAULT_METHOD].dissimilarity:
            plan = _plan_by_default_method(runs, options)
        else:
            share = pairs.common_share
            plan = plan_dimensions(
                dimensions, metric, pairs.weights, common_share=share, examine=refined
            )
        configuration, plan = configure(plan, metric, pairs, recipe, options, weights=pairs.weights)
    return Stages(pairs, configuration, plan)


def configure_pairs(
    pairs: PairStatistics,
    recipe: Method,
    dimensions: int,
    options: MethodOptions,
    *,
    start: Floats | None = None,
) -> Configuration:
    """Compute the configuration of sensors of which all pairs were compared.

    start (n, k): Positions near the result, which replace the scaling.
    """
    with limited_blas(len(pairs.similarity)):
        metric = recipe.metric(recipe.dissimilarity_of(pairs, options))
        if start is not None:
            given = of_positions(start, metric)
            return refine_components(recipe.refinements, pairs, metric, given, options)
        plan = plan_dimensions(dimensions, None)
        return configure(plan, metric, pairs, recipe, options, weights=pairs.weights)[0]


def dissimilarities(
    pairs: PairStatistics, method: str = DEFAULT_METHOD, options: MethodOptions | None = None
) -> Reals:
    """Compute the dissimilarity M of all pairs of sensors from their similarity S.

    Parameters
    ----------
    pairs : PairStatistics
        From `anisomap.method.evidence.compare`.
    method : str
        A key of `METHODS`.
    options : MethodOptions, optional

    Returns
    -------
    ndarray of shape (n, n)
        A semi-metric, infinite for unknown and unrelated pairs.

    Raises
    ------
    InputError
        If there is no such method, or it requires correlations and the similarity is not one.

    Notes
    -----
    McGregor et al. (2011), section "ANISOMAP", step 1, doi:10.1371/journal.pone.0026561.
    """
    return find_method(method).dissimilarity_of(pairs, options or MethodOptions())


def _plan_by_default_method(runs: Sequence[Recording], options: MethodOptions) -> DimensionPlan:
    """Choose dimensions by the default method, which examines contacts if the skin looks flat."""
    recipe = METHODS[DEFAULT_METHOD]
    pairs = compare(runs, recipe.similarity_of(runs), bins=options.entropy_bins, with_noise=True)
    metric = recipe.metric(recipe.dissimilarity_of(pairs, options))
    plan = plan_dimensions(AUTO, metric, pairs.weights, common_share=pairs.common_share)
    if plan.dimensions == SPATIAL:
        return plan
    return configure(plan, metric, pairs, recipe, options, weights=pairs.weights)[1]


def configure(
    plan: DimensionPlan,
    metric: Reals,
    pairs: PairStatistics | None,
    recipe: Method,
    options: MethodOptions,
    *,
    weights: Reals | None = None,
    start: Floats | None = None,
) -> tuple[Configuration, DimensionPlan]:
    """Scale a metric and refine the positions; once more if these contradict the plan.

    metric (n, n), weights (n, n), start (n, k). Nothing is refined without statistics of pairs.
    """
    steps = recipe.refinements
    if not steps or pairs is None:
        scaled = scale(
            metric, plan.dimensions, start=start, weights=weights, options=options.smacof
        )
        return scaled, plan
    near = replace(options.smacof, tolerance=max(options.smacof.tolerance, _START_TOLERANCE))
    found = scale(metric, plan.dimensions, start=start, weights=weights, options=near)
    found = refine_components(steps, pairs, metric, found, options)
    revised = plan.revised(elongated=found.largest is not None and found.largest.elongated)
    if revised.dimensions != plan.dimensions:
        found = scale(metric, revised.dimensions, weights=weights, options=near)
        found = refine_components(steps, pairs, metric, found, options)
    return found, revised


def scale(
    metric: Reals,
    dimensions: int,
    *,
    start: Floats | None = None,
    weights: Reals | None = None,
    options: SmacofOptions | None = None,
) -> Configuration:
    """Scale each connected component of a metric (n, n) by SMACOF, from positions (n, k) if given.

    McGregor et al. (2011), section "ANISOMAP", step 3, doi:10.1371/journal.pone.0026561.
    """
    labels = components(metric if weights is None else np.where(weights > 0, metric, np.inf))
    positions = np.empty((len(metric), dimensions))
    scalings: list[Scaling] = []
    for label in range(labels.max() + 1):
        inside = labels == label
        logger.info("scaling %d sensors into %d dimensions", inside.sum(), dimensions)
        scaling = smacof(
            _among(metric, inside),
            dimensions=dimensions,
            start=None if start is None else start[inside],
            weights=None if weights is None else _among(weights, inside),
            options=options,
        )
        positions[inside] = scaling.positions
        scalings.append(scaling)
    raw = sum(scaling.raw_stress for scaling in scalings)
    spread = sum(scaling.spread for scaling in scalings)
    return Configuration(
        positions=positions,
        component=labels,
        stress=float(np.sqrt(raw / spread)) if spread > 0 else 0.0,
        converged=all(scaling.converged for scaling in scalings),
        n_iterations=max(len(scaling.trace) - 1 for scaling in scalings),
    )


def of_positions(positions: Floats, metric: Reals) -> Configuration:
    """Take given positions, shape (n, k), for the scaling of a metric, in its unit."""
    labels = components(metric)
    scaled = positions.copy()
    for label in range(labels.max() + 1):
        inside = labels == label
        scaled[inside] *= _best_scale(positions[inside], _among(metric, inside))[0] or 1.0
    return Configuration(scaled, labels, stress=np.nan, converged=True, n_iterations=0)


def refine_components(
    steps: Mapping[str, Step],
    pairs: PairStatistics,
    metric: Reals,
    configuration: Configuration,
    options: MethodOptions,
) -> Configuration:
    """Refine each connected component; those of fewer than `min_sensors` stay as they are."""
    positions = configuration.positions.copy()
    raw = spread = 0.0
    refinements: list[RefinedMap | None] = []
    for label in range(configuration.component.max() + 1):
        inside = configuration.component == label
        lengths = _among(metric, inside)
        refined = None
        if np.count_nonzero(inside) >= options.min_sensors and (lengths > 0).any():
            refined = refine(pairs.select(inside), lengths, positions[inside], steps, options)
            positions[inside] = refined.positions
        refinements.append(refined)
        # Refinement changes the unit; rescale every component to the unit of the metric.
        factor, missed, size = _best_scale(positions[inside], lengths)
        positions[inside] *= factor if factor > 0 else 1.0
        raw += missed
        spread += factor**2 * size
    stress = float(np.sqrt(raw / spread)) if spread > 0 else 0.0
    return replace(
        configuration, positions=positions, stress=stress, refinements=tuple(refinements)
    )


def _among(matrix: Reals, sensors: NDArray[np.bool_]) -> Reals:
    """Select the pairs of some sensors; return the matrix itself if these are all."""
    return matrix if sensors.all() else matrix[np.ix_(sensors, sensors)]


def _best_scale(positions: Floats, lengths: Reals) -> tuple[float, float, float]:
    """Find the least-squares scale of positions to given distances."""
    size = product = missed = 0.0
    for rows in row_blocks(len(positions)):
        distances = cdist(positions[rows], positions)
        size += float(np.vdot(distances, distances))
        product += float((distances * lengths[rows]).sum())
    scale = product / size if size > 0 else 0.0
    for rows in row_blocks(len(positions)):
        missed += float(
            ((scale * cdist(positions[rows], positions) - lengths[rows]) ** 2).sum(dtype=np.float64)
        )
    return scale, missed, size
