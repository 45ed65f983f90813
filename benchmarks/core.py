"""Metricising, Torgerson and SMACOF beside scipy and scikit-learn: what grows with N alone."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.sparse import csr_array
from scipy.sparse.csgraph import csgraph_from_dense, floyd_warshall
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist, squareform
from sklearn.manifold import smacof as sklearn_smacof
from threadpoolctl import threadpool_limits

from anisomap.numerics import compiled
from anisomap.numerics.dissimilarity import regularised_reciprocal
from anisomap.numerics.graph import metricise
from anisomap.numerics.scaling import Scaling, SmacofOptions, smacof, torgerson
from anisomap.numerics.stress import Problem, objective

Matrix = NDArray[np.floating[Any]]
Result = TypeVar("Result")

NEAR_THE_BEST = 1 + 1e-3
FEW_ITERATIONS = 30


@dataclass(frozen=True)
class Contest:
    """A stage on one input, and the seconds of CPU that the other takes for the same."""

    stage: str
    against: str
    ours: Callable[[], object]
    theirs: float
    same: bool


@dataclass(frozen=True)
class Cost:
    """What a run took: seconds on the clock, and of CPU time by all threads together."""

    wall: float
    cpu: float


def skin_dissimilarity(n_sensors: int, rng: np.random.Generator, reach: float = 2.5) -> Matrix:
    """Reciprocals of the correlations of a flat skin that is touched everywhere alike."""
    width = n_sensors**0.5
    sensors = rng.uniform(0, width, (n_sensors, 2))
    touches = rng.uniform(0, width, (8 * n_sensors, 2))
    apart = KDTree(touches).sparse_distance_matrix(KDTree(sensors), reach, output_type="coo_matrix")
    pressure = rng.uniform(0.5, 1.5, len(touches))
    readings = csr_array((pressure[apart.row] * (reach - apart.data), (apart.row, apart.col)))
    mean: Matrix = readings.mean(axis=0)
    covariance = (readings.T @ readings).toarray() / len(touches) - np.outer(mean, mean)
    deviation = np.sqrt(np.diag(covariance))
    return regularised_reciprocal(covariance / np.outer(deviation, deviation))


def noisy_metric(n_sensors: int, rng: np.random.Generator) -> Matrix:
    """Distances in space, each a little wrong: very many edges are shortest paths themselves."""
    distances = pdist(rng.normal(size=(n_sensors, 3)))
    return squareform(distances * rng.uniform(0.95, 1.05, len(distances)))


def pure_noise(n_sensors: int, rng: np.random.Generator) -> Matrix:
    """Independent lengths, as from sensors that have nothing in common."""
    return squareform(rng.uniform(0.01, 1, n_sensors * (n_sensors - 1) // 2))


def contests(n_sensors: int) -> Iterator[Contest]:
    """Compare the results of each stage, and hand it over to be timed."""
    rng = np.random.default_rng(0)
    skin = skin_dissimilarity(n_sensors, rng)
    hard = {"distances with noise": noisy_metric, "pure noise": pure_noise}
    inputs = {"skin": skin} | {name: make(n_sensors, rng) for name, make in hard.items()}
    for name, lengths in inputs.items():
        yield _metricising(name, lengths)
    metric = metricise(skin)
    yield _torgerson(metric)
    yield from _scaling("skin in space", metric, 3)
    yield from _scaling("skin in the plane", metric, 2)


def _metricising(name: str, lengths: Matrix) -> Contest:
    cost, expected = timed(
        lambda: floyd_warshall(csgraph_from_dense(lengths, null_value=np.inf), directed=False), 1
    )
    same = np.allclose(metricise(lengths), expected, rtol=1e-12, atol=0)
    return Contest(
        f"metricising, {name}", "scipy floyd_warshall", lambda: metricise(lengths), cost.cpu, same
    )


def _torgerson(metric: Matrix) -> Contest:
    centring = np.eye(len(metric)) - 1 / len(metric)
    inner = -centring @ metric**2 @ centring / 2
    cost, (values, vectors) = timed(lambda: eigh(inner), 1)
    expected = pdist(vectors[:, -3:] * np.sqrt(values[-3:]))
    error = np.abs(pdist(torgerson(metric, 3)) - expected).max() / expected.max()
    return Contest(
        "Torgerson", "scipy.linalg.eigh", lambda: torgerson(metric, 3), cost.cpu, error < 1e-7
    )


def _scaling(name: str, metric: Matrix, dimensions: int) -> Iterator[Contest]:
    start = torgerson(metric, dimensions)

    def ours(iterations: int, tolerance: float = 0) -> Scaling:
        return smacof(metric, start=start, options=SmacofOptions(tolerance, iterations))

    best = ours(3000, 1e-10).raw_stress
    cost, theirs = timed(lambda: _sklearn(metric, start, FEW_ITERATIONS), 1)
    each = cost.cpu / FEW_ITERATIONS
    yield Contest(
        f"SMACOF, {FEW_ITERATIONS} iterations, {name}",
        "sklearn.manifold.smacof",
        lambda: ours(FEW_ITERATIONS),
        cost.cpu,
        ours(FEW_ITERATIONS).raw_stress <= theirs * (1 + 1e-6),
    )
    needed = _first_below(best * NEAR_THE_BEST, ours(3000, 1e-10).trace)
    steps = _guttman_steps(metric, start, best * NEAR_THE_BEST)
    yield Contest(
        f"SMACOF to 0.1 % above the best, {name}: {needed} iterations",
        f"sklearn.manifold.smacof: {steps} x {each:.3f} s",
        lambda: ours(needed),
        steps * each,
        ours(needed).raw_stress <= best * NEAR_THE_BEST,
    )


def _sklearn(metric: Matrix, start: Matrix, iterations: int) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _, stress = sklearn_smacof(
            metric,
            n_components=start.shape[1],
            init=start,
            n_init=1,
            max_iter=iterations,
            eps=0,
            metric=True,
            normalized_stress=False,
        )
    return float(stress)


def _guttman_steps(
    metric: Matrix, start: NDArray[np.float64], goal: float, most: int = 3000
) -> int:
    """Count the iterations that scikit-learn needs: its steps are these, and take it minutes."""
    with objective(Problem(metric, np.ones((1, len(metric))))) as stress:
        positions = start
        for step in range(most):
            raw, gradient = stress(positions)
            if raw <= goal:
                return step
            positions = positions - gradient / (2 * len(metric))
    return most


def _first_below(goal: float, trace: Matrix) -> int:
    return int(np.flatnonzero(trace <= goal)[0])


def timed(run: Callable[[], Result], repeats: int = 3) -> tuple[Cost, Result]:
    """Give the least cost of several runs, since what disturbs a run only ever slows it."""
    walls, cpus = [], []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        result = run()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return Cost(min(walls), min(cpus)), result


def main(sizes: Sequence[int]) -> None:
    """Print what each stage costs on one core and on all, and how it grows with N."""
    grown: dict[str, list[float]] = {}
    print("| sensors | stage | CPU (s) | clock, all cores (s) | against | CPU (s) | ratio | same |")
    print("|---|---|---|---|---|---|---|---|")
    with threadpool_limits(1):
        for n_sensors in sizes:
            for contest in contests(n_sensors):
                with patch.object(compiled, "thread_count", lambda: 1):
                    alone, _ = timed(contest.ours)
                together, _ = timed(contest.ours)
                grown.setdefault(contest.stage.partition(":")[0], []).append(alone.cpu)
                print(
                    f"| {n_sensors} | {contest.stage} | {alone.cpu:.4f} | {together.wall:.4f} "
                    f"| {contest.against} | {contest.theirs:.4f} "
                    f"| {contest.theirs / alone.cpu:.1f} | {'yes' if contest.same else 'NO'} |",
                    flush=True,
                )
    if len(sizes) > 1:
        _print_growth(sizes, grown)


def _print_growth(sizes: Sequence[int], grown: dict[str, list[float]]) -> None:
    print(f"\n| stage | CPU grows from {sizes[-2]} to {sizes[-1]} sensors as N to the |")
    print("|---|---|")
    for stage, seconds in grown.items():
        exponent = np.log(seconds[-1] / seconds[-2]) / np.log(sizes[-1] / sizes[-2])
        print(f"| {stage} | {exponent:.1f} |")
