"""The pose of a patch from places where it was touched."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import special_ortho_group

from anisomap.errors import InputError
from anisomap.numerics.procrustes import fit_patch_pose


def touched(seed, count=30):
    """Places on a patch, the same points in the frame of its link, and the rotation."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, 1, (count, 3)) * [3, 2, 0.5]
    turn = special_ortho_group.rvs(3, random_state=rng)
    return places, places @ turn.T + rng.normal(size=3), turn


@given(st.integers(0, 10_000))
@settings(max_examples=10)
def test_the_pose_of_an_exact_patch_with_wrong_contacts(seed):
    places, targets, turn = touched(seed)
    wrong = np.arange(0, 30, 5)
    moved = targets.copy()
    moved[wrong] += np.random.default_rng(seed).normal(0, 5, (len(wrong), 3))
    found = fit_patch_pose(places, moved)
    np.testing.assert_allclose(found.similarity.apply(places), targets, atol=1e-6)
    np.testing.assert_allclose(found.similarity.rotation, turn, atol=1e-6)
    assert np.flatnonzero(~found.used).tolist() == wrong.tolist()


def test_errors_are_as_large_as_stated():
    """Squared errors of a point over their variance have the mean 1 per coordinate."""
    point = np.array([[3.0, 2.0, 0.5]])
    ratios = []
    for seed in range(80):
        places, targets, turn = touched(seed)
        truth = targets[0] + (point - places[0]) @ turn.T
        noisy = targets + np.random.default_rng(seed).normal(0, 0.05, targets.shape)
        found = fit_patch_pose(places, noisy)
        placed = found.similarity.apply(point)
        covariance = found.position_covariances(placed)[0]
        off = (placed - truth)[0]
        ratios.append(off @ np.linalg.solve(covariance, off) / 3)
    assert np.mean(ratios) == pytest.approx(1, abs=4 * np.std(ratios) / len(ratios) ** 0.5)


def test_too_few_contacts_or_on_a_line():
    places, targets, _ = touched(1)
    with pytest.raises(InputError, match="at least 6 contacts"):
        fit_patch_pose(places[:5], targets[:5])
    line = places * [1, 0, 0]
    with pytest.raises(InputError, match="lie on a line"):
        fit_patch_pose(line, line)
