"""The timed stages, and the same computations with numpy, scipy and scikit-learn.

To add a stage, write a function that yields comparisons for a number of sensors and of frames, and
add one line to `STAGES`. References do a share of the work of many sensors, the first of them.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh
from scipy.sparse import csr_array
from scipy.sparse.csgraph import csgraph_from_dense, dijkstra, floyd_warshall
from scipy.spatial.distance import cdist
from scipy.special import xlogy
from scipy.stats import spearmanr
from sklearn.manifold import smacof as sklearn_smacof
from sklearn.metrics import mutual_info_score

from anisomap import AnisomapWarning, SensorMap, reconstruct
from anisomap.base.defaults import DEFAULT_BINS
from anisomap.numerics.graph.dissimilarity import regularised_reciprocal
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.scaling.multidimensional_scaling import (
    Scaling,
    SmacofOptions,
    smacof,
    torgerson,
)
from anisomap.numerics.similarity.binning import maximum_entropy_codes
from anisomap.numerics.similarity.correlation import co_activation, pearson, spearman
from anisomap.numerics.similarity.information import information_from_codes
from benchmarks.skins.inputs import (
    flat_skin,
    noisy_metric,
    noisy_readings,
    noisy_skin,
    pure_noise,
    round_skin,
    rubbed_skin,
    tiled_torso,
)
from benchmarks.speed.measuring import Comparison, Reference

Matrix = NDArray[np.floating[Any]]
Codes = NDArray[np.uint16]

MAX_REFERENCE_SENSORS, MAX_SCALED_SENSORS = 2000, 4000
MAX_ONE_HOT = 2000
"""Columns of the product of one-hot codes."""

N_PAIRS = 60
"""Pairs of sensors for which scikit-learn computes the mutual information."""

_SPEARMAN_FRAMES = 3000
_FEW_BINS, _MANY_BINS = 2, 8
_DIMENSIONS = 3
_SOURCES = 10  # of the shortest paths that are checked
_SHARE_MISSING = 0.3
_STEPS = 300  # of majorisation with missing pairs: scikit-learn's default for MDS
_NO_WORSE = 1 + 1e-3  # raw stress, compared with that of the reference


def on_first_sensors(
    name: str,
    compute: Callable[[int], Any],
    same: Callable[[Any, Any], bool],
    n_sensors: int,
    *,
    power: int,
    goal: float | None = None,
    most: int = 0,
) -> Reference:
    """Return a reference that is computed for the first sensors, at most `most` of them.

    power: Of the number of sensors, with which the cost grows.
    """
    few = min(n_sensors, most or MAX_REFERENCE_SENSORS)
    factor = (n_sensors / few) ** power
    return Reference(name, partial(compute, few), same, goal, f"{few:,} sensors", factor)


def are_equal(tolerance: float) -> Callable[[Matrix, Matrix], bool]:
    """Return a function that compares the pairs of the first sensors."""

    def same(result: Matrix, expected: Matrix) -> bool:
        few = len(expected)
        return bool(np.abs(result[:few, :few] - expected).max() <= tolerance)

    return same


def correlations(n_sensors: int, n_frames: int, torso: Path | None) -> Iterator[Comparison]:
    """Pearson's r."""
    inputs: dict[str, Matrix] = {"simulated skin": rubbed_skin(n_sensors, n_frames)[0]}
    if torso:
        inputs["torso, tiled"] = tiled_torso(torso, n_sensors, n_frames)
    inputs["pure noise"] = noisy_readings(n_sensors, n_frames)
    for dataset, readings in inputs.items():
        reference = on_first_sensors(
            "numpy.corrcoef",
            partial(by_corrcoef, readings),
            are_equal(1e-5),
            readings.shape[1],
            power=2,
            goal=2,
        )
        yield Comparison("Pearson r", dataset, partial(pearson, readings), (reference,))


def by_corrcoef(readings: Matrix, few: int) -> Matrix:
    """Pearson's r by numpy."""
    return np.asarray(np.corrcoef(readings[:, :few].T))


def rank_correlations(n_sensors: int, n_frames: int, _: Path | None) -> Iterator[Comparison]:
    """Spearman's rho of the first frames: ranking is slow, and both sides use scipy for it."""
    readings = rubbed_skin(n_sensors, n_frames)[0][:_SPEARMAN_FRAMES]
    reference = on_first_sensors(
        "scipy.stats.spearmanr",
        lambda few: np.asarray(spearmanr(readings[:, :few]).statistic),
        are_equal(1e-5),
        readings.shape[1],
        power=2,
    )
    dataset = f"simulated skin, {len(readings):,} frames"
    yield Comparison("Spearman rho", dataset, partial(spearman, readings), (reference,))


def coincidences(n_sensors: int, n_frames: int, _: Path | None) -> Iterator[Comparison]:
    """Phi coefficient of contact."""
    readings = rubbed_skin(n_sensors, n_frames)[0]
    reference = on_first_sensors(
        "numpy, product of indicators",
        lambda few: phi_by_product(readings[:, :few]),
        are_equal(1e-5),
        readings.shape[1],
        power=2,
        goal=12,
    )
    compute = partial(co_activation, readings)
    yield Comparison("co-activation", "simulated skin", compute, (reference,))


def phi_by_product(readings: Matrix) -> Matrix:
    """Phi coefficient of positive readings from one matrix product and the marginals."""
    on = (readings > 0).astype(np.float32)
    together = (on.T @ on).astype(np.float64)
    share = np.diag(together) / len(on)
    covariance = together / len(on) - np.outer(share, share)
    deviation = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(deviation, deviation))


def information(n_sensors: int, n_frames: int, _: Path | None) -> Iterator[Comparison]:
    """Mutual information of codes, of dense and of sparse readings."""
    readings = rubbed_skin(n_sensors, n_frames)[0]
    dense = np.random.default_rng(1).integers(0, _FEW_BINS, readings.shape, dtype=np.uint16)
    sparse = maximum_entropy_codes(readings, _MANY_BINS)
    inputs = {
        f"dense, {_FEW_BINS} bins": (dense, 6),
        f"9 % active, {_MANY_BINS} bins": (sparse, 12),
    }
    for dataset, (codes, goal) in inputs.items():
        compute = partial(information_from_codes, codes)
        references = (_one_hot(codes, goal), _by_pairs(codes))
        yield Comparison("mutual information", dataset, compute, references)


def _one_hot(codes: Codes, goal: float) -> Reference:
    return on_first_sensors(
        "numpy, one-hot product",
        lambda few: one_hot_information(codes[:, :few]),
        are_equal(1e-4),  # logarithms of large counts in float32
        codes.shape[1],
        power=2,
        goal=goal,
        most=MAX_ONE_HOT // (int(codes.max()) + 1),
    )


def one_hot_information(codes: Codes) -> Matrix:
    """Mutual information from one matrix product of one-hot codes."""
    (n_frames, n_sensors), n_codes = codes.shape, int(codes.max()) + 1
    on = np.empty((n_frames, n_codes, n_sensors), np.float32)
    for code in range(n_codes):
        on[:, code] = codes == code
    flat = on.reshape(n_frames, -1)
    counts = flat.T @ flat
    marginals = np.diag(counts).astype(np.float64)
    joint = xlogy(counts, counts).reshape(n_codes, n_sensors, n_codes, n_sensors).sum(axis=(0, 2))
    own = xlogy(marginals, marginals).reshape(n_codes, n_sensors).sum(axis=0)
    return np.asarray(np.log(n_frames) + (joint - np.add.outer(own, own)) / n_frames)


def _by_pairs(codes: Codes) -> Reference:
    n_sensors = codes.shape[1]
    pairs = np.random.default_rng(2).integers(0, n_sensors, (N_PAIRS, 2))

    def some_pairs() -> Matrix:
        return np.array([mutual_info_score(codes[:, i], codes[:, j]) for i, j in pairs])

    def same(result: Matrix, expected: Matrix) -> bool:
        rounding = 1e-9 if result.dtype == np.float64 else 1e-6
        return bool(np.abs(result[tuple(pairs.T)] - expected).max() <= rounding)

    factor = n_sensors * (n_sensors + 1) / 2 / N_PAIRS
    name, share = "sklearn mutual_info_score", f"{N_PAIRS} pairs"
    return Reference(name, some_pairs, same, 3000, share, factor)


def shortest_paths(n_sensors: int, n_frames: int, torso: Path | None) -> Iterator[Comparison]:
    """Metricising, in skins and in noise."""
    inputs: dict[str, tuple[Callable[[], Matrix], float]] = {
        "simulated skin": (partial(flat_skin, n_sensors), 50),
        "skin with noise": (partial(noisy_skin, n_sensors), 20),
        "metric with noise": (partial(noisy_metric, n_sensors), 15),
        "pure noise": (partial(pure_noise, n_sensors), 15),
    }
    if torso:
        inputs["torso, tiled"] = (
            lambda: regularised_reciprocal(pearson(tiled_torso(torso, n_sensors, n_frames))),
            50,
        )
    for dataset, (make, goal) in inputs.items():
        lengths = make()
        reference = on_first_sensors(
            "scipy floyd_warshall",
            partial(by_floyd_warshall, lengths),
            _checked(are_shortest_paths, lengths),
            n_sensors,
            power=3,
            goal=goal,
        )
        yield Comparison("metricising", dataset, partial(metricise, lengths), (reference,))


def _checked(
    check: Callable[[Matrix, Matrix], bool], data: Matrix
) -> Callable[[Matrix, Matrix], bool]:
    """Return a function that checks a result against what it was computed from."""
    return lambda result, _: check(result, data)


def by_floyd_warshall(lengths: Matrix, few: int) -> Matrix:
    """Shortest paths by scipy."""
    graph = csgraph_from_dense(lengths[:few, :few], null_value=np.inf)
    return np.asarray(floyd_warshall(graph, directed=False))


def are_shortest_paths(paths: Matrix, lengths: Matrix) -> bool:
    """Return whether the paths from some sources agree with Dijkstra's algorithm."""
    n_nodes = len(lengths)
    sources = np.unique(np.linspace(0, n_nodes - 1, _SOURCES).astype(int))
    # Every entry is an edge, zeros included; scipy's own conversion needs much more memory.
    ends = np.tile(np.arange(n_nodes, dtype=np.int32), n_nodes)
    offsets = np.arange(n_nodes + 1, dtype=np.int32) * n_nodes
    graph: Any = csr_array((lengths.ravel(), ends, offsets), shape=lengths.shape)
    close = 1e-12 if paths.dtype == np.float64 else 1e-5
    symmetric = np.array_equal(paths[sources], paths[:, sources].T)
    expected = dijkstra(graph, indices=sources)
    return symmetric and np.allclose(paths[sources], expected, rtol=close, atol=0)


def classical_scaling(n_sensors: int, _: int, __: Path | None) -> Iterator[Comparison]:
    """Torgerson's scaling of the metric of a skin."""
    metric = metricise(flat_skin(n_sensors))
    reference = on_first_sensors(
        "scipy.linalg.eigh",
        lambda few: full_torgerson(metric[:few, :few]),
        _checked(are_eigenvectors, metric),
        n_sensors,
        power=3,
        goal=50,
    )
    compute = partial(torgerson, metric, _DIMENSIONS)
    yield Comparison("Torgerson", "simulated skin", compute, (reference,))


def full_torgerson(metric: Matrix) -> Matrix:
    """Classical scaling by a full eigendecomposition."""
    squares = metric**2
    rows = squares.mean(axis=0)
    values, vectors = eigh(-(squares - rows - rows[:, None] + rows.mean()) / 2)
    kept = slice(-_DIMENSIONS, None)
    return np.asarray(vectors[:, kept] * np.sqrt(np.maximum(values[kept], 0)))


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


def scaling(n_sensors: int, _: int, __: Path | None) -> Iterator[Comparison]:
    """SMACOF until its stress is that at which the reference stops, from the same start.

    A flat skin in space converges slowly, one in the plane and a sphere in few steps.
    """
    if n_sensors > MAX_SCALED_SENSORS:
        return
    flat = metricise(flat_skin(n_sensors))
    upper = np.triu(np.random.default_rng(0).random(flat.shape) >= _SHARE_MISSING, 1)
    inputs: dict[str, tuple[Matrix, int, Matrix | None]] = {
        "flat skin in space": (flat, 3, None),
        "flat skin in the plane": (flat, 2, None),
        "round skin in space": (metricise(round_skin(n_sensors)), 3, None),
        "flat skin in space, 30 % of pairs missing": (flat, 3, (upper + upper.T) * 1.0),
    }
    for dataset, (metric, dimensions, weights) in inputs.items():
        start = torgerson(metric, dimensions)
        ours = partial(smacof, metric, start=start, weights=weights)
        theirs = partial(majorised, metric, start, weights)
        target = _NO_WORSE * raw_stress(theirs(), metric, weights)
        steps = int(np.argmax(ours().trace <= target))
        options = SmacofOptions(0, steps, SmacofOptions.solver)
        name = "sklearn smacof" if weights is None else "numpy, inverse precomputed"
        reference = Reference(name, theirs, _reaches(target))
        yield Comparison("SMACOF", dataset, partial(ours, options=options), (reference,))


def _reaches(target: float) -> Callable[[Scaling, Any], bool]:
    return lambda found, _: found.raw_stress <= target


def majorised(metric: Matrix, start: Matrix, weights: Matrix | None = None) -> Matrix:
    """Return the positions that a reference reaches with its default options."""
    if weights is not None:
        return weighted_majorisation(metric, weights, start)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of parameters that scikit-learn renames
        positions, _ = sklearn_smacof(
            metric, n_components=start.shape[1], init=start, n_init=1, normalized_stress=False
        )
    return np.asarray(positions)


def weighted_majorisation(metric: Matrix, weights: Matrix, start: Matrix) -> Matrix:
    """Scale with weights in numpy; scikit-learn has none.

    Borg & Groenen (2005), equation 8.28, with its inverse precomputed.
    """
    n_points, positions = len(metric), start
    inverse = np.linalg.inv(np.diag(weights.sum(axis=1)) - weights + 1 / n_points) - 1 / n_points
    for _ in range(_STEPS):
        distances = cdist(positions, positions)
        np.fill_diagonal(distances, np.inf)
        pulls = -weights * metric / distances
        np.fill_diagonal(pulls, -pulls.sum(axis=1))
        positions = inverse @ (pulls @ positions)
    return np.asarray(positions)


def raw_stress(positions: Matrix, metric: Matrix, weights: Matrix | None = None) -> float:
    """Compute the sum of weighted squared errors of distances over all pairs."""
    errors = (cdist(positions, positions) - metric) ** 2
    return float((errors if weights is None else weights * errors).sum() / 2)


def whole_maps(n_sensors: int, n_frames: int, _: Path | None) -> Iterator[Comparison]:
    """Map readings, and make the same maps by functions of other libraries."""
    readings = rubbed_skin(n_sensors, n_frames)[0]

    def by_one_hot(readings: Matrix, few: int) -> Matrix:
        return one_hot_information(maximum_entropy_codes(readings[:, :few], DEFAULT_BINS))

    similarities = {
        "r-anisomap": ("corrcoef", by_corrcoef, MAX_REFERENCE_SENSORS, 12),
        "i-anisomap": ("one-hot product", by_one_hot, MAX_ONE_HOT // DEFAULT_BINS, 25),
    }
    for method, (name, compare, most, goal) in similarities.items():

        def by_libraries(
            few: int, compare: Callable[[Matrix, int], Matrix] = compare
        ) -> tuple[Matrix, float]:
            similarity = compare(readings, few)
            lengths = regularised_reciprocal((similarity + similarity.T) / 2)
            metric = by_floyd_warshall(np.asarray(lengths), few)
            return metric, raw_stress(majorised(metric, full_torgerson(metric)), metric)

        def same(_: Any, expected: tuple[Matrix, float], method: str = method) -> bool:
            metric, stress = expected
            made = _map(readings[:, : len(metric)], method)
            return raw_stress(made.positions, metric) <= _NO_WORSE * stress

        reference = on_first_sensors(
            f"{name} + floyd_warshall + eigh + smacof",
            by_libraries,
            same,
            readings.shape[1],
            power=3,
            goal=goal,
            most=most,
        )
        yield Comparison("whole map", method, partial(_map, readings, method), (reference,))


def _map(readings: Matrix, method: str) -> SensorMap:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)
        return reconstruct(readings, method, _DIMENSIONS)


STAGES: Mapping[str, tuple[str, Callable[[int, int, Path | None], Iterator[Comparison]]]] = {
    "pearson": ("Similarity", correlations),
    "spearman": ("Similarity", rank_correlations),
    "co-activation": ("Similarity", coincidences),
    "mutual-information": ("Similarity", information),
    "metricising": ("Shortest paths", shortest_paths),
    "torgerson": ("Scaling", classical_scaling),
    "smacof": ("Scaling", scaling),
    "whole": ("Whole maps", whole_maps),
}
"""Panel of the figure and function of each stage, by its name for ``--stages``.

Functions take numbers of sensors and frames, and a real recording, if there is one, to be tiled.
"""
