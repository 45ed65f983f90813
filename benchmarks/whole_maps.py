"""Whole maps, compared with chains of library functions and with scikit-learn's MDS and Isomap."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist, pdist
from sklearn.manifold import MDS, Isomap

from anisomap import AnisomapWarning, Recording, SensorMap, reconstruct, reconstruct_from
from anisomap.defaults import DEFAULT_BINS
from anisomap.numerics.graph.dissimilarity import regularised_reciprocal
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.scaling.multidimensional_scaling import smacof, torgerson
from anisomap.numerics.similarity.binning import maximum_entropy_codes
from anisomap.numerics.similarity.correlation import pearson
from anisomap.numerics.similarity.information import mutual_information
from benchmarks.comparison import Comparison, Reference, Setting, describe_share
from benchmarks.inputs import rubbed_skin
from benchmarks.measuring import Cost, measure_on_one_thread, threads
from benchmarks.paths import are_shortest_paths, cost_of_eigh, cost_of_floyd_warshall
from benchmarks.scalings import STRESS_TOLERANCE, sklearn_majorisation
from benchmarks.similarities import (
    MAX_ONE_HOT,
    are_correlations,
    cost_of_corrcoef,
    one_hot_information,
)

Matrix = NDArray[np.floating[Any]]

MAX_REFERENCE_SENSORS = 4000
_DIMENSIONS = 3
_MDS_ITERATIONS = 30
_MDS_FEW = 1000


def compare_whole(setting: Setting) -> Iterator[Comparison]:
    """Compare maps from readings, and from dissimilarities, the input of MDS and Isomap."""
    readings, truth = rubbed_skin(setting.n_sensors, setting.n_frames)
    recording = Recording(readings)
    similarity = pearson(recording.readings)
    lengths = regularised_reciprocal(similarity)
    rest = _chain_from_dissimilarity(lengths)
    references = {
        "r-anisomap": _after_corrcoef(recording, similarity, rest),
        "i-anisomap": _after_one_hot_product(recording),
    }
    for method, reference in references.items():
        compute = partial(_map, recording, method)
        yield Comparison("whole map from readings", method, compute, (reference,))
    from_lengths = [rest, _of_sklearn("Isomap", _isomap, lengths, truth)]
    if setting.n_sensors <= setting.max_slow_sensors:
        from_lengths.append(_of_sklearn("MDS", _mds, lengths, truth))
    compute = partial(_map_from, lengths)
    yield Comparison("whole map from dissimilarities", "r-anisomap", compute, tuple(from_lengths))


def _map(recording: Recording, method: str) -> SensorMap:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)
        return reconstruct(recording, method, _DIMENSIONS)


def _map_from(dissimilarity: Matrix) -> SensorMap:
    return reconstruct_from(
        dissimilarity=dissimilarity, method="r-anisomap", dimensions=_DIMENSIONS
    )


def _after_corrcoef(recording: Recording, similarity: Matrix, rest: Reference) -> Reference:
    """Add up the cost of Pearson's r and of the following stages; check the former."""
    alike = are_correlations(similarity, recording.readings)
    cost, _ = cost_of_corrcoef(*recording.readings.shape)
    return Reference(
        f"corrcoef + {rest.name}",
        cost.and_then(rest.cost),
        lambda made: alike and rest.same(made),
        12,
        rest.details,
        estimated=True,
    )


def _after_one_hot_product(recording: Recording) -> Reference:
    """Add up the cost of the mutual information and of the following stages; check the former."""
    readings = recording.readings
    information = mutual_information(readings)
    few = min(len(information), MAX_ONE_HOT // DEFAULT_BINS)
    binning, codes = measure_on_one_thread(lambda: maximum_entropy_codes(readings[:, :few]))
    product, expected = measure_on_one_thread(lambda: one_hot_information(codes))
    alike = bool(np.abs(information[:few, :few] - expected).max() <= 1e-4)
    factor = len(information) / few
    cost = binning.times(factor).and_then(product.times(factor**2))
    rest = _chain_from_dissimilarity(regularised_reciprocal(information))
    return Reference(
        f"one-hot product + {rest.name}",
        cost.and_then(rest.cost),
        lambda made: alike and rest.same(made),
        25,
        rest.details,
        estimated=True,
    )


def _chain_from_dissimilarity(lengths: Matrix) -> Reference:
    """Add up the cost of shortest paths, Torgerson and SMACOF to 0.1 % above anisomap's stress."""
    with threads(1):
        metric = metricise(lengths)
        start = torgerson(metric, _DIMENSIONS)
        target = smacof(metric, start=start).raw_stress * STRESS_TOLERANCE
    plain = sklearn_majorisation(metric, start)
    steps = plain.descend(target, plain.max_steps)
    paths, _ = cost_of_floyd_warshall(len(metric))
    cost = paths.and_then(cost_of_eigh(len(metric))[0])
    return Reference(
        "floyd_warshall + eigh + smacof",
        cost.and_then(Cost(steps.taken * plain.each, np.nan)),
        lambda made: are_shortest_paths(metric, lengths) and raw_stress(made, metric) <= target,
        details=f"{steps} smacof steps x {plain.each:.2g} s",
        estimated=True,
    )


def raw_stress(made: SensorMap, metric: Matrix) -> float:
    """Sum of squared errors of distances in a map."""
    total = 0.0
    for begin in range(0, len(metric), 500):
        rows = slice(begin, begin + 500)
        excess = cdist(made.positions[rows], made.positions) - metric[rows]
        total += float(np.vdot(excess, excess))
    return total / 2


def _of_sklearn(
    name: str, scale: Callable[[Matrix], tuple[str, Matrix]], lengths: Matrix, truth: Matrix
) -> Reference:
    """Return a reference whose maps differ: both are compared with the true positions instead."""
    few = min(len(lengths), MAX_REFERENCE_SENSORS)
    factor = (len(lengths) / few) ** 2
    cost, (details, positions) = measure_on_one_thread(lambda: scale(lengths[:few, :few]))
    reference_r = mantel_r(positions, truth[:few])
    return Reference(
        f"sklearn {name}",
        cost.times(factor),
        lambda made: (
            f"another map: r {reference_r:.2f}, anisomap {mantel_r(made.positions, truth):.2f}"
        ),
        details="; ".join(filter(None, (details, describe_share(f"{few:,} sensors", factor)))),
        estimated=factor != 1,
    )


def mantel_r(positions: Matrix, truth: Matrix) -> float:
    """Mantel r with the true positions, for the first points of large maps."""
    few = slice(MAX_REFERENCE_SENSORS)
    return float(np.corrcoef(pdist(positions[few]), pdist(truth[few]))[0, 1])


def _mds(lengths: Matrix) -> tuple[str, Matrix]:
    # scikit-learn renamed the parameter for precomputed dissimilarities.
    name = "metric" if "metric_mds" in MDS().get_params() else "dissimilarity"
    more = {} if len(lengths) <= _MDS_FEW else {"max_iter": _MDS_ITERATIONS}
    scale = MDS(_DIMENSIONS, n_init=1, random_state=0, **{name: "precomputed"}, **more)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of defaults that change
        positions = scale.fit_transform(lengths)
    return f"n_init=1, {scale.n_iter_} iterations", positions


def _isomap(lengths: Matrix) -> tuple[str, Matrix]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of components that it joins
        positions = Isomap(n_components=_DIMENSIONS, metric="precomputed").fit_transform(lengths)
    return "5 neighbours", positions
