"""Agreement of profiles: the correlation of each pair of rows."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from anisomap.numerics.reliability.split_half import profile_agreement


@given(st.integers(0, 10_000))
def test_it_is_the_correlation_over_the_other_known_sensors(seed):
    rng = np.random.default_rng(seed)
    n_sensors = 9
    similarities, masks = [], []
    for _ in range(2):
        values, known = rng.normal(size=(n_sensors,) * 2), rng.random((n_sensors,) * 2) < 0.9
        similarities.append(values + values.T)
        masks.append(known | known.T)
    found = profile_agreement(*similarities, *masks)
    for i in range(n_sensors):
        for j in range(n_sensors):
            used = masks[0][i] & masks[1][j]
            used[[i, j]] = False
            r = np.corrcoef(similarities[0][i, used], similarities[1][j, used])[0, 1]
            if used.sum() > 2 and abs(r) < 0.999:
                np.testing.assert_allclose(np.tanh(found[i, j]), r, atol=1e-9)


def test_constant_profiles_agree_with_nothing():
    ones, known = np.ones((5, 5)), np.ones((5, 5), dtype=bool)
    np.testing.assert_array_equal(profile_agreement(ones, ones, known, known), 0)
