"""Metricising, compared with scipy's Floyd-Warshall; Torgerson, with full eigendecompositions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.sparse import csr_array
from scipy.sparse.csgraph import csgraph_from_dense, dijkstra, floyd_warshall
from scipy.spatial.distance import pdist
from sklearn import manifold

from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.scaling.multidimensional_scaling import torgerson
from benchmarks.comparison import (
    MIN_GOAL_SENSORS,
    Comparison,
    Reference,
    Setting,
    describe_share,
)
from benchmarks.inputs import flat_skin, noisy_metric, noisy_skin, pure_noise, torso_dissimilarity
from benchmarks.measuring import Cost, measure_on_one_thread

Matrix = NDArray[np.floating[Any]]

MAX_REFERENCE_SENSORS = 2000
"""References compute a share of larger problems: their cost grows at least with the cube."""

NOISY_SKINS = {1500: 20.0, 3000: 30.0}
"""Numbers of sensors of skins with noise, which have other sizes, and the goals there."""

_SOURCES = 10


def compare_metricising(setting: Setting) -> Iterator[Comparison]:
    """Shortest paths in skins and in noise."""
    n_sensors, torso = setting.n_sensors, setting.torso
    inputs: dict[str, tuple[Callable[[], Matrix], float]] = {
        "simulated skin": (partial(flat_skin, n_sensors), 50)
    }
    if torso:
        inputs["torso, tiled"] = (
            partial(torso_dissimilarity, torso, n_sensors, setting.n_frames),
            50,
        )
    inputs["metric with noise"] = (partial(noisy_metric, n_sensors), 15)
    inputs["pure noise"] = (partial(pure_noise, n_sensors), 15)
    for dataset, (make, goal) in inputs.items():
        lengths = make()
        yield Comparison(
            "metricising",
            dataset,
            partial(metricise, lengths),
            (floyd_warshall_reference(lengths, goal),),
        )
    for few, goal in NOISY_SKINS.items() if n_sensors >= MIN_GOAL_SENSORS else ():
        lengths = noisy_skin(few)
        yield Comparison(
            "metricising",
            f"skin with noise, {few:,} sensors",
            partial(metricise, lengths),
            (floyd_warshall_reference(lengths, goal),),
            drawn=False,
        )


def floyd_warshall_reference(lengths: Matrix, goal: float) -> Reference:
    """Time scipy on noise, since its work does not depend on the input; check by Dijkstra."""
    cost, factor = cost_of_floyd_warshall(len(lengths))
    return Reference(
        "scipy floyd_warshall",
        cost,
        lambda paths: are_shortest_paths(paths, lengths),
        goal,
        describe_share(f"{MAX_REFERENCE_SENSORS:,} sensors", factor) or "timed on noise",
        estimated=factor != 1,
    )


def cost_of_floyd_warshall(n_nodes: int) -> tuple[Cost, float]:
    """Return scipy's cost for `n_nodes` and the factor of its extrapolation."""
    few = min(n_nodes, MAX_REFERENCE_SENSORS)
    factor = (n_nodes / few) ** 3
    return _measured_floyd_warshall(few).times(factor), factor


@cache
def _measured_floyd_warshall(n_nodes: int) -> Cost:
    lengths = pure_noise(n_nodes)
    graph = csgraph_from_dense(lengths, null_value=np.inf)
    cost, paths = measure_on_one_thread(lambda: floyd_warshall(graph, directed=False))
    if not are_shortest_paths(paths, lengths):
        raise AssertionError("the paths of Dijkstra and Floyd-Warshall differ")
    return cost


def are_shortest_paths(paths: Matrix, lengths: Matrix) -> bool:
    """Return whether the paths from some sources agree with Dijkstra's algorithm."""
    sources = np.unique(np.linspace(0, len(lengths) - 1, _SOURCES).astype(int))
    expected = dijkstra(_all_edges(lengths), indices=sources)
    close = 1e-12 if paths.dtype == np.float64 else 1e-5
    symmetric = np.array_equal(paths[sources], paths[:, sources].T)
    return symmetric and np.allclose(paths[sources], expected, rtol=close, atol=0)


def _all_edges(lengths: Matrix) -> csr_array:
    """Keep every entry as an edge, including zeros; scipy's conversion needs much more memory."""
    n_nodes = len(lengths)
    ends = np.tile(np.arange(n_nodes, dtype=np.int32), n_nodes)
    offsets = np.arange(n_nodes + 1, dtype=np.int32) * n_nodes
    return csr_array((lengths.ravel(), ends, offsets), shape=lengths.shape)


def compare_torgerson(setting: Setting) -> Iterator[Comparison]:
    """Classical scaling of the metric of a skin."""
    metric = metricise(flat_skin(setting.n_sensors))
    yield Comparison(
        "Torgerson", "simulated skin", partial(torgerson, metric, 3), tuple(_eigen(metric))
    )


def _eigen(metric: Matrix) -> Iterator[Reference]:
    cost, expected, factor = cost_of_eigh(len(metric))
    tolerance = 1e-5 if metric.dtype == np.float32 else 1e-7

    def same(positions: Matrix) -> bool:
        if factor != 1:
            return are_eigenvectors(positions, metric)
        return relative_difference(positions, expected) < tolerance

    details = describe_share(f"{MAX_REFERENCE_SENSORS:,} sensors", factor)
    yield Reference("scipy.linalg.eigh", cost, same, 50, details, estimated=factor != 1)
    if hasattr(manifold, "ClassicalMDS") and factor == 1:
        scale = manifold.ClassicalMDS(n_components=3, metric="precomputed").fit_transform
        cost, positions = measure_on_one_thread(lambda: scale(metric))
        yield Reference(
            "sklearn ClassicalMDS",
            cost,
            lambda result: relative_difference(result, positions) < tolerance,
        )


@cache
def cost_of_eigh(n_points: int) -> tuple[Cost, Matrix, float]:
    """Return cost, positions and extrapolation factor of a full eigendecomposition."""
    few = min(n_points, MAX_REFERENCE_SENSORS)
    metric = metricise(flat_skin(few))
    cost, positions = measure_on_one_thread(lambda: full_torgerson(metric, 3))
    factor = (n_points / few) ** 3
    return cost.times(factor), positions, factor


def full_torgerson(metric: Matrix, dimensions: int) -> Matrix:
    """Classical scaling by a full eigendecomposition."""
    squares = metric**2
    rows = squares.mean(axis=0)
    values, vectors = eigh(-(squares - rows - rows[:, None] + rows.mean()) / 2)
    return np.asarray(vectors[:, -dimensions:] * np.sqrt(np.maximum(values[-dimensions:], 0)))


def are_eigenvectors(positions: Matrix, metric: Matrix) -> bool:
    """Return whether the columns are eigenvectors of the centred squares, scaled accordingly."""
    centred = positions - positions.mean(axis=0)
    product = np.vstack([row**2 @ centred for row in np.array_split(metric, 50)])
    product = (product - product.mean(axis=0)) / -2
    values = (positions**2).sum(axis=0)
    error = np.linalg.norm(product - values * positions, axis=0)
    # Eigenvectors of float32 distances are iterated to a tolerance of 1e-5.
    tolerance = 5e-5 if metric.dtype == np.float32 else 1e-5
    return bool((error <= tolerance * values**1.5).all())


def relative_difference(positions: Matrix, others: Matrix) -> float:
    """Return the largest difference of distances relative to the largest distance."""
    expected = pdist(others)
    return float(np.abs(pdist(positions) - expected).max() / expected.max())
