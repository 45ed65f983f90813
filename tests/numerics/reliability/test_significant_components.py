"""Components connected by significant links."""

import numpy as np
import pytest

from anisomap.numerics.reliability.sampling_noise import sampling_variance, significant_components
from anisomap.numerics.reliability.split_half import blended_correlation
from skins import flat_skin


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


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_few_long_contacts_connect_a_skin(seed):
    """A correlation of nearly 1 is clear evidence, though few standard deviations from 0."""
    rng = np.random.default_rng(seed)
    places = np.stack(np.meshgrid(range(8), range(8)), -1).reshape(-1, 2)
    presses = rng.uniform(0, 7, (12, 1, 2))
    depth = np.maximum(0, 3 - np.linalg.norm(presses - places, axis=2))
    course = np.sin(np.linspace(0, np.pi, 100))
    readings = np.concatenate([course[:, None] * press for press in depth])
    readings = readings[:, depth.any(axis=0)]
    found = significant_components(blended_correlation(readings), sampling_variance(readings))
    assert not found.any()
