"""Products of what does not rest: those of all readings, by fewer steps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from anisomap.numerics.compiled import parallel
from anisomap.numerics.similarity import accumulators, sparse_products
from anisomap.numerics.similarity.accumulators import Moments
from anisomap.numerics.similarity.sparse_products import products_of_few

in_fixtures = settings(deadline=None, suppress_health_check=["function_scoped_fixture"])

# Rest is 5, or whatever a sensor reads mostly.
READINGS = st.one_of(st.just(5.0), st.just(5.0), st.floats(-9, 9, width=32))


@st.composite
def recordings(draw):
    shape = draw(st.integers(1, 30)), draw(st.integers(1, 12))
    return draw(arrays(np.float64, shape, elements=READINGS))


@pytest.fixture
def always(monkeypatch):
    monkeypatch.setattr(sparse_products, "DENSE_PRODUCTS", 0)
    monkeypatch.setattr(sparse_products, "_ROWS", 5)


def skin(n_frames, n_sensors, share, dtype=np.float64):
    rng = np.random.default_rng(0)
    depths = rng.integers(1, 200, (n_frames, n_sensors))
    return np.where(rng.uniform(size=depths.shape) < share, depths, 7).astype(dtype)


@given(recordings())
@in_fixtures
def test_equal_to_products_of_all(always, readings):
    mean, comoment = products_of_few(readings)
    deviations = readings - readings.mean(axis=0)
    np.testing.assert_allclose(mean, readings.mean(axis=0), atol=1e-12)
    np.testing.assert_allclose(comoment, deviations.T @ deviations, atol=1e-10)
    assert (comoment == comoment.T).all()
    constant = np.ptp(readings, axis=0) == 0
    assert not comoment[constant].any()


@pytest.mark.parametrize("dtype", [np.uint8, np.int16, np.float32, np.float64])
def test_any_kind_of_readings(always, dtype):
    readings = skin(300, 23, 0.2, dtype)
    expected = np.corrcoef(readings.astype(float), rowvar=False)
    np.testing.assert_allclose(Moments(300, *products_of_few(readings)).correlation(), expected)


def test_only_where_few_do_not_rest():
    assert products_of_few(skin(400, 60, 0.05)) is not None
    assert products_of_few(skin(400, 60, 0.5)) is None


def test_many_sensors_take_this_way(monkeypatch):
    monkeypatch.setattr(accumulators, "MIN_FLOAT32_SENSORS", 20)
    readings = skin(500, 40, 0.05)
    whole = Moments.of(readings, single=True)
    parts = Moments.of(readings[:123]).merged(Moments.of(readings[123:]))
    # In float32 the two would differ by 1e-7.
    np.testing.assert_allclose(whole.correlation(), parts.correlation(), atol=1e-12)


@pytest.mark.parametrize("n_threads", [2, 3])
def test_threads_change_nothing(always, n_threads, monkeypatch):
    readings = skin(200, 40, 0.1)
    alone = products_of_few(readings)[1]
    monkeypatch.setattr(parallel, "MIN_PARALLEL_ROWS", 1)
    monkeypatch.setattr(parallel, "thread_count", lambda: n_threads)
    assert products_of_few(readings)[1].tobytes() == alone.tobytes()
