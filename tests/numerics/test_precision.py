"""Results in float32 equal those in float64 up to rounding."""

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from anisomap import Recording, reconstruct, reconstruct_from
from anisomap.errors import InputError
from anisomap.evaluation import mantel
from anisomap.numerics import precision
from anisomap.numerics.graph.dissimilarity import (
    as_symmetric,
    direct_dissimilarity,
    information_distance,
    partial_correlation,
    regularised_reciprocal,
)
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.precision import symmetric_from_upper
from anisomap.numerics.reliability.sampling_noise import group_sensors
from anisomap.numerics.scaling.multidimensional_scaling import smacof, torgerson
from anisomap.numerics.similarity.correlation import co_activation, pearson, spearman
from anisomap.numerics.similarity.information import mutual_information
from skins import flat_skin


@pytest.fixture
def always_float32(monkeypatch):
    monkeypatch.setattr(precision, "MIN_FLOAT32_SENSORS", 1)


@pytest.fixture(scope="module")
def readings():
    return flat_skin(n_frames=700).readings


@pytest.mark.parametrize("size", [1, 2, 40])
def test_the_upper_triangle_is_mirrored_to_the_lower_one(size):
    matrix = np.random.default_rng(size).normal(size=(size, size))
    found = symmetric_from_upper(matrix)
    np.testing.assert_array_equal(found, found.T)
    np.testing.assert_array_equal(np.triu(found), np.triu(matrix))


@pytest.mark.parametrize("similarity", [pearson, spearman, co_activation, mutual_information])
def test_similarities_are_equal(always_float32, similarity, readings, monkeypatch):
    single = similarity(readings)
    monkeypatch.setattr(precision, "MIN_FLOAT32_SENSORS", 10_000)
    assert single.dtype == np.float32
    assert (single == single.T).all()
    np.testing.assert_allclose(single, similarity(readings), atol=1e-6)


@pytest.mark.parametrize(
    "stage",
    [
        regularised_reciprocal,
        partial_correlation,
        information_distance,
        lambda similarity: direct_dissimilarity(similarity, np.full_like(similarity, 1e-3)),
    ],
)
def test_dissimilarities_keep_the_precision(stage, readings):
    similarity = pearson(readings)
    double, single = stage(similarity), stage(similarity.astype(np.float32))
    assert (double.dtype, single.dtype) == (np.float64, np.float32)
    assert (single == single.T).all()
    np.testing.assert_allclose(single, double, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("size", [60, 300])  # dense and iterative eigensolver
def test_scaling_finds_the_same_positions(size):
    points = np.random.default_rng(0).normal(size=(size, 3))
    distances = squareform(pdist(points))
    single = distances.astype(np.float32)
    assert mantel(torgerson(single, 3), points, permutations=0).r > 1 - 1e-9
    assert mantel(smacof(single).positions, points, permutations=0).r > 1 - 1e-12


def test_asymmetry_beyond_rounding_is_rejected():
    matrix = np.random.default_rng(0).uniform(size=(5, 5)).astype(np.float32)
    matrix += matrix.T
    matrix[0, 1] *= 1 + 1e-6
    np.testing.assert_array_equal(found := as_symmetric(matrix, "similarity"), found.T)
    with pytest.raises(ValueError, match="not symmetric"):
        as_symmetric(matrix.astype(np.float64), "similarity")
    matrix[0, 1] *= 1.01
    with pytest.raises(ValueError, match="not symmetric"):
        as_symmetric(matrix, "similarity")


def test_components_equal_those_in_float64(readings):
    apart = np.kron(np.eye(2), pearson(readings)[:20, :20])
    noise = np.full(apart.shape, 0.002)
    expected = group_sensors(apart, noise)
    assert expected.related.max() == 1
    found = group_sensors(apart.astype(np.float32), noise.astype(np.float32))
    np.testing.assert_array_equal(found.related, expected.related)


@pytest.mark.parametrize("method", ["covariogram", "r-anisomap", "i-anisomap", "isomap"])
@pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")
def test_maps_are_equal(always_float32, method, readings, monkeypatch):
    recording = Recording(readings)
    single = reconstruct(recording, method, 2)
    monkeypatch.setattr(precision, "MIN_FLOAT32_SENSORS", 10_000)
    double = reconstruct(recording, method, 2)
    assert mantel(single.positions, double.positions, permutations=0).r > 0.9999


@pytest.mark.parametrize("size", [30, 520])  # numpy and compiled loops
@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_inputs_are_not_modified(size, order, dtype):
    points = np.random.default_rng(0).uniform(size=(size, 2))
    distances = np.array(squareform(pdist(points)), dtype, order=order)
    distances[0, 1] = distances[1, 0] = np.inf
    weights = np.ones_like(distances)
    before = distances.tobytes(), weights.tobytes()
    smacof(distances, dimensions=2, weights=weights)
    torgerson(metricise(distances), 2)
    regularised_reciprocal(distances)
    assert (distances.tobytes(), weights.tobytes()) == before


@pytest.mark.parametrize("what", ["similarity", "dissimilarity", "metric"])
@pytest.mark.parametrize("unit", [1e-30, 1e20, 1e39])
def test_matrices_outside_float32_are_rejected(always_float32, what, unit):
    distances = squareform(pdist(np.random.default_rng(0).uniform(size=(20, 2))))
    with pytest.raises(InputError, match=f"the {what} .* exceeds single precision"):
        reconstruct_from(method="r-anisomap", **{what: unit * distances})
