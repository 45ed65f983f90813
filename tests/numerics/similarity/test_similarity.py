"""Similarities compared with scipy and scikit-learn, and their invariances."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats
from sklearn.metrics import mutual_info_score

from anisomap.numerics.similarity.binning import maximum_entropy_codes
from anisomap.numerics.similarity.correlation import (
    CHUNK_FRAMES,
    PairSums,
    co_activation,
    pearson,
    resampled_correlation,
    spearman,
)
from anisomap.numerics.similarity.information import information_from_codes, mutual_information
from anisomap.numerics.similarity.rest import estimate_rest, rest_from_counts

SIMILARITIES = (pearson, spearman, co_activation, mutual_information)


def skin_like(seed, n_frames=400, n_sensors=7):
    """Sparse, heavy-tailed readings of a contact moving at random along a line."""
    rng = np.random.default_rng(seed)
    touch = np.cumsum(rng.normal(0, 0.5, n_frames))[:, None] % n_sensors
    depth = np.maximum(0, 1.5 - abs(touch - np.arange(n_sensors)))
    return np.round(depth**3 * rng.uniform(0.5, 2, n_sensors), 3)


@pytest.fixture(params=range(3))
def readings(request):
    return skin_like(request.param)


def test_pearson_equals_numpy(readings):
    np.testing.assert_allclose(pearson(readings), np.corrcoef(readings.T), atol=1e-12)


def test_spearman_equals_scipy(readings):
    expected = stats.spearmanr(readings).statistic
    np.testing.assert_allclose(spearman(readings), expected, atol=1e-12)


def test_co_activation_is_phi_of_the_two_by_two_table(readings):
    active = readings > 0
    phi = co_activation(readings)
    for i, j in [(0, 1), (2, 5), (3, 4)]:
        table = stats.contingency.crosstab(active[:, i], active[:, j]).count
        strength = stats.contingency.association(table, method="cramer")
        assert abs(phi[i, j]) == pytest.approx(strength, abs=1e-12)


@pytest.mark.parametrize("bins", [2, 4, 6, 8])
def test_mutual_information_equals_scikit_learn(readings, bins):
    codes = maximum_entropy_codes(readings, bins)
    information = mutual_information(readings, bins)
    for i in range(codes.shape[1]):
        for j in range(codes.shape[1]):
            expected = mutual_info_score(codes[:, i], codes[:, j])
            assert information[i, j] == pytest.approx(expected, abs=1e-12)


def test_information_of_known_distributions():
    fair = np.array([[0, 0], [0, 1], [1, 0], [1, 1]] * 5)
    np.testing.assert_allclose(information_from_codes(fair), np.log(2) * np.eye(2), atol=1e-15)
    copied = fair[:, [0, 0]]
    np.testing.assert_allclose(information_from_codes(copied), np.log(2), atol=1e-15)


@pytest.mark.parametrize("similarity", SIMILARITIES)
def test_every_similarity_is_exactly_symmetric(similarity, readings):
    found = similarity(readings)
    np.testing.assert_array_equal(found, found.T)


@pytest.mark.parametrize("similarity", SIMILARITIES)
def test_relabelling_the_sensors_only_relabels_the_similarity(similarity, readings):
    order = np.random.default_rng(5).permutation(readings.shape[1])
    expected = similarity(readings)[np.ix_(order, order)]
    np.testing.assert_allclose(similarity(readings[:, order]), expected, atol=1e-13)


@pytest.mark.parametrize("similarity", SIMILARITIES)
@given(gain=st.sampled_from([0.25, 0.5, 2.0, 64.0]), offset=st.sampled_from([0.0, -8.0, 240.0]))
@settings(max_examples=12)
def test_units_and_offsets_of_a_sensor_do_not_matter(similarity, gain, offset):
    readings = skin_like(9)
    readings[:, 2] = np.round(readings[:, 2] * 8)
    changed = readings.copy()
    changed[:, 2] = gain * readings[:, 2] + offset
    np.testing.assert_allclose(similarity(changed), similarity(readings), atol=1e-12)


def test_activity_does_not_depend_on_the_direction_of_contact(readings):
    fallen = 240 - 16 * np.round(readings * 4)
    risen = np.round(readings * 4)
    np.testing.assert_array_equal(
        estimate_rest(fallen).active(fallen), estimate_rest(risen).active(risen)
    )


def assert_rest_of_counts(readings):
    found = estimate_rest(readings)
    expected = rest_from_counts(np.unique(one, return_counts=True) for one in readings.T)
    for name in ("value", "side", "threshold", "known", "frequent", "distinct"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


@pytest.mark.parametrize("real", [np.uint8, np.int16, np.float32, np.float64])
@given(seed=st.integers(0, 999), n_frames=st.integers(1, 40))
@settings(max_examples=10)
def test_sensors_mostly_at_their_lowest_reading_rest_there(real, seed, n_frames):
    rng = np.random.default_rng(seed)
    levels = rng.integers(0, 100, (n_frames, 12))
    touched = rng.random((n_frames, 12)) < rng.choice([0, 0.1, 0.5, 0.9, 1], 12)
    assert_rest_of_counts(np.where(touched, levels, rng.choice([0, 50, 100], 12)).astype(real))


@pytest.mark.parametrize("real", [np.uint8, np.float32, np.float64])
def test_activity_of_many_sensors_is_depth_beyond_rest(real):
    readings = np.random.default_rng(0).integers(0, 9, (40, 503)).astype(real)
    rest = estimate_rest(readings)
    np.testing.assert_array_equal(rest.active(readings), rest.depth(readings) > 0)


@pytest.mark.parametrize("real", [np.int16, np.uint16, np.int32, np.float32, np.float64])
def test_the_rest_of_many_frames_is_that_of_counts(real):
    rng = np.random.default_rng(0)
    readings = 1000 * rng.normal(size=(10_001, 6))
    readings[:, 1] = np.maximum(readings[:, 1], -500)
    readings[:, 2] = -np.abs(readings[:, 2])
    readings[:, 3] = np.round(readings[:, 3] / 500)
    readings[:, 4] = rng.exponential(size=10_001) ** 3
    readings[:, 5] = 7
    if real == np.uint16:
        readings += 10_000
    assert_rest_of_counts(readings.astype(real))


@pytest.mark.parametrize("compute", [pearson, spearman, co_activation])
def test_no_sensors_have_no_similarities(compute):
    assert compute(np.zeros((5, 0))).shape == (0, 0)


def test_noise_at_rest_is_not_contact():
    rng = np.random.default_rng(0)
    readings = 240 + np.round(rng.normal(0, 0.8, size=(4000, 1))).clip(-2, 2)
    touched = slice(1000, 1300)
    readings[touched] -= 40
    active = estimate_rest(readings).active(readings)[:, 0]
    assert active[touched].all()
    assert active.sum() == 300


@given(arrays(np.float64, (12, 3), elements=st.floats(-1e6, 1e6)), st.integers(1, 11))
def test_sums_of_parts_merge_to_those_of_the_whole(readings, cut):
    whole = PairSums.of(readings)
    merged = PairSums.of(readings[:cut]).merged(PairSums.of(readings[cut:]))
    scale = max(1.0, float(abs(readings).max()))
    assert merged.n_frames == whole.n_frames
    np.testing.assert_allclose(merged.mean, whole.mean, atol=1e-12 * scale)
    np.testing.assert_allclose(merged.products, whole.products, atol=1e-11 * scale**2)


def test_results_do_not_depend_on_chunks():
    rng = np.random.default_rng(1)
    readings = rng.normal(1e4, 1, size=(2 * CHUNK_FRAMES + 17, 3)).astype(np.float32)
    exact = np.corrcoef(readings.astype(np.float64).T)
    np.testing.assert_allclose(pearson(readings), exact, atol=1e-10)
    codes = maximum_entropy_codes(readings, 3)
    expected = mutual_info_score(codes[:, 0], codes[:, 1])
    assert information_from_codes(codes)[0, 1] == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("order", ["C", "F"])
def test_correlations_of_readings_with_a_large_offset_are_accurate(order):
    rng = np.random.default_rng(2)
    readings = rng.normal(3e6, 1, size=(8000, 20))
    # Rare contacts: with frequent ones, the spread of the readings would hide a wrong centre.
    readings += rng.uniform(0, 500, readings.shape) * (rng.random(readings.shape) < 3e-4)
    readings = np.asarray(readings, np.float32, order=order)
    exact = np.corrcoef(readings.T.astype(np.float64))
    np.testing.assert_allclose(pearson(readings), exact, atol=1e-10)


@pytest.mark.parametrize("constant", [0.1, 1e9, -3.0])
def test_a_constant_sensor_is_similar_to_no_other(constant):
    readings = skin_like(3)
    readings[:, 1] = constant
    r = pearson(readings)
    np.testing.assert_array_equal(r[1], np.eye(7)[1])
    assert mutual_information(readings)[1].max() == 0


@pytest.mark.parametrize("unit", [2.0**90, 2.0**-400])
def test_extreme_magnitudes_do_not_matter(unit, readings):
    np.testing.assert_array_equal(pearson(readings * unit), pearson(readings))


@pytest.mark.parametrize(
    ("dtype", "unit"),
    [(np.float32, 1e-25), (np.float32, 1e25), (np.float64, 1e-200), (np.float64, 1e25)],
)
def test_units_do_not_change_resampled_correlations(dtype, unit):
    rng = np.random.default_rng(0)
    readings = rng.normal(size=(200, 3)) @ rng.normal(size=(3, 6))
    edges = np.array([0, 50, 120, 200])
    weights = np.array([[1.0, 1, 1], [2, 0, 1]])
    expected = resampled_correlation(readings, edges, weights)
    found = resampled_correlation((readings * unit).astype(dtype), edges, weights)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_small_maps_do_not_import_numba():
    program = (
        "import sys, numpy as np; from anisomap import Recording, reconstruct;"
        "from anisomap.method.named import METHODS;"
        "touch = np.random.default_rng(0).uniform(size=(300, 1));"
        "skin = Recording(np.maximum(0, 0.2 - abs(touch - np.linspace(0, 1, 16))));"
        "[reconstruct(skin, method, 2) for method in METHODS];"
        "assert 'numba' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
