"""Joint counts of codes: every way of counting agrees with contingency tables."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.special import xlogy
from sklearn.metrics import mutual_info_score

from anisomap.numerics.similarity.binning import maximum_entropy_codes
from anisomap.numerics.similarity.co_occurrence import (
    MIN_COMPILED_SENSORS,
    Layout,
    co_occurrences,
    code_counts,
    joint_logarithms,
    joint_logarithms_of_counts,
)
from anisomap.numerics.similarity.correlation import (
    MIN_FAST_PRODUCT_SENSORS,
    SINGLE_FRAMES,
    Moments,
    co_activation,
    pearson,
)
from anisomap.numerics.similarity.information import information_from_codes
from anisomap.numerics.similarity.rest import estimate_rest

WAYS = ("products", "bits", "entries")

tables = arrays(
    np.uint8,
    array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=140),
    elements=st.integers(0, 5),
    fill=st.just(np.uint8(0)),
)


def skin_codes(seed, n_frames=700, n_sensors=MIN_COMPILED_SENSORS + 20, bins=5):
    """Codes of a contact moving at random along a line of sensors; code 2 is rest."""
    rng = np.random.default_rng(seed)
    touch = np.cumsum(rng.normal(0, 3, n_frames))[:, None] % n_sensors
    depth = np.maximum(0, 20 - abs(touch - np.arange(n_sensors))) * rng.uniform(0.5, 2, n_sensors)
    depth[:, 7] = 0
    return (maximum_entropy_codes(depth, bins) + 2) % bins


@pytest.mark.parametrize("counting", WAYS)
@given(codes=tables)
@settings(max_examples=15)
def test_counts_are_those_of_all_pairs_of_series(counting, codes):
    layout = Layout.of(code_counts(codes, 6))
    series = [
        codes[:, sensor] == code
        for sensor in range(codes.shape[1])
        for code in np.unique(codes[:, sensor])
        if code != layout.reference[sensor]
    ]
    on = np.reshape(series, (len(series), len(codes))).astype(int)
    np.testing.assert_array_equal(co_occurrences(codes, layout, counting), on @ on.T)


@given(codes=tables)
@settings(max_examples=15)
def test_counts_of_switches_are_those_of_a_product(codes):
    on = codes > 0
    layout = Layout.of_switches(on.shape[1])
    expected = on.T.astype(int) @ on.astype(int)
    for counting in WAYS:
        np.testing.assert_array_equal(co_occurrences(on, layout, counting), expected)


def logarithms_of_contingency_tables(codes):
    """Sum n log n over the contingency table of every pair of sensors."""
    n_codes = codes.max() + 1
    on = (codes[:, :, None] == np.arange(n_codes)).reshape(len(codes), -1).astype(float)
    cells = xlogy(counts := on.T @ on, counts)
    shape = (codes.shape[1], n_codes, codes.shape[1], n_codes)
    return cells.reshape(shape).sum(axis=(1, 3))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("counting", WAYS)
def test_logarithms_of_joint_counts_are_those_of_the_contingency_tables(counting, seed):
    codes = skin_codes(seed, n_frames=300)
    expected = logarithms_of_contingency_tables(codes)
    layout = Layout.of(code_counts(codes, 6))
    counts = co_occurrences(codes, layout, counting)
    results = [joint_logarithms_of_counts(counts, layout.first, len(codes))]
    if counting != "products":
        results.append(joint_logarithms(codes, 5, counting))
    for found in results:
        np.testing.assert_allclose(found, expected, rtol=1e-12)
        np.testing.assert_array_equal(found, found.T)


@pytest.mark.parametrize("bins", [2, 4, 8])
def test_information_of_many_sensors_equals_scikit_learn(bins):
    codes = skin_codes(3, bins=bins)
    information = information_from_codes(codes)
    rng = np.random.default_rng(bins)
    for i, j in [*rng.integers(0, codes.shape[1], (20, 2)), (40, 41), (40, 40), (7, 30)]:
        expected = mutual_info_score(codes[:, i], codes[:, j])
        assert information[i, j] == pytest.approx(expected, abs=1e-12)


def test_co_activation_of_many_sensors_is_the_correlation_of_activity():
    readings = (skin_codes(4) != 2).astype(float)
    readings[:, 30:60] = 1 - readings[:, 30:60]
    active = estimate_rest(readings).active(readings)
    np.testing.assert_allclose(
        co_activation(readings), Moments.of(active).correlation(), atol=1e-12
    )


@pytest.mark.parametrize("offset", [0, 1e4, -1e7])
@pytest.mark.parametrize("unit", [1, 1e-30])
def test_correlations_of_many_sensors_are_accurate_to_float32(offset, unit):
    """Sums of n products in float32 are off by n 2^-24 at most, in any order (Higham 2002)."""
    rng = np.random.default_rng(5)
    n_sensors = MIN_FAST_PRODUCT_SENSORS + 8
    common = rng.standard_t(2, (3000, 40))[:, rng.integers(0, 40, n_sensors)]
    readings = (np.maximum(0, common + rng.normal(0, 0.3, common.shape)) ** 3 + offset) * unit
    readings[:, 11] = 0.1
    readings[:, 13] = readings[:, 12]
    living = np.arange(n_sensors) != 11
    exact = np.corrcoef((readings[:, living] - readings[:, living].mean(axis=0)).T / unit)
    r = pearson(readings)
    assert abs(r[np.ix_(living, living)] - exact).max() < SINGLE_FRAMES * 2.0**-24
    np.testing.assert_array_equal(r, r.T)
    np.testing.assert_array_equal(np.diag(r), 1)
    np.testing.assert_array_equal(r[11], np.eye(n_sensors)[11])
    assert r[12, 13] == pytest.approx(1, abs=1e-6)


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
