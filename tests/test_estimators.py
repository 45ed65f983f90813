"""The scikit-learn estimators: the contract of scikit-learn, and equality with the functions."""

import warnings

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.distance import pdist, squareform
from sklearn.datasets import make_swiss_roll
from sklearn.decomposition import PCA
from sklearn.manifold import smacof
from sklearn.model_selection import GridSearchCV, KFold
from sklearn.utils.estimator_checks import parametrize_with_checks

from anisomap import Anisomap, SensorMapper, mantel, reconstruct
from anisomap.errors import AnisomapWarning, InputError
from skins import flat_skin, lattice

SKIN = flat_skin()


@pytest.fixture(scope="module")
def mapper():
    return SensorMapper(n_components=2).fit(SKIN.readings)


# The checks use few frames of noise: the doubts that this raises are right, and not the point.
@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@parametrize_with_checks(
    [
        SensorMapper(n_components=2),
        SensorMapper(n_components=2, method="r-anisomap", missing="interpolate"),
        SensorMapper(n_components=2, method="isomap", missing="drop-frames"),
        Anisomap(),
        Anisomap(metric="precomputed"),
    ]
)
def test_scikit_learn_contract(estimator, check):
    check(estimator)


def test_mapper_equals_reconstruct(mapper):
    isomap = SensorMapper(n_components=2, method="isomap").fit(SKIN.readings)
    for fitted, expected in (
        (mapper, reconstruct(SKIN, dimensions=2)),
        (isomap, reconstruct(SKIN, "isomap", 2)),
    ):
        assert fitted.method == expected.method
        np.testing.assert_allclose(fitted.positions_, expected.positions, atol=1e-9)
        assert fitted.map_.stress == pytest.approx(expected.stress)


@pytest.mark.parametrize("method", ["covariogram", "r-anisomap", "i-anisomap"])
def test_partial_fit_equals_fit(method, monkeypatch):
    """And nearly so if there are more frames than are kept."""
    whole = SensorMapper(n_components=2, method=method).fit(SKIN.readings)
    parts, few = (SensorMapper(n_components=2, method=method) for _ in range(2))
    for mapper, most in ((parts, 1500), (few, 400)):
        monkeypatch.setattr("anisomap.numerics.sampling.MAX_FRAMES", most)
        for part in np.split(SKIN.readings, [7, 8, 900]):
            # What a map of the first few frames lacks, the last one must have.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", AnisomapWarning)
                mapper.partial_fit(part)
        assert mapper.n_samples_seen_ == 1500
        assert len(mapper._sample.readings) <= most
    np.testing.assert_allclose(parts.positions_, whole.positions_, atol=1e-9)
    np.testing.assert_allclose(parts.transform(SKIN.readings), whole.transform(SKIN.readings))
    assert parts.map_.health == whole.map_.health
    assert mantel(few.positions_, whole.positions_, permutations=0).r > 0.95


def test_the_centre_of_contact_is_where_the_skin_is_touched(mapper):
    readings = SKIN.readings
    touched = readings.sum(axis=1) > 0
    centres = mapper.transform(readings)
    assert np.isnan(centres[~touched]).all()
    truth = readings[touched] @ lattice() / readings[touched].sum(axis=1, keepdims=True)
    some = np.flatnonzero(touched)[::10]
    assert mantel(centres[some], truth[::10], permutations=0).r > 0.98
    np.testing.assert_allclose(mapper.transform(np.eye(42)), mapper.positions_)


def test_missing_readings_are_left_out_of_the_centre():
    mapper = SensorMapper(2, method="r-anisomap", missing="interpolate").fit(SKIN.readings)
    frame = np.zeros((1, 42))
    frame[0, [3, 4]] = 1
    frame[0, 5] = np.nan
    np.testing.assert_allclose(mapper.transform(frame)[0], mapper.positions_[[3, 4]].mean(axis=0))


def test_missing_readings_are_refused_with_our_option(mapper):
    readings = SKIN.readings.copy()
    readings[3, 2] = np.nan
    for call in (SensorMapper().fit, SensorMapper().partial_fit, mapper.transform):
        with pytest.raises(InputError, match="set missing='interpolate'"):
            call(readings)


def test_the_score_prefers_the_true_map(mapper):
    score = mapper.score(SKIN.readings)
    assert score > 0.8
    np.testing.assert_array_equal(mapper.embedding_, mapper.positions_)
    shuffled = SKIN.readings[:, np.random.default_rng(0).permutation(42)]
    assert abs(mapper.score(shuffled)) < 0.2
    assert np.isnan(mapper.score(np.zeros((5, 42))))


def test_a_grid_search_chooses_by_the_score():
    search = GridSearchCV(
        SensorMapper(method="r-anisomap"), {"n_components": [1, 2]}, cv=KFold(3)
    ).fit(SKIN.readings)
    assert search.best_params_ == {"n_components": 2}
    assert np.isfinite(search.cv_results_["mean_test_score"]).all()


def test_columns_name_the_sensors():
    frame = pd.DataFrame(SKIN.readings, columns=[f"pad {i}" for i in range(42)])
    for fit in (SensorMapper.fit, SensorMapper.partial_fit):
        mapper = fit(SensorMapper(2, method="r-anisomap"), frame)
        assert mapper.map_.names == tuple(frame.columns)


@pytest.mark.parametrize("seed", range(3))
def test_anisomap_does_no_worse_than_mds_on_euclidean_distances(seed):
    points = np.random.default_rng(seed).normal(size=(40, 4))
    ours = Anisomap(2).fit_transform(points)
    truth = pdist(points)
    start = PCA(2).fit_transform(points)
    theirs, _ = smacof(squareform(truth), n_components=2, init=start, n_init=1)
    assert ((pdist(ours) - truth) ** 2).sum() <= ((pdist(theirs) - truth) ** 2).sum() * (1 + 1e-6)


def test_a_semi_metric_is_metricised():
    points = np.linspace(0, 1, 25)[:, None]
    squares = squareform(pdist(points, "sqeuclidean"))
    embedding = Anisomap(1, metric="precomputed").fit_transform(squares)
    assert mantel(embedding, points, permutations=0).r > 0.9999
    same = Anisomap(1, metric="sqeuclidean").fit_transform(points)
    np.testing.assert_allclose(same, embedding, atol=1e-9)


def test_missing_pairs_and_weights():
    points, _ = make_swiss_roll(60, random_state=0)
    points = points[:, [0, 2]]
    distances = squareform(pdist(points))
    holes = distances > 20
    for hole in (np.nan, np.inf):
        found = Anisomap(2, metric="precomputed").fit(np.where(holes, hole, distances))
        assert mantel(found.embedding_, points, permutations=0).r > 0.98
    weights = np.where(holes, 0, 1)
    weighted = Anisomap(2).fit(points, weights=weights)
    assert mantel(weighted.embedding_, points, permutations=0).r > 0.9999


def test_dissimilarities_as_points_raise_a_warning():
    points = np.random.default_rng(0).random((9, 2))
    distances = squareform(pdist(points))
    with pytest.warns(AnisomapWarning, match="set metric='precomputed'"):
        Anisomap().fit(distances)
    Anisomap(metric="precomputed").fit(distances)
    Anisomap().fit(distances[:, :5])


def test_the_best_of_several_starts_is_kept_and_repeats_with_the_seed():
    line = np.arange(12.0)[:, None]
    wrong = 1e-3 * np.random.default_rng(1).permutation(line)
    one, several, again, other = (
        Anisomap(1, method="mds", n_init=n, random_state=seed, max_iter=0).fit(line, init=wrong)
        for n, seed in ((1, 3), (8, 3), (8, 3), (8, 4))
    )
    assert several.stress_ < one.stress_
    np.testing.assert_array_equal(several.embedding_, again.embedding_)
    assert not np.array_equal(several.embedding_, other.embedding_)


def test_the_order_of_dissimilarities_suffices():
    points = np.random.default_rng(2).random((25, 2))
    distorted = squareform(pdist(points)) ** 3
    plain = Anisomap(2, metric="precomputed", method="mds").fit(distorted)
    found = Anisomap(2, metric="precomputed", method="ordinal").fit(distorted)
    assert found.stress_ < 0.01 < plain.stress_
    assert mantel(found.embedding_, points, permutations=0).r > 0.995
    known = np.triu_indices(25, 1)
    order = np.argsort(distorted[known])
    assert (np.diff(found.metric_matrix_[known][order]) >= 0).all()


def test_separate_objects_are_not_bridged():
    distances = np.full((4, 4), np.nan)
    distances[:2, :2] = distances[2:, 2:] = 1
    np.fill_diagonal(distances, 0)
    with pytest.raises(InputError, match="form 2 components"):
        Anisomap(metric="precomputed").fit(distances)
