"""Readings and distinct values per sensor, compared with numpy."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy.stats import rankdata

from anisomap.numerics.columns import (
    columns,
    count_values,
    find_levels,
    join_columns,
    mean_ranks,
    rank_columns,
)

MOSTLY_ZERO = st.one_of(st.just(0.0), st.just(0.0), st.just(-0.0), st.floats(-9, 9))

WHOLE = st.one_of(st.integers(-300, 300), st.integers(2**24 - 9, 2**24)).map(float)


@given(
    st.one_of(
        arrays(np.float64, st.integers(1, 200), elements=MOSTLY_ZERO),
        arrays(np.float32, st.integers(1, 200), elements=WHOLE),
        arrays(np.uint8, st.integers(1, 200)),
        arrays(np.int8, st.integers(1, 200)),
        arrays(np.bool_, st.integers(1, 9)),
    )
)
def test_values_are_counted_as_by_numpy_unique(column):
    found, expected = count_values(column), np.unique(column, return_counts=True)
    np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(found[1], expected[1])
    assert found[0].dtype == column.dtype


@given(
    st.one_of(
        arrays(np.float64, st.integers(1, 200), elements=MOSTLY_ZERO),
        arrays(np.float32, st.integers(1, 200), elements=WHOLE),
        arrays(np.uint8, st.integers(1, 200)),
        arrays(np.bool_, st.integers(1, 9)),
    )
)
def test_levels_are_the_distinct_values_of_all_frames(column):
    levels = find_levels(column)
    values, counts = np.unique(column, return_counts=True)
    np.testing.assert_array_equal(levels.values, values)
    np.testing.assert_array_equal(levels.counts, counts)
    np.testing.assert_array_equal(levels.expand(levels.values), column)


@given(arrays(np.float64, st.integers(1, 200), elements=st.one_of(MOSTLY_ZERO, WHOLE)))
def test_ranks_are_those_of_scipy(column):
    np.testing.assert_array_equal(mean_ranks(column), rankdata(column))
    both = np.stack([column, -column], axis=1)
    np.testing.assert_array_equal(rank_columns(columns(both), both.shape), rankdata(both, axis=0))


@pytest.mark.parametrize("n_at_once", [1, 3, 64])
@given(readings=arrays(np.uint8, array_shapes(min_dims=2, max_dims=2, max_side=9)))
def test_columns_are_contiguous_and_in_order(n_at_once, readings):
    found = list(columns(readings, n_at_once))
    np.testing.assert_array_equal(found, readings.T)
    assert all(column.flags.c_contiguous for column in found)


def test_joined_columns_are_contiguous_by_column():
    readings = np.random.default_rng(0).integers(0, 9, (7, 5))
    joined = join_columns(columns(readings), readings.shape)
    np.testing.assert_array_equal(joined, readings)
    assert joined.flags.f_contiguous
