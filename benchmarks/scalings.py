"""SMACOF, compared with scikit-learn's: fixed iterations, and to within 0.1 % of the stress."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist, pdist, squareform
from sklearn.manifold import smacof as sklearn_smacof

from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.scaling.multidimensional_scaling import (
    Scaling,
    SmacofOptions,
    smacof,
    torgerson,
)
from anisomap.numerics.scaling.stress_solvers import Problem, objective
from benchmarks.comparison import Comparison, Reference, Setting, describe_share
from benchmarks.inputs import flat_skin, round_skin
from benchmarks.measuring import Cost, measure_on_one_thread

Matrix = NDArray[np.floating[Any]]

STRESS_TOLERANCE = 1 + 1e-3
MAX_REFERENCE_SENSORS = 4000
MAX_STEPS = 500

_ITERATIONS = 30
_SHARE_MISSING = 0.3


class Steps(NamedTuple):
    """Number of majorisation steps, whether they sufficed, and the final raw stress."""

    taken: int
    enough: bool
    raw: float

    def __str__(self) -> str:
        return f"{self.taken}" if self.enough else f"more than {self.taken}"


class Majorisation(NamedTuple):
    """SMACOF by majorisation: name, CPU seconds per step, how these were estimated, maximum steps.

    ``descend(target, max_steps)`` iterates to the raw stress `target` in at most `max_steps`.
    """

    name: str
    each: float
    details: str
    max_steps: int
    descend: Callable[[float, int], Steps]


def compare_smacof(setting: Setting) -> Iterator[Comparison]:
    """Scaling of a flat skin in 3D, which converges slowly, in 2D, and with missing pairs."""
    metric = metricise(flat_skin(setting.n_sensors))
    start = torgerson(metric, 3)
    compute, plain = partial(_descend, metric, start), sklearn_majorisation(metric, start)
    yield _fixed_iterations("flat skin in space", compute, plain, 30)
    yield _to_tolerance("flat skin in space", compute, plain, 100)
    start = torgerson(metric, 2)
    compute, plain = partial(_descend, metric, start), sklearn_majorisation(metric, start)
    yield _to_tolerance("flat skin in the plane", compute, plain, 5)
    if len(metric) <= min(setting.max_slow_sensors, MAX_REFERENCE_SENSORS):
        yield from _missing(metric, torgerson(metric, 3))
    metric = metricise(round_skin(setting.n_sensors))
    start = torgerson(metric, 3)
    compute, plain = partial(_descend, metric, start), sklearn_majorisation(metric, start)
    yield _to_tolerance("round skin in space", compute, plain, 5)


def _missing(metric: Matrix, start: Matrix) -> Iterator[Comparison]:
    upper = np.triu(np.random.default_rng(0).random(metric.shape) >= _SHARE_MISSING, 1)
    weights = (upper + upper.T).astype(np.float64)
    compute = partial(_descend, metric, start, weights=weights)
    dataset = "flat skin in space, 30 % of pairs missing"
    plain = weighted_majorisation(metric, weights, start)
    yield _fixed_iterations(dataset, compute, plain)
    yield _to_tolerance(dataset, compute, plain)


def _descend(
    metric: Matrix, start: Matrix, iterations: int | None, weights: Matrix | None = None
) -> Scaling:
    """Run SMACOF for a number of iterations, or to convergence."""
    usual = SmacofOptions()
    options = usual if iterations is None else SmacofOptions(0, iterations, usual.solver)
    return smacof(metric, start=start, weights=weights, options=options)


def _fixed_iterations(
    dataset: str,
    compute: Callable[[int | None], Scaling],
    plain: Majorisation,
    goal: float | None = None,
) -> Comparison:
    """Compare a fixed number of iterations of a long descent."""
    target = plain.descend(0, _ITERATIONS).raw * (1 + 1e-6)
    reference = Reference(
        plain.name,
        Cost(_ITERATIONS * plain.each, np.nan),
        lambda result: bool(result.raw_stress <= target),
        goal,
        plain.details,
        estimated=bool(plain.details),
    )
    stage = f"SMACOF, {_ITERATIONS} iterations"
    return Comparison(stage, dataset, partial(compute, _ITERATIONS), (reference,), drawn=False)


def _to_tolerance(
    dataset: str,
    compute: Callable[[int | None], Scaling],
    plain: Majorisation,
    goal: float | None = None,
) -> Comparison:
    """Compare the time to 0.1 % above the final stress; reference steps are counted and timed."""
    converged = compute(None)
    target = converged.raw_stress * STRESS_TOLERANCE
    needed = _needed(compute, converged, target)
    steps = plain.descend(target, plain.max_steps)
    reference = Reference(
        plain.name,
        Cost(steps.taken * plain.each, np.nan),
        lambda result: bool(result.raw_stress <= target),
        goal,
        f"{steps} steps x {plain.each:.2g} s; anisomap: {needed}",
        estimated=True,
    )
    return Comparison(
        "SMACOF to 0.1 % above the best", dataset, partial(compute, needed), (reference,)
    )


def _needed(compute: Callable[[int | None], Scaling], converged: Scaling, target: float) -> int:
    """Return the number of iterations that reach the target."""
    needed = int(np.flatnonzero(converged.trace <= target)[0])
    while compute(needed).raw_stress > target:
        needed += 1 + needed // 20
    return needed


def sklearn_majorisation(metric: Matrix, start: Matrix) -> Majorisation:
    """Time scikit-learn's steps; their number is counted with compiled loops to save hours."""
    each, factor = time_of_sklearn_step(len(metric))
    alike = Problem(metric, np.ones((1, len(metric))))
    return Majorisation(
        "sklearn smacof",
        each,
        describe_share(f"{MAX_REFERENCE_SENSORS:,} sensors", factor),
        MAX_STEPS if factor == 1 else MAX_STEPS // 10,
        partial(_majorise, alike, start, lambda gradient: gradient / (2 * len(metric))),
    )


@cache
def time_of_sklearn_step(n_points: int) -> tuple[float, float]:
    """Return CPU seconds of scikit-learn's step, equal on any input, and their extrapolation.

    The step is one in the plane; in space it takes up to a tenth longer.
    """
    few = min(n_points, MAX_REFERENCE_SENSORS)
    factor = (n_points / few) ** 2
    rng = np.random.default_rng(0)
    metric = squareform(pdist(rng.normal(size=(few, 2))))
    start = rng.normal(size=(few, 2))

    def steps() -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of parameters that scikit-learn renames
            sklearn_smacof(
                metric,
                n_components=2,
                init=start,
                n_init=1,
                max_iter=_ITERATIONS,
                eps=0,
                metric=True,
                normalized_stress=False,
            )

    cost, _ = measure_on_one_thread(steps)
    return cost.cpu / _ITERATIONS * factor, factor


def weighted_majorisation(metric: Matrix, weights: Matrix, start: Matrix) -> Majorisation:
    """Time weighted majorisation in numpy; scikit-learn has no weights."""
    n_points = len(metric)
    laplacian = np.diag(weights.sum(axis=1)) - weights
    inverse = np.linalg.inv(laplacian + 1 / n_points) - 1 / n_points

    def step(positions: Matrix) -> Matrix:
        distances = cdist(positions, positions)
        distances[distances == 0] = np.inf
        pulls = -weights * metric / distances
        np.fill_diagonal(pulls, -pulls.sum(axis=1))
        return np.asarray(inverse @ (pulls @ positions))

    cost, _ = measure_on_one_thread(lambda: step(start))
    return Majorisation(
        "numpy, inverse precomputed",
        cost.cpu,
        f"1 step x {_ITERATIONS}",
        MAX_STEPS,
        partial(_majorise, Problem(metric, weights), start, lambda slope: inverse @ slope / 2),
    )


def _majorise(
    problem: Problem,
    start: Matrix,
    step: Callable[[NDArray[np.float64]], Any],
    target: float,
    max_steps: int,
) -> Steps:
    with objective(problem) as stress:
        positions = np.asarray(start, np.float64)
        raw, gradient = stress(positions)
        taken = 0
        while raw > target and taken < max_steps:
            positions = positions - step(gradient)
            raw, gradient = stress(positions)
            taken += 1
    return Steps(taken, raw <= target, raw)
