"""Split-half reliability of correlations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap.errors import InputError
from anisomap.numerics.reliability.blending import blended_correlation
from anisomap.numerics.reliability.split_half import (
    correlation_and_reliability,
    split_blocks,
    spread_frames,
)
from anisomap.numerics.similarity.correlation import pearson
from skins import flat_skin


@given(st.integers(2, 500))
def test_the_halves_partition_the_frames(n_frames):
    even, odd = split_blocks(n_frames)
    np.testing.assert_array_equal(np.sort(np.concatenate([even, odd])), np.arange(n_frames))
    assert abs(len(even) - len(odd)) <= max(1, n_frames // 20 + 1)


def test_short_recordings_have_no_reliability():
    readings = flat_skin(n_frames=300).readings
    assert correlation_and_reliability(readings[:3]).reliability == 0
    assert correlation_and_reliability(readings[:, :2]).reliability == 0
    assert blended_correlation(readings[:1]).shape == (42, 42)
    with pytest.raises(InputError, match="split-half needs at least 2 frames"):
        split_blocks(1)


def test_a_long_recording_is_reliable_and_noise_is_not():
    noise = np.random.default_rng(0).standard_normal((2000, 30))
    assert abs(correlation_and_reliability(noise).reliability) < 0.2
    assert correlation_and_reliability(flat_skin().readings).reliability > 0.9
    assert correlation_and_reliability(np.tile([[0.0], [1.0]], (50, 4))).reliability == 0


def test_halves_have_the_statistics_of_their_frames():
    readings = np.array(flat_skin(n_frames=350).readings)
    readings[split_blocks(350)[0], 3] = 7.0  # constant in one half only
    found = correlation_and_reliability(readings, halves=True)
    np.testing.assert_allclose(found.correlation, pearson(readings), atol=1e-12)
    for half, frames in zip(found.halves, split_blocks(350), strict=True):
        varying = np.ptp(readings[frames], axis=0) > 0
        alone = correlation_and_reliability(readings[frames][:, varying])
        inside = np.ix_(varying, varying)
        np.testing.assert_allclose(half.correlation[inside], alone.correlation, atol=1e-12)
        assert half.reliability == pytest.approx(alone.reliability, abs=1e-12)


def test_the_reliability_is_that_of_pairs_of_sensors():
    readings = flat_skin(n_frames=300).readings
    halves = [pearson(readings[frames]) for frames in split_blocks(300)]
    pairs = np.triu_indices(readings.shape[1], 1)
    expected = np.corrcoef(halves[0][pairs], halves[1][pairs])[0, 1]
    assert correlation_and_reliability(readings).reliability == pytest.approx(expected, abs=1e-12)


@given(st.integers(1, 5000), st.integers(1, 500))
def test_spread_frames_are_increasing_and_from_all_parts(n_frames, most):
    found = spread_frames(n_frames, most)
    assert (np.diff(found) > 0).all()
    assert found[0] == 0
    assert found[-1] < n_frames
    assert np.diff(found, append=n_frames).max() <= 2 * max(1, n_frames / most) + 1


@pytest.mark.parametrize("period", [2, 3, 4, 5, 8, 60])
@pytest.mark.parametrize("n_frames", [12_000, 20_000, 30_000, 100_000])
def test_spread_frames_have_all_phases_of_a_period(n_frames, period):
    counts = np.bincount(spread_frames(n_frames, 10_000) % period)
    assert counts.min() > 0.6 * counts.max()
