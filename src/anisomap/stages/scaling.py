"""Scaling of the metric to positions, and refinement, of each connected component separately."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap.numerics.graph.connectivity import components
from anisomap.numerics.precision import Reals, row_blocks
from anisomap.numerics.scaling.stress_minimisation import Scaling, SmacofOptions, smacof
from anisomap.stages.dimension import DimensionPlan
from anisomap.stages.pairs import PairStatistics
from anisomap.stages.refinement import Refined, RefinementFacts

logger = logging.getLogger(__name__)


class _HasMinSensors(Protocol):
    @property
    def min_sensors(self) -> int: ...


class _Options(_HasMinSensors, Protocol):
    @property
    def smacof(self) -> SmacofOptions: ...


Options = TypeVar("Options", bound=_HasMinSensors)


@dataclass(frozen=True, eq=False)
class Configuration:
    """Positions of n sensors in one or several connected components.

    Attributes
    ----------
    positions : ndarray of shape (n, k)
        In the unit of the metric; components share no frame of reference.
    component : ndarray of int, shape (n,)
        The component of each sensor; 0 is the largest.
    stress : float
        Stress-1 of all pairs within components.
    converged : bool
        Whether the scaling of every component converged.
    n_iterations : int
        Number of SMACOF iterations, the maximum over components.
    facts : RefinementFacts
        How the largest component was refined.
    notes : tuple of str
        Caveats of the refinement of any component.
    refinements : tuple of Refined or None
        How each component was refined, before it was rescaled; empty if none was.
    """

    positions: NDArray[np.float64]
    component: NDArray[np.intp]
    stress: float
    converged: bool
    n_iterations: int
    facts: RefinementFacts = field(default_factory=RefinementFacts)
    notes: tuple[str, ...] = ()
    refinements: tuple[Refined | None, ...] = ()


def scale(
    metric: Reals,
    dimensions: int,
    *,
    start: NDArray[np.float64] | None = None,
    weights: Reals | None = None,
    options: SmacofOptions | None = None,
) -> Configuration:
    """Scale each connected component of a metric by SMACOF.

    Parameters
    ----------
    metric : ndarray of shape (n, n)
        Infinite between components.
    dimensions : int
        Number of coordinates, k.
    start : ndarray of shape (n, k), optional
        Initial positions; Torgerson's classical scaling by default.
    weights : ndarray of shape (n, n), optional
        Weights of the distances; 0 marks an unknown distance.
    options : SmacofOptions, optional

    Returns
    -------
    Configuration

    Notes
    -----
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


def refine(
    method: Callable[[PairStatistics, Reals, Reals, Options], Refined],
    pairs: PairStatistics,
    metric: Reals,
    configuration: Configuration,
    options: Options,
) -> Configuration:
    """Refine each connected component by the similarity of its sensors.

    Parameters
    ----------
    method : callable
        ``method(pairs, metric, positions, options)`` refines one component: see
        `anisomap.methods.Method`.
    pairs : PairStatistics
    metric : ndarray of shape (n, n)
    configuration : Configuration
        From `scale`.
    options : MethodOptions
        Components of fewer than its `min_sensors` are not refined.

    Returns
    -------
    Configuration
        With refined positions in the unit of the metric, and their Stress-1.
    """
    positions = configuration.positions.copy()
    raw = spread = 0.0
    facts = RefinementFacts()
    notes: list[str] = []
    refinements: list[Refined | None] = []
    for label in range(configuration.component.max() + 1):
        inside = configuration.component == label
        refinements.append(None)
        lengths = _among(metric, inside)
        if np.count_nonzero(inside) >= options.min_sensors and (lengths > 0).any():
            refined = method(pairs.select(inside), lengths, positions[inside], options)
            positions[inside] = refined.positions
            facts = refined.facts if label == 0 else facts
            notes += refined.notes
            refinements[label] = refined
        # Refinement changes the unit; rescale every component to the unit of the metric.
        factor, missed, size = _best_scale(positions[inside], lengths)
        positions[inside] *= factor if factor > 0 else 1.0
        raw += missed
        spread += factor**2 * size
    stress = float(np.sqrt(raw / spread)) if spread > 0 else 0.0
    return replace(
        configuration,
        positions=positions,
        stress=stress,
        facts=facts,
        notes=tuple(dict.fromkeys(notes)),
        refinements=tuple(refinements),
    )


def configure(
    plan: DimensionPlan,
    metric: Reals,
    pairs: PairStatistics | None,
    *,
    method: Callable[[PairStatistics, Reals, Reals, Any], Refined] | None,
    options: _Options,
    weights: Reals | None = None,
    start: NDArray[np.float64] | None = None,
) -> tuple[Configuration, DimensionPlan]:
    """Scale a metric and refine the positions; once more if these contradict the plan.

    Parameters
    ----------
    plan : DimensionPlan
    metric : ndarray of shape (n, n)
    pairs : PairStatistics, optional
        Without them, positions are not refined.
    method : callable, optional
        See `refine`.
    options : MethodOptions
    weights, start
        See `scale`.

    Returns
    -------
    configuration : Configuration
    plan : DimensionPlan
        See `DimensionPlan.revised`.
    """
    found = scale(metric, plan.dimensions, start=start, weights=weights, options=options.smacof)
    if method is None or pairs is None:
        return found, plan
    found = refine(method, pairs, metric, found, options)
    revised = plan.revised(found.facts)
    if revised.dimensions != plan.dimensions:
        found = scale(metric, revised.dimensions, weights=weights, options=options.smacof)
        found = refine(method, pairs, metric, found, options)
    return found, revised


def _among(matrix: Reals, sensors: NDArray[np.bool_]) -> Reals:
    """Select the pairs of some sensors; return the matrix itself if these are all."""
    return matrix if sensors.all() else matrix[np.ix_(sensors, sensors)]


def _best_scale(positions: NDArray[np.float64], lengths: Reals) -> tuple[float, float, float]:
    """Find the least-squares scale of positions to given distances.

    Returns
    -------
    scale : float
        0 if the positions coincide.
    missed : float
        Sum of squared residuals at that scale, over ordered pairs.
    size : float
        Sum of squared distances between the positions, over ordered pairs.
    """
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
