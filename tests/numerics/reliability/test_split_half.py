"""Split-half reliability of correlations, their blend, and the agreement of profiles."""

import numpy as np
import pytest

from anisomap.numerics.reliability.sampling_noise import blended_correlation
from anisomap.numerics.similarity.correlation import correlation_and_reliability, pearson, spearman
from anisomap.numerics.similarity.rest import estimate_rest
from skins import flat_skin


def test_short_recordings_have_no_reliability():
    readings = flat_skin(n_frames=300).readings
    assert correlation_and_reliability(readings[:3])[1] == 0
    assert correlation_and_reliability(readings[:, :2])[1] == 0
    assert blended_correlation(readings[:1]).shape == (42, 42)


def test_a_long_recording_is_reliable_and_noise_is_not():
    noise = np.random.default_rng(0).standard_normal((2000, 30))
    assert abs(correlation_and_reliability(noise)[1]) < 0.2
    assert correlation_and_reliability(flat_skin().readings)[1] > 0.9
    assert correlation_and_reliability(np.tile([[0.0], [1.0]], (50, 4)))[1] == 0


def test_the_reliability_is_that_of_pairs_of_sensors():
    readings = flat_skin(n_frames=300).readings
    blocks = np.array_split(readings, 20)
    halves = [pearson(np.concatenate(blocks[half::2])) for half in (0, 1)]
    pairs = np.triu_indices(readings.shape[1], 1)
    expected = np.corrcoef(halves[0][pairs], halves[1][pairs])[0, 1]
    assert correlation_and_reliability(readings)[1] == pytest.approx(expected, abs=1e-12)


def test_the_blend_lies_between_linear_and_rank_correlation():
    readings = flat_skin(n_frames=600).readings
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
