"""Blend of linear and rank correlation."""

import numpy as np

from anisomap.numerics.reliability.split_half import blended_correlation
from anisomap.numerics.similarity.correlation import pearson, spearman
from anisomap.numerics.similarity.rest import estimate_rest
from skins import flat_skin


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
