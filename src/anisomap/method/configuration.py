"""Scaling and refinement of each component of a metric, and the resulting map."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from time import monotonic

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap._version import __version__
from anisomap.errors import AnisomapWarning
from anisomap.method.dimensions import Dimensions
from anisomap.method.evidence import Evidence, log_stage
from anisomap.method.named import DEFAULT_OPTIONS, Method, MethodOptions, find_method
from anisomap.method.refinement import Refinement
from anisomap.notes import Note
from anisomap.numerics.neighbours import components
from anisomap.numerics.precision import Floats, Reals, row_blocks
from anisomap.numerics.scaling.multidimensional_scaling import (
    DEFAULT_SMACOF,
    Scaling,
    SmacofOptions,
    smacof,
)
from anisomap.recording import Scalar
from anisomap.sensor_map import UNPLACED, SensorMap

_REFINEMENT = 4  # time of the refinement relative to the scaling; with 2,000 sensors
_START = SmacofOptions(tolerance=1e-5)  # of a scaling that only starts the covariogram fit


@dataclass(frozen=True, eq=False)
class Configuration:
    """Positions of n sensors in one or several connected components.

    positions (n, k): In the unit of the metric; each component has a frame of reference of its own.
    component: The component of each sensor; 0 is the largest.
    stress: Stress-1 of all pairs within components.
    converged: Whether the scaling of every component converged.
    n_iterations: Number of SMACOF iterations, the maximum over components.
    refinements: Refinement of each component before rescaling; empty if none was refined.
    scaled (n, k): Positions from the metric alone, if positions were refined.
    """

    positions: Floats
    component: NDArray[np.intp]
    stress: float
    converged: bool
    n_iterations: int
    refinements: tuple[Refinement | None, ...] = ()
    scaled: Floats | None = None

    @property
    def largest(self) -> Refinement | None:
        """Refinement of the largest component; None if it was not refined."""
        return self.refinements[0] if self.refinements else None


@dataclass(frozen=True, eq=False)
class Task:
    """The input of scaling and refinement: n sensors to be mapped, of N.

    evidence: None if a metric or a dissimilarity was given. metric, weights (n, n), start (n, k).
    names (N,), mapped (N,): All names, and the mask of the sensors to be mapped.
    usual: Returns the evidence of the default method, or None.
    """

    evidence: Evidence | None
    metric: Reals
    names: tuple[str, ...]
    mapped: NDArray[np.bool_]
    method: str
    recipe: Method
    dimensions: Dimensions
    options: MethodOptions
    usual: Callable[[Method], Evidence | None]
    facts: Mapping[str, Scalar]
    notes: Sequence[Note] = ()
    weights: Reals | None = None
    start: Floats | None = None
    objects: bool = False


def configure(task: Task, dimensions: int) -> Configuration:
    """Scale the metric, and refine the positions by the evidence."""
    chosen = task.recipe.scaling_of(len(task.metric), task.options.smacof)
    if task.recipe.refine is None or task.evidence is None:
        return _scaled(task, dimensions, chosen)
    near = chosen
    if chosen.tolerance < _START.tolerance:
        near = _START if chosen == DEFAULT_SMACOF else replace(chosen, tolerance=_START.tolerance)
    begun = monotonic()
    scaled = _scaled(task, dimensions, near)
    seconds = _REFINEMENT * (monotonic() - begun)
    log_stage("fitting positions to all correlations", len(task.metric), seconds)
    return _refined(task, task.evidence, scaled)


def _scaled(task: Task, dimensions: int, options: SmacofOptions) -> Configuration:
    """Scale each connected component of the metric by SMACOF.

    McGregor et al. (2011), section "ANISOMAP", step 3, doi:10.1371/journal.pone.0026561.
    """
    metric, start, weights = task.metric, task.start, task.weights
    labels = components(metric if weights is None else np.where(weights > 0, metric, np.inf))
    positions = np.empty((len(metric), dimensions))
    scalings: list[Scaling] = []
    for label in range(labels.max() + 1):
        inside = labels == label
        n_sensors = int(np.count_nonzero(inside))
        log_stage(f"scaling {n_sensors} sensors into {dimensions} dimensions", n_sensors)
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


def _refined(task: Task, evidence: Evidence, scaled: Configuration) -> Configuration:
    """Refine each connected component of at least `min_sensors` sensors."""
    recipe, options = task.recipe, task.options
    positions = scaled.positions.copy()
    raw = spread = 0.0
    refinements: list[Refinement | None] = []
    for label in range(scaled.component.max() + 1):
        inside = scaled.component == label
        lengths = among(task.metric, inside)
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
    made = replace(scaled, positions=positions, stress=stress, refinements=tuple(refinements))
    return replace(made, scaled=scaled.positions)


def among(matrix: Reals, sensors: NDArray[np.bool_]) -> Reals:
    """Select the pairs of some sensors; return the matrix itself if all sensors are selected."""
    return matrix if sensors.all() else matrix[np.ix_(sensors, sensors)]


def best_scale(positions: Floats, lengths: Reals) -> tuple[float, float, float]:
    """Return the least-squares scale of positions, the squared residuals and squared distances."""
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


def as_map(
    configuration: Configuration,
    names: tuple[str, ...],
    mapped: NDArray[np.bool_],
    method: str,
    *,
    similarity: str,
    notes: Sequence[str],
    provenance: Mapping[str, Scalar],
    objects: bool = False,
    stack_level: int = 3,
) -> SensorMap:
    """Make a map of all sensors from the positions of the mapped ones; warn for each note."""
    refined = configuration.largest
    positions = np.full((len(names), configuration.positions.shape[1]), np.nan)
    positions[mapped] = configuration.positions
    component = np.full(len(names), UNPLACED)
    component[mapped] = configuration.component
    for note in notes:
        warnings.warn(note, AnisomapWarning, stacklevel=stack_level)
    facts: dict[str, Scalar] = {"iterations": configuration.n_iterations}
    if refined is not None:
        facts |= {
            "unexplained": round(refined.unexplained, 4),
            "weight_of_paths": round(refined.path_weight, 3),
        }
    return SensorMap(
        positions,
        names=names,
        component=component,
        method=method,
        similarity=similarity,
        stress=configuration.stress,
        n_iterations=configuration.n_iterations,
        distorted=refined is not None and refined.distorted,
        kind="object" if objects else "sensor",
        notes=tuple(notes),
        provenance={**provenance, **facts},
    )


def caveats(
    configuration: Configuration, evidence: Evidence | None, names: Sequence[str]
) -> Iterator[Note]:
    """Yield notes on the limitations of the map of the mapped sensors."""
    component = configuration.component
    sizes = np.bincount(component)
    if sizes.size > 1:
        outside = [names[i] for i in np.flatnonzero(component > 0).tolist()]
        yield Note("components", sizes=sizes.tolist(), outside=outside)
    if not configuration.converged:
        yield Note("not-converged")
    if evidence is None or not configuration.refinements:
        return
    hidden = [names[i] for i in evidence.groups.hidden.tolist()]
    if hidden:
        yield Note("hidden-links", sensors=hidden, total=len(names))
    for one in configuration.refinements:
        if one is not None and one.distorted:
            yield Note("different-contacts", share=one.unexplained)


def unknown_pairs(evidence: Evidence, names: Sequence[str]) -> Note:
    """Return a note on pairs of sensors that were never recorded together."""
    pairs = int(np.count_nonzero(np.triu(~evidence.known)))
    affected = [names[i] for i in np.flatnonzero(~evidence.known.all(axis=1)).tolist()]
    return Note("unknown-pairs", count=pairs, sensors=affected)


def parameters_of(method: str, options: MethodOptions, n_sensors: int) -> dict[str, Scalar]:
    """Return the version and the parameters with which a map of n sensors can be reproduced."""
    recipe, defaults = find_method(method), DEFAULT_OPTIONS
    facts: dict[str, Scalar] = {
        "anisomap": __version__,
        "regularisation": options.regularisation,
        "entropy_bins": options.entropy_bins,
    }
    if options.n_neighbours is not None:
        facts["n_neighbours"] = options.n_neighbours
    if recipe.refine is not None:
        usual = asdict(defaults.covariogram)
        changed = {k: v for k, v in asdict(options.covariogram).items() if v != usual[k]}
        facts |= {f"covariogram_{name}": value for name, value in changed.items()}
    for name in ("independent_frames", "min_sensors"):
        if getattr(options, name) != getattr(defaults, name):
            facts[name] = getattr(options, name)
    return facts | asdict(recipe.scaling_of(n_sensors, options.smacof))
