"""Blocks of frames, and the resampling of statistics by their weights."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap.numerics.contacts.contact_agreement import (
    contact_agreement,
    resampled_contact_agreement,
)
from anisomap.numerics.reliability.sampling_noise import (
    MAX_BLOCKS,
    MIN_BLOCKS,
    balanced_weights,
    block_edges,
    thinning,
)
from anisomap.numerics.similarity.correlation import pearson, resampled_correlation


def autoregressive(n_frames, n_sensors, coefficient, seed=0):
    """Independent sensors whose frames are an AR(1) process."""
    noise = np.random.default_rng(seed).normal(size=(n_frames, n_sensors))
    for t in range(1, n_frames):
        noise[t] += coefficient * noise[t - 1]
    return noise


@given(st.integers(8, 500), st.integers(1, 5), st.floats(0, 0.99))
def test_blocks_cover_the_recording(n_frames, n_sensors, coefficient):
    edges = block_edges(autoregressive(n_frames, n_sensors, coefficient))
    assert edges[0] == 0
    assert edges[-1] == n_frames
    assert (np.diff(edges) > 0).all()
    assert min(MIN_BLOCKS, n_frames) <= len(edges) - 1 <= MAX_BLOCKS


def test_blocks_are_longer_for_slower_readings():
    lengths = [np.diff(block_edges(autoregressive(3000, 4, c))).mean() for c in (0.8, 0.95, 0.99)]
    assert lengths == sorted(lengths)
    assert lengths[0] < lengths[1] / 2


@given(st.integers(1, 30), st.integers(1, 30), st.integers(0, 9))
def test_every_block_is_drawn_equally_often(n_blocks, n_resamples, seed):
    weights = balanced_weights(n_blocks, n_resamples, np.random.default_rng(seed))
    assert weights.shape == (n_resamples, n_blocks)
    assert (weights.sum(axis=1) == n_blocks).all()
    assert (weights.sum(axis=0) == n_resamples).all()


@given(st.integers(0, 99), st.sampled_from([4, 9]))
def test_weighted_correlations_are_those_of_repeated_blocks(seed, n_blocks):
    rng = np.random.default_rng(seed)
    readings = rng.normal(size=(60, 5)) + 3
    readings[:, 4] = 2.0
    edges = np.sort(rng.choice(np.arange(1, 60), n_blocks - 1, replace=False))
    edges = np.concatenate([[0], edges, [60]])
    weights = rng.integers(0, 3, (3, n_blocks)).astype(float)
    weights[:, 0] += 1
    found = resampled_correlation(readings, edges, weights)
    for correlation, weight in zip(found, weights.astype(int), strict=True):
        frames = np.repeat(np.arange(60), np.repeat(weight, np.diff(edges)))
        if np.ptp(readings[frames, :4], axis=0).min() > 0:
            np.testing.assert_allclose(correlation, pearson(readings[frames]), atol=1e-5)


def test_equal_weights_give_the_agreement_of_contacts():
    readings = np.random.default_rng(0).random((300, 7)) < 0.4
    edges = np.array([0, 50, 110, 300])
    weights = np.array([[1.0, 1, 1], [2, 2, 2], [1, 0, 3]])
    found = resampled_contact_agreement(readings, edges, weights)
    np.testing.assert_allclose(found[0], contact_agreement(readings), atol=1e-12)
    np.testing.assert_allclose(found[0], found[1], atol=1e-12)
    assert np.abs(found[2] - found[0]).max() > 0.01
    np.testing.assert_array_equal(found[2], found[2].T)


@pytest.mark.parametrize("coefficient", [0.0, 0.9])
def test_resamples_spread_as_independent_recordings_do(coefficient):
    """The variance of correlations of AR(1) sensors is (1 + a^2) / (1 - a^2) / T (Bartlett)."""
    n_frames = 2000
    expected = (1 + coefficient**2) / (1 - coefficient**2) / n_frames
    pairs = np.triu_indices(30, 1)
    found = []
    for seed in range(3):
        readings = autoregressive(n_frames, 30, coefficient, seed)
        edges = block_edges(readings)
        drawn = balanced_weights(len(edges) - 1, 12, np.random.default_rng(seed))
        for step in (1.0, 0.5):
            made = resampled_correlation(readings, edges, 1 + step * (drawn - 1))
            found.append(made[:, *pairs].var(axis=0, ddof=1).mean() / step**2)
    assert np.mean(found) == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize("coefficient", [0.98, 0.995])
@pytest.mark.parametrize(("noise", "most"), [(0, 1.05), (0.5, 1.2), (1, 1.2)])
def test_thinned_readings_resample_as_all_of_them(coefficient, noise, most):
    pairs, ratios = np.triu_indices(20, 1), []
    for seed in range(3):
        smooth = autoregressive(6000, 20, coefficient, seed)
        readings = smooth / smooth.std()
        readings += noise * np.random.default_rng(9 + seed).standard_normal(smooth.shape)
        step = thinning(readings)
        assert step > 1
        edges = block_edges(readings)
        drawn = balanced_weights(len(edges) - 1, 12, np.random.default_rng(seed))
        every = resampled_correlation(readings, edges, drawn)
        some = resampled_correlation(readings[::step], -(-edges // step), drawn)
        every, some = (found[:, *pairs].var(axis=0, ddof=1).mean() for found in (every, some))
        ratios.append(some / every)
    assert 0.95 < np.mean(ratios) < most


def test_readings_that_fade_at_once_or_oscillate_are_not_thinned():
    assert thinning(autoregressive(3000, 5, 0.5)) == 1
    smooth = autoregressive(6000, 5, 0.995)
    phases = np.arange(6000)[:, None] / 8.04 + np.arange(5) / 5
    assert thinning(smooth / smooth.std() + 3 * np.sin(2 * np.pi * phases)) <= 2
