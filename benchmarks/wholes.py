"""Whole maps beside what one would put together, and beside scikit-learn's MDS and Isomap."""

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
from anisomap.methods import MethodOptions, find_method
from anisomap.numerics.graph.dissimilarity import regularised_reciprocal
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.scaling.classical import torgerson
from anisomap.numerics.scaling.stress_minimisation import smacof
from anisomap.numerics.similarity.binning import maximum_entropy_codes
from anisomap.numerics.similarity.correlation import pearson
from anisomap.stages.pairs import SIMILARITIES
from benchmarks.inputs import stroked_skin
from benchmarks.measuring import Cost, on_one_thread, threads
from benchmarks.paths import are_shortest, cost_of_eigh, cost_of_floyd_warshall
from benchmarks.race import Race, Rival, Setting, of_part
from benchmarks.scalings import NEAR_THE_BEST, of_sklearn
from benchmarks.similarities import correlation, one_hot_information

Matrix = NDArray[np.floating[Any]]

WHOLE = 4000
_DIMENSIONS = 3
_MDS_ITERATIONS = 30
_MDS_FEW = 1000


def whole_races(setting: Setting) -> Iterator[Race]:
    """Make maps from readings, then from dissimilarities, which is where MDS and Isomap begin."""
    readings, truth = stroked_skin(setting.n_sensors, setting.n_frames)
    recording = Recording(readings)
    for method in ("r-anisomap", "i-anisomap"):
        ours = partial(_map, recording, method)
        yield Race("whole map from readings", method, ours, (_put_together(recording, method),))
    if setting.n_sensors <= setting.patience:
        ours = partial(_map, recording, "covariogram")
        yield Race("whole map from readings", "covariogram, the default", ours)
    lengths = regularised_reciprocal(pearson(recording.readings))
    rivals = (
        _put_together_from(lengths),
        _of_sklearn("MDS", _mds, lengths, truth),
        _of_sklearn("Isomap", _isomap, lengths, truth),
    )
    ours = partial(_map_from, lengths)
    yield Race("whole map from dissimilarities", "r-anisomap", ours, rivals)


def _map(recording: Recording, method: str) -> SensorMap:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)
        return reconstruct(recording, method, _DIMENSIONS)


def _map_from(dissimilarity: Matrix) -> SensorMap:
    return reconstruct_from(
        dissimilarity=dissimilarity, method="r-anisomap", dimensions=_DIMENSIONS
    )


def _put_together(recording: Recording, method: str) -> Rival:
    """Add up what a similarity costs others, and all that follows; check the similarity."""
    readings = recording.readings
    statistic = find_method(method).similarity
    similarity = SIMILARITIES[statistic].compute(readings, MethodOptions.bins)
    few = min(len(similarity), 1000 if method == "i-anisomap" else WHOLE)

    def theirs() -> Matrix:
        some = readings[:, :few]
        return correlation(some) if method == "r-anisomap" else _information(some)

    cost, expected = on_one_thread(theirs)
    alike = bool(np.abs(similarity[:few, :few] - expected).max() <= 1e-4)
    rest = _put_together_from(regularised_reciprocal(similarity))
    begin = {"r-anisomap": "corrcoef", "i-anisomap": "one-hot product"}[method]
    return Rival(
        f"{begin} + {rest.name}",
        cost.times((len(similarity) / few) ** 2).and_then(rest.cost),
        lambda made: alike and rest.same(made),
        {"r-anisomap": 12, "i-anisomap": 25}[method],
        rest.how,
        estimated=True,
    )


def _information(readings: Matrix) -> Matrix:
    return one_hot_information(maximum_entropy_codes(readings))


def _put_together_from(lengths: Matrix) -> Rival:
    """Add up what shortest paths, Torgerson and SMACOF cost others, to our stress but for 0.1 %."""
    with threads(1):
        metric = metricise(lengths)
        start = torgerson(metric, _DIMENSIONS)
        target = smacof(metric, start=start).raw_stress * NEAR_THE_BEST
    plain = of_sklearn(metric, start)
    steps = plain.walk(target, plain.most)
    paths, _ = cost_of_floyd_warshall(len(metric))
    cost = paths.and_then(cost_of_eigh(len(metric))[0])
    return Rival(
        "floyd_warshall + eigh + smacof",
        cost.and_then(Cost(steps.taken * plain.each, np.nan)),
        lambda made: are_shortest(metric, lengths) and raw_stress(made, metric) <= target,
        how=f"{steps} smacof steps x {plain.each:.2g} s",
        estimated=True,
    )


def raw_stress(made: SensorMap, metric: Matrix) -> float:
    """Sum the squares by which distances in a map are wrong, plainly."""
    total = 0.0
    for begin in range(0, len(metric), 500):
        rows = slice(begin, begin + 500)
        excess = cdist(made.positions[rows], made.positions) - metric[rows]
        total += float(np.vdot(excess, excess))
    return total / 2


def _of_sklearn(
    name: str, scale: Callable[[Matrix], tuple[str, Matrix]], lengths: Matrix, truth: Matrix
) -> Rival:
    """Give a rival that makes another map: how true both are takes the place of sameness."""
    few = min(len(lengths), WHOLE)
    factor = (len(lengths) / few) ** 2
    cost, (how, positions) = on_one_thread(lambda: scale(lengths[:few, :few]))
    theirs = likeness(positions, truth[:few])
    return Rival(
        f"sklearn {name}",
        cost.times(factor),
        lambda made: f"another map: r {theirs:.2f}, ours {likeness(made.positions, truth):.2f}",
        how="; ".join(filter(None, (how, of_part(f"{few:,} sensors", factor)))),
        estimated=factor != 1,
    )


def likeness(positions: Matrix, truth: Matrix) -> float:
    """Correlate distances with true ones, of the first points if there are very many."""
    few = slice(WHOLE)
    return float(np.corrcoef(pdist(positions[few]), pdist(truth[few]))[0, 1])


def _mds(lengths: Matrix) -> tuple[str, Matrix]:
    # The parameter that says "precomputed" has just changed its name.
    name = "metric" if "metric_mds" in MDS().get_params() else "dissimilarity"
    more = {} if len(lengths) <= _MDS_FEW else {"max_iter": _MDS_ITERATIONS}
    scale = MDS(_DIMENSIONS, n_init=1, random_state=0, **{name: "precomputed"}, **more)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of defaults that will change
        positions = scale.fit_transform(lengths)
    return f"n_init=1, {scale.n_iter_} iterations", positions


def _isomap(lengths: Matrix) -> tuple[str, Matrix]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of pieces that it joins
        positions = Isomap(n_components=_DIMENSIONS, metric="precomputed").fit_transform(lengths)
    return "5 neighbours", positions
