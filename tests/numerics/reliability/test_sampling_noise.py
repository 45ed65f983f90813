"""Sampling variance of correlations of autocorrelated series."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d

from anisomap.errors import InputError
from anisomap.evidence import SIMILARITIES
from anisomap.numerics.reliability.sampling_noise import (
    correlation_time,
    sampling_variance,
    typical_variance,
)
from anisomap.numerics.similarity.correlation import pearson


def autoregressive(n_frames: int, n_sensors: int, memory: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((n_frames, n_sensors))
    for t in range(1, n_frames):
        noise[t] += memory * noise[t - 1]
    return noise


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_the_variance_is_that_of_correlations_of_unrelated_series(memory):
    n_frames = 3000
    found = [autoregressive(n_frames, 40, memory, seed) for seed in range(3)]
    observed = np.mean([pearson(x)[np.triu_indices(40, 1)].var() for x in found])
    estimated = np.mean([typical_variance(sampling_variance(x)) for x in found])
    assert estimated == pytest.approx(observed, rel=0.2)
    # Closed form for two autoregressive series of memory a: (1 + a^2) / (1 - a^2) / T.
    assert estimated == pytest.approx((1 + memory**2) / (1 - memory**2) / n_frames, rel=0.2)


def test_the_variance_does_not_depend_on_the_frame_rate():
    x = autoregressive(2000, 12, 0.8, 0)
    slow, fast = (typical_variance(sampling_variance(y)) for y in (x, np.repeat(x, 4, axis=0)))
    assert fast == pytest.approx(slow, rel=0.1)


@given(st.integers(0, 99))
def test_the_variance_is_symmetric_and_at_least_that_of_independent_frames(seed):
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((60, 5)) * rng.integers(0, 2, 5)
    found = sampling_variance(x)
    np.testing.assert_allclose(found, found.T)
    assert (found >= 1 / 60 - 1e-15).all()
    np.testing.assert_allclose(sampling_variance(7 - 3 * x), found, rtol=1e-6)


@pytest.mark.parametrize(
    ("lag", "noise", "hum"),
    [(20, 0.0, 0), (20, 0.5, 0), (60, 0.1, 0), (60, 0.1, 2), (20, 0, 8.04), (60, 0.1, 16.1)],
)
def test_long_recordings_have_the_variance_of_all_their_frames(lag, noise, hum):
    """Bartlett's sum over all lags, of frames of which `sampling_variance` uses some."""
    rng = np.random.default_rng(lag)
    n_frames, n_sensors = 12_000, 12
    smooth = gaussian_filter1d(rng.standard_normal((n_frames, n_sensors)), lag / 3, axis=0)
    x = smooth / smooth.std() + noise * rng.standard_normal(smooth.shape)
    if hum:  # a sine of this period
        x += np.sin(2 * np.pi * (np.arange(n_frames)[:, None] / hum + rng.uniform(size=n_sensors)))
    centred = x - x.mean(axis=0)
    products = np.array(
        [(centred[: n_frames - lag] * centred[lag:]).sum(axis=0) for lag in range(1000)]
    )
    faded = int(np.argmax(np.median(products / products[0], axis=1) < 0.1))
    assert correlation_time(x) == pytest.approx(faded, rel=0.1, abs=1)
    window = max(10, 2 * correlation_time(x))
    products = products[: window + 1]
    taper = np.where(np.arange(window + 1), 2.0, 1.0) * (1 - np.arange(window + 1) / (window + 1))
    weighted = np.sqrt(taper / n_frames)[:, None] * products / products[0]
    expected = typical_variance(weighted.T @ weighted)
    assert typical_variance(sampling_variance(x)) == pytest.approx(expected, rel=0.05)
    assert typical_variance(sampling_variance(x.astype(np.float32))) == pytest.approx(
        expected, rel=0.05
    )


def test_one_frame_is_rejected():
    with pytest.raises(InputError, match="at least 2 frames"):
        sampling_variance(np.ones((1, 4)))


@pytest.mark.parametrize(
    "statistic", ["pearson", "spearman", "co-activation", "blended-correlation"]
)
@pytest.mark.parametrize("response", ["sparse", "heavy tails"])
def test_the_variance_is_that_of_the_statistic_and_not_of_the_readings(statistic, response):
    """Autocorrelation differs between readings, their ranks and contacts."""
    found = [autoregressive(4000, 30, 0.95, seed) / 3.2 for seed in range(4)]
    respond = {"sparse": lambda x: np.maximum(0, x - 1.3), "heavy tails": lambda x: np.exp(2 * x)}
    readings = [respond[response](x) for x in found]
    pairs = np.triu_indices(30, 1)
    computed = [SIMILARITIES[statistic].with_variance(x, 4) for x in readings]
    observed = np.mean([similarity[pairs].var() for similarity, _ in computed])
    estimated = np.mean([typical_variance(variance) for _, variance in computed])
    assert estimated == pytest.approx(observed, rel=0.3)


def test_readings_in_any_memory_order_are_left_alone():
    by_column = np.asfortranarray(np.random.default_rng(0).normal(size=(100, 5)))
    by_column.setflags(write=False)
    expected = sampling_variance(np.ascontiguousarray(by_column))
    np.testing.assert_array_equal(sampling_variance(by_column), expected)
