"""Correlations of resampled blocks do not depend on the unit of the readings."""

import numpy as np
import pytest

from anisomap.numerics.similarity.correlation import resampled_correlation


@pytest.mark.parametrize(
    ("dtype", "unit"),
    [
        (np.float32, 1e-25),
        (np.float32, 1e25),
        (np.float64, 1e-25),
        (np.float64, 1e-200),
        (np.float64, 1e200),
    ],
)
def test_units_do_not_change_resampled_correlations(dtype, unit):
    rng = np.random.default_rng(0)
    readings = rng.normal(size=(200, 3)) @ rng.normal(size=(3, 6))
    edges = np.array([0, 50, 120, 200])
    weights = np.array([[1.0, 1, 1], [2, 0, 1]])
    expected = resampled_correlation(readings, edges, weights)
    found = resampled_correlation((readings * unit).astype(dtype), edges, weights)
    np.testing.assert_allclose(found, expected, atol=1e-5)
