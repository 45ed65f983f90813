"""Co-moments of sparse readings, compared with dense products."""

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from anisomap.numerics.compiled.parallel import MIN_COMPILED_ROWS, MIN_PARALLEL_ROWS
from anisomap.numerics.similarity.correlation import Moments, is_sparse, sparse_comoments

MOSTLY_FIVE = st.one_of(st.just(5.0), st.just(5.0), st.floats(-9, 9, width=32))


@st.composite
def recordings(draw):
    shape = draw(st.integers(1, 30)), draw(st.integers(1, 12))
    return draw(arrays(np.float64, shape, elements=MOSTLY_FIVE))


def sparse_readings(n_frames, n_sensors, share, dtype=np.float64):
    rng = np.random.default_rng(0)
    depths = rng.integers(1, 200, (n_frames, n_sensors))
    return np.where(rng.uniform(size=depths.shape) < share, depths, 7).astype(dtype)


@given(recordings())
def test_comoments_equal_dense_products(readings):
    mean, comoment = sparse_comoments(readings)
    by_sensor = sparse_comoments(np.asfortranarray(readings))
    np.testing.assert_array_equal(by_sensor[0], mean)
    np.testing.assert_array_equal(by_sensor[1], comoment)
    deviations = readings - readings.mean(axis=0)
    np.testing.assert_allclose(mean, readings.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(comoment, deviations.T @ deviations, atol=1e-10)
    assert (comoment == comoment.T).all()
    constant = np.ptp(readings, axis=0) == 0
    assert not comoment[constant].any()


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32, np.float64])
@pytest.mark.parametrize("n_sensors", [23, 230])
def test_readings_of_any_type(dtype, n_sensors):
    readings = sparse_readings(300, n_sensors, 0.2, dtype)
    expected = np.corrcoef(readings.astype(float), rowvar=False)
    found = Moments(300, *sparse_comoments(readings)).correlation()
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_sparse_products_are_chosen_only_for_sparse_readings():
    assert is_sparse(sparse_readings(400, 60, 0.05))
    assert not is_sparse(sparse_readings(400, 60, 0.5))


def test_moments_of_many_sparse_sensors_are_accurate_to_float64():
    readings = sparse_readings(500, MIN_COMPILED_ROWS, 0.05)
    found = Moments.of(readings, single=True).correlation()
    # Products in float32 would differ by 1e-7.
    np.testing.assert_allclose(found, np.corrcoef(readings.T), atol=1e-12)


def test_results_do_not_depend_on_the_number_of_threads(monkeypatch):
    readings = sparse_readings(50, MIN_PARALLEL_ROWS, 0.02)
    results = []
    for n_threads in (1, 3):
        monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", n_threads)
        results.append(sparse_comoments(readings)[1].tobytes())
    assert results[0] == results[1]
