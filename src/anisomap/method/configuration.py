"""Scaling and refinement of a metric, component by component."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap.method.evidence import Evidence
from anisomap.method.named import Method, MethodOptions
from anisomap.method.refinement import Refinement
from anisomap.numerics.graph.neighbour_graphs import components
from anisomap.numerics.precision import Floats, Reals, row_blocks
from anisomap.numerics.scaling.multidimensional_scaling import (
    DEFAULT_SMACOF,
    Scaling,
    SmacofOptions,
    smacof,
)

logger = logging.getLogger(__name__)

_START = SmacofOptions(tolerance=1e-5)  # of a scaling that only starts the covariogram fit


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
    refinements: tuple[Refinement | None, ...] = ()

    @property
    def largest(self) -> Refinement | None:
        """How the largest component was refined; None if it was not."""
        return self.refinements[0] if self.refinements else None


def configure(
    metric: Reals,
    evidence: Evidence | None,
    dimensions: int,
    recipe: Method,
    options: MethodOptions,
    *,
    weights: Reals | None = None,
    start: Floats | None = None,
) -> Configuration:
    """Scale a metric, and refine the positions by the evidence.

    metric (n, n), weights (n, n), start (n, k).
    """
    chosen = recipe.scaling_of(len(metric), options.smacof)
    if recipe.refine is None or evidence is None:
        return scale(metric, dimensions, start=start, weights=weights, options=chosen)
    near = chosen
    if chosen.tolerance < _START.tolerance:
        near = _START if chosen == DEFAULT_SMACOF else replace(chosen, tolerance=_START.tolerance)
    scaled = scale(metric, dimensions, start=start, weights=weights, options=near)
    return refine_components(scaled, metric, evidence, recipe, options)


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
            among(metric, inside),
            dimensions=dimensions,
            start=None if start is None else start[inside],
            weights=None if weights is None else among(weights, inside),
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


def refine_components(
    scaled: Configuration,
    metric: Reals,
    evidence: Evidence,
    recipe: Method,
    options: MethodOptions,
) -> Configuration:
    """Refine each connected component; those of fewer than `min_sensors` stay as they are."""
    positions = scaled.positions.copy()
    raw = spread = 0.0
    refinements: list[Refinement | None] = []
    for label in range(scaled.component.max() + 1):
        inside = scaled.component == label
        lengths = among(metric, inside)
        refined = None
        enough = np.count_nonzero(inside) >= options.min_sensors and (lengths > 0).any()
        if enough and recipe.refine is not None:
            refined = recipe.refine(
                evidence.select(inside), lengths, positions[inside], options.covariogram
            )
        if refined is not None:
            positions[inside] = refined.positions
        refinements.append(refined)
        # Refinement changes the unit; rescale every component to the unit of the metric.
        factor, missed, size = best_scale(positions[inside], lengths)
        positions[inside] *= factor if factor > 0 else 1.0
        raw += missed
        spread += factor**2 * size
    stress = float(np.sqrt(raw / spread)) if spread > 0 else 0.0
    return replace(scaled, positions=positions, stress=stress, refinements=tuple(refinements))


def among(matrix: Reals, sensors: NDArray[np.bool_]) -> Reals:
    """Select the pairs of some sensors; return the matrix itself if these are all."""
    return matrix if sensors.all() else matrix[np.ix_(sensors, sensors)]


def best_scale(positions: Floats, lengths: Reals) -> tuple[float, float, float]:
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
