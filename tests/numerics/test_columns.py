"""Readings and ranks of single sensors, compared with numpy and scipy."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.stats import rankdata

from anisomap.numerics.columns import columns, mean_ranks, ranked
from anisomap.numerics.similarity.rest import estimate_rest, ranks_of_depths

MOSTLY_ZERO = st.one_of(st.just(0.0), st.just(0.0), st.just(-0.0), st.floats(-9, 9))

WHOLE = st.one_of(st.integers(-300, 300), st.integers(2**24 - 9, 2**24)).map(float)


@given(arrays(np.float64, st.integers(1, 200), elements=st.one_of(MOSTLY_ZERO, WHOLE)))
def test_ranks_are_those_of_scipy(column):
    np.testing.assert_array_equal(mean_ranks(column), rankdata(column))
    both = np.stack([column, -column], axis=1)
    found = ranked(both)
    np.testing.assert_array_equal(found, rankdata(both, axis=0))
    assert found.flags.f_contiguous


@given(
    arrays(
        np.float32,
        array_shapes(min_dims=2, max_dims=2, max_side=30),
        elements=st.one_of(st.integers(-4, 4), st.floats(-4, 4, width=32), WHOLE),
    ),
    st.sampled_from([1, -1]),
)
def test_ranks_of_depths_are_those_of_scipy(readings, side):
    readings = np.maximum(readings * side, 0) * side
    rest = estimate_rest(readings)
    own = rankdata(rest.side * rest.depth(readings), axis=0)
    np.testing.assert_array_equal(ranks_of_depths(readings, alike=False), own)
    # A rest counts for all sensors or for none.
    rest = replace(rest, known=np.full(rest.known.shape, 2 * rest.known.sum() >= rest.known.size))
    depths = rest.side * rest.depth(readings) if rest.known.all() else readings
    for single in (False, True):
        found = ranks_of_depths(readings, single=single)
        np.testing.assert_array_equal(found, rankdata(depths, axis=0))


@given(arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 130))))
def test_columns_are_contiguous_and_in_order(readings):
    found = list(columns(readings))
    np.testing.assert_array_equal(found, readings.T)
    assert all(column.flags.c_contiguous for column in found)
