"""Metricising beside scipy's Floyd-Warshall, and Torgerson beside full eigendecompositions."""

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
from anisomap.numerics.scaling.classical import torgerson
from benchmarks.inputs import flat_skin, noisy_metric, pure_noise, torso_dissimilarity
from benchmarks.measuring import Cost, on_one_thread
from benchmarks.race import Race, Rival, Setting, of_part

Matrix = NDArray[np.floating[Any]]

WHOLE = 4000
"""Points up to which rivals do all of the work: it grows with their cube."""

_SOURCES = 50


def metricising_races(setting: Setting) -> Iterator[Race]:
    """Find shortest paths in skins, in which few edges matter, and where nearly all do."""
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
    for given, (make, goal) in inputs.items():
        lengths = make()
        yield Race(
            "metricising",
            given,
            partial(metricise, lengths),
            (floyd_warshall_rival(lengths, goal),),
        )


def floyd_warshall_rival(lengths: Matrix, goal: float) -> Rival:
    """Take scipy's time from one input, for it does the same on all, and check by Dijkstra."""
    cost, factor = cost_of_floyd_warshall(len(lengths))
    return Rival(
        "scipy floyd_warshall",
        cost,
        lambda paths: are_shortest(paths, lengths),
        goal,
        of_part(f"{WHOLE:,} sensors", factor) or "timed on noise",
        estimated=factor != 1,
    )


@cache
def cost_of_floyd_warshall(n_nodes: int) -> tuple[Cost, float]:
    """Give scipy's cost for so many nodes, and how many times that of a part it is."""
    few = min(n_nodes, WHOLE)
    lengths = pure_noise(few)
    graph = csgraph_from_dense(lengths, null_value=np.inf)
    cost, paths = on_one_thread(lambda: floyd_warshall(graph, directed=False))
    if not are_shortest(paths, lengths):
        raise AssertionError("Dijkstra's paths and those of Floyd and Warshall are not the same")
    factor = (n_nodes / few) ** 3
    return cost.times(factor), factor


def are_shortest(paths: Matrix, lengths: Matrix) -> bool:
    """Tell whether paths from some sources are those that Dijkstra's algorithm finds."""
    sources = np.unique(np.linspace(0, len(lengths) - 1, _SOURCES).astype(int))
    expected = dijkstra(_all_edges(lengths), indices=sources)
    close = 1e-12 if paths.dtype == np.float64 else 1e-5
    symmetric = np.array_equal(paths[sources], paths[:, sources].T)
    return symmetric and np.allclose(paths[sources], expected, rtol=close, atol=0)


def _all_edges(lengths: Matrix) -> csr_array:
    """Keep every entry as an edge, also of length 0; scipy's own way takes much more memory."""
    n_nodes = len(lengths)
    ends = np.tile(np.arange(n_nodes, dtype=np.int32), n_nodes)
    offsets = np.arange(n_nodes + 1, dtype=np.int32) * n_nodes
    return csr_array((lengths.ravel(), ends, offsets), shape=lengths.shape)


def torgerson_races(setting: Setting) -> Iterator[Race]:
    """Scale the metric of a skin classically."""
    metric = metricise(flat_skin(setting.n_sensors))
    yield Race("Torgerson", "simulated skin", partial(torgerson, metric, 3), tuple(_eigen(metric)))


def _eigen(metric: Matrix) -> Iterator[Rival]:
    cost, expected, factor = cost_of_eigh(len(metric))

    def same(positions: Matrix) -> bool:
        if factor != 1:
            return are_eigenvectors(positions, metric)
        return apart(positions, expected) < 1e-7

    how = of_part(f"{WHOLE:,} sensors", factor)
    yield Rival("scipy.linalg.eigh", cost, same, 50, how, estimated=factor != 1)
    if hasattr(manifold, "ClassicalMDS") and factor == 1:
        scale = manifold.ClassicalMDS(n_components=3, metric="precomputed").fit_transform
        cost, positions = on_one_thread(lambda: scale(metric))
        yield Rival("sklearn ClassicalMDS", cost, lambda ours: apart(ours, positions) < 1e-7)


@cache
def cost_of_eigh(n_points: int) -> tuple[Cost, Matrix, float]:
    """Give what a full eigendecomposition of a skin costs and finds; see above for many points."""
    few = min(n_points, WHOLE)
    metric = metricise(flat_skin(few))
    cost, positions = on_one_thread(lambda: full_torgerson(metric, 3))
    factor = (n_points / few) ** 3
    return cost.times(factor), positions, factor


def full_torgerson(metric: Matrix, dimensions: int) -> Matrix:
    """Scale classically as one would write it."""
    squares = metric**2
    rows = squares.mean(axis=0)
    values, vectors = eigh(-(squares - rows - rows[:, None] + rows.mean()) / 2)
    return np.asarray(vectors[:, -dimensions:] * np.sqrt(np.maximum(values[-dimensions:], 0)))


def are_eigenvectors(positions: Matrix, metric: Matrix) -> bool:
    """Tell whether the columns are eigenvectors of the centred squares, as long as these say."""
    centred = positions - positions.mean(axis=0)
    product = np.vstack([row**2 @ centred for row in np.array_split(metric, 50)])
    product = (product - product.mean(axis=0)) / -2
    values = (positions**2).sum(axis=0)
    error = np.linalg.norm(product - values * positions, axis=0)
    return bool((error <= 1e-5 * values**1.5).all())


def apart(positions: Matrix, others: Matrix) -> float:
    """Tell by how much distances differ, as a share of the greatest."""
    expected = pdist(others)
    return float(np.abs(pdist(positions) - expected).max() / expected.max())
