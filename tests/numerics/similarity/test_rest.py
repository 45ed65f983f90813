"""Ranks of depths beyond rest, compared with scipy."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.stats import rankdata

from anisomap.numerics.similarity.rest import estimate_rest, ranks_of_depths


@given(
    arrays(
        np.float32,
        array_shapes(min_dims=2, max_dims=2, max_side=30),
        elements=st.one_of(st.integers(-4, 4), st.floats(-4, 4, width=32)),
    ),
    st.sampled_from([1, -1]),
)
def test_ranks_of_depths_are_those_of_scipy(readings, side):
    readings = np.maximum(readings * side, 0) * side
    depths = estimate_rest(readings).depth(readings)
    expected = rankdata(depths, axis=0)
    np.testing.assert_array_equal(ranks_of_depths(readings), expected)
    np.testing.assert_array_equal(ranks_of_depths(readings, single=True), expected)
