"""SMACOF beside scikit-learn's: so many iterations, and down to 0.1 % above the best stress."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from sklearn.manifold import smacof as sklearn_smacof

from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.scaling.classical import torgerson
from anisomap.numerics.scaling.stress import Problem, objective
from anisomap.numerics.scaling.stress_minimisation import Scaling, SmacofOptions, smacof
from benchmarks.inputs import flat_skin, round_skin
from benchmarks.measuring import Cost, on_one_thread
from benchmarks.race import Race, Rival, Setting, of_part

Matrix = NDArray[np.floating[Any]]

NEAR_THE_BEST = 1 + 1e-3
WHOLE = 4000
MOST_STEPS = 1000

_ITERATIONS = 30
_SHARE_MISSING = 0.3


class Steps(NamedTuple):
    """How many steps of majorisation were taken, whether they sufficed, and the last raw stress."""

    taken: int
    enough: bool
    raw: float

    def __str__(self) -> str:
        return f"{self.taken}" if self.enough else f"more than {self.taken}"


class Plain(NamedTuple):
    """SMACOF as others do it: the name, seconds of CPU a step, how these were come by, and steps.

    ``walk(target, most)`` goes down to that raw stress, for so many steps at the most; `most` is
    how many are worth waiting for.
    """

    name: str
    each: float
    how: str
    most: int
    walk: Callable[[float, int], Steps]


def smacof_races(setting: Setting) -> Iterator[Race]:
    """Scale a flat skin, which creeps in space, also with pairs missing, and a round one."""
    metric = metricise(flat_skin(setting.n_sensors))
    start = torgerson(metric, 3)
    ours, plain = partial(_go_down, metric, start), of_sklearn(metric, start)
    yield _some_iterations("flat skin in space", ours, plain, 30)
    yield _near_the_best("flat skin in space", ours, plain, 100)
    start = torgerson(metric, 2)
    ours, plain = partial(_go_down, metric, start), of_sklearn(metric, start)
    yield _near_the_best("flat skin in the plane", ours, plain, 5)
    if len(metric) <= WHOLE:
        yield from _missing(metric, torgerson(metric, 3))
    metric = metricise(round_skin(setting.n_sensors))
    start = torgerson(metric, 3)
    ours, plain = partial(_go_down, metric, start), of_sklearn(metric, start)
    yield _near_the_best("round skin in space", ours, plain, 5)


def _missing(metric: Matrix, start: Matrix) -> Iterator[Race]:
    upper = np.triu(np.random.default_rng(0).random(metric.shape) >= _SHARE_MISSING, 1)
    weights = (upper + upper.T).astype(np.float64)
    ours = partial(_go_down, metric, start, weights=weights)
    given = "flat skin in space, 30 % of pairs missing"
    plain = of_weighted(metric, weights, start)
    yield _some_iterations(given, ours, plain)
    yield _near_the_best(given, ours, plain)


def _go_down(
    metric: Matrix, start: Matrix, iterations: int | None, weights: Matrix | None = None
) -> Scaling:
    """Run SMACOF for so many iterations, or to its usual end."""
    usual = SmacofOptions()
    options = usual if iterations is None else SmacofOptions(0, iterations, usual.solver)
    return smacof(metric, start=start, weights=weights, options=options)


def _some_iterations(
    given: str, ours: Callable[[int | None], Scaling], plain: Plain, goal: float | None = None
) -> Race:
    """Take a number of iterations of a descent that is long: at its end, few lower the stress."""
    as_far = plain.walk(0, _ITERATIONS).raw * (1 + 1e-6)
    rival = Rival(
        plain.name,
        Cost(_ITERATIONS * plain.each, np.nan),
        lambda made: bool(made.raw_stress <= as_far),
        goal,
        plain.how,
        estimated=bool(plain.how),
    )
    stage = f"SMACOF, {_ITERATIONS} iterations"
    return Race(stage, given, partial(ours, _ITERATIONS), (rival,), drawn=False)


def _near_the_best(
    given: str, ours: Callable[[int | None], Scaling], plain: Plain, goal: float | None = None
) -> Race:
    """Go down to 0.1 % above the best; the rival's time is that of its steps, which are counted."""
    usual = ours(None)
    target = usual.raw_stress * NEAR_THE_BEST
    needed = _needed(ours, usual, target)
    steps = plain.walk(target, plain.most)
    rival = Rival(
        plain.name,
        Cost(steps.taken * plain.each, np.nan),
        lambda made: bool(made.raw_stress <= target),
        goal,
        f"{steps} steps x {plain.each:.2g} s; ours takes {needed}",
        estimated=True,
    )
    return Race("SMACOF to 0.1 % above the best", given, partial(ours, needed), (rival,))


def _needed(ours: Callable[[int | None], Scaling], usual: Scaling, target: float) -> int:
    """Count the iterations that lead so far down."""
    needed = int(np.flatnonzero(usual.trace <= target)[0])
    while ours(needed).raw_stress > target:
        needed += 1 + needed // 20
    return needed


def of_sklearn(metric: Matrix, start: Matrix) -> Plain:
    """Time scikit-learn's steps; they are counted by our compiled loops, or it would take hours."""
    few = min(len(metric), WHOLE)
    factor = (len(metric) / few) ** 2

    def steps() -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # parameters are about to be renamed
            sklearn_smacof(
                metric[:few, :few],
                n_components=start.shape[1],
                init=start[:few],
                n_init=1,
                max_iter=_ITERATIONS,
                eps=0,
                metric=True,
                normalized_stress=False,
            )

    cost, _ = on_one_thread(steps)
    alike = Problem(metric, np.ones((1, len(metric))))
    return Plain(
        "sklearn smacof",
        cost.cpu * factor / _ITERATIONS,
        of_part(f"{few:,} sensors", factor),
        MOST_STEPS if factor == 1 else MOST_STEPS // 10,
        partial(_majorise, alike, start, lambda gradient: gradient / (2 * len(metric))),
    )


def of_weighted(metric: Matrix, weights: Matrix, start: Matrix) -> Plain:
    """Time weighted majorisation as one would write it in numpy; scikit-learn has none."""
    n_points = len(metric)
    laplacian = np.diag(weights.sum(axis=1)) - weights
    inverse = np.linalg.inv(laplacian + 1 / n_points) - 1 / n_points

    def step(positions: Matrix) -> Matrix:
        distances = cdist(positions, positions)
        distances[distances == 0] = np.inf
        pulls = -weights * metric / distances
        np.fill_diagonal(pulls, -pulls.sum(axis=1))
        return np.asarray(inverse @ (pulls @ positions))

    cost, _ = on_one_thread(lambda: step(start))
    return Plain(
        "numpy, its inverse given",
        cost.cpu,
        f"1 step x {_ITERATIONS}",
        MOST_STEPS,
        partial(_majorise, Problem(metric, weights), start, lambda slope: inverse @ slope / 2),
    )


def _majorise(
    problem: Problem,
    start: Matrix,
    step: Callable[[NDArray[np.float64]], Any],
    target: float,
    most: int,
) -> Steps:
    with objective(problem) as stress:
        positions = np.asarray(start, np.float64)
        raw, gradient = stress(positions)
        taken = 0
        while raw > target and taken < most:
            positions = positions - step(gradient)
            raw, gradient = stress(positions)
            taken += 1
    return Steps(taken, raw <= target, raw)
