"""Sampling noise, split-half reliability and significance of correlations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap.errors import InputError
from anisomap.numerics.reliability.blending import blended_correlation
from anisomap.numerics.reliability.sampling_noise import sampling_variance, typical_variance
from anisomap.numerics.reliability.significance import significant_components
from anisomap.numerics.reliability.split_half import split_blocks, split_half_reliability
from anisomap.numerics.similarity.correlation import pearson, spearman
from anisomap.numerics.similarity.rest import estimate_rest
from skins import flat_skin


def autoregressive(n_frames: int, n_sensors: int, memory: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((n_frames, n_sensors))
    for t in range(1, n_frames):
        noise[t] += memory * noise[t - 1]
    return noise


@given(st.integers(2, 500))
def test_the_halves_partition_the_frames(n_frames):
    even, odd = split_blocks(n_frames)
    np.testing.assert_array_equal(np.sort(np.concatenate([even, odd])), np.arange(n_frames))
    assert abs(len(even) - len(odd)) <= max(1, n_frames // 20 + 1)


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


def test_one_frame_is_rejected():
    with pytest.raises(InputError, match="at least 2 frames"):
        sampling_variance(np.ones((1, 4)))


def test_short_recordings_have_no_reliability():
    readings = flat_skin(n_frames=300).readings
    assert split_half_reliability(readings[:3]) == 0
    assert split_half_reliability(readings[:, :2]) == 0
    assert blended_correlation(readings[:1]).shape == (42, 42)
    with pytest.raises(InputError, match="split-half needs at least 2 frames"):
        split_blocks(1)


def test_a_long_recording_is_reliable_and_noise_is_not():
    noise = np.random.default_rng(0).standard_normal((2000, 30))
    assert abs(split_half_reliability(noise)) < 0.2
    assert split_half_reliability(flat_skin().readings) > 0.9
    assert split_half_reliability(np.tile([[0.0], [1.0]], (50, 4))) == 0


def test_the_blend_lies_between_linear_and_rank_correlation():
    readings = flat_skin(n_frames=400).readings
    depths = estimate_rest(readings).depth(readings)
    linear, ranks, blend = pearson(readings), spearman(depths), blended_correlation(readings)
    assert (blend <= np.maximum(linear, ranks) + 1e-12).all()
    assert (blend >= np.minimum(linear, ranks) - 1e-12).all()
    assert not np.allclose(blend, linear)
    assert np.array_equal(blend, blend.T)
    moved = blended_correlation(readings * np.linspace(0.1, 9, 42) - 4)
    np.testing.assert_allclose(moved, blend, atol=1e-9)


def test_noise_at_rest_hardly_changes_the_blend():
    readings = np.array(flat_skin().readings)
    noisy = readings + np.random.default_rng(0).normal(0, 0.02 * np.ptp(readings), readings.shape)
    pairs = np.triu_indices(readings.shape[1], 1)
    clean = blended_correlation(readings)[pairs]
    lost = {
        how.__name__: np.abs(how(noisy)[pairs] - how(readings)[pairs]).mean()
        for how in (blended_correlation, spearman)
    }
    assert lost["blended_correlation"] < 0.25 * lost["spearman"]
    assert lost["blended_correlation"] < 0.1 * np.ptp(clean)


def test_skins_touched_independently_are_separate_components():
    parted = []
    for seed in range(8):
        first, second = (flat_skin(seed=s).readings for s in (seed, seed + 10))
        both = np.hstack([first, second[:, :25]])
        order = np.random.default_rng(seed).permutation(both.shape[1])
        alone, together, shuffled = (
            significant_components(blended_correlation(readings), sampling_variance(readings))
            for readings in (first, both, both[:, order])
        )
        assert not alone.any()
        np.testing.assert_array_equal(shuffled, together[order])
        parted.append(np.array_equal(together, np.repeat([0, 1], [42, 25])))
    assert np.mean(parted) > 0.5


def test_noise_has_no_large_components():
    noise = np.random.default_rng(1).standard_normal((2000, 40))
    found = significant_components(blended_correlation(noise), sampling_variance(noise))
    assert np.bincount(found).max() <= 6
