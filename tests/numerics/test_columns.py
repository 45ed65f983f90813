"""Readings sensor by sensor, and their distinct values: as plain numpy gives them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from anisomap.numerics import columns as room
from anisomap.numerics.columns import columns, count_values

VALUES = st.one_of(st.just(0.0), st.just(0.0), st.just(-0.0), st.floats(-9, 9))


@given(arrays(np.float64, st.integers(1, 200), elements=VALUES))
def test_values_are_counted_as_numpy_counts_them(column):
    for found, expected in zip(
        count_values(column), np.unique(column, return_counts=True), strict=True
    ):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("together", [1, 3, 64])
@given(arrays(np.uint8, array_shapes(min_dims=2, max_dims=2, max_side=9)))
def test_columns_come_in_their_order(together, readings):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(room, "TOGETHER", together)
        found = list(columns(readings))
    np.testing.assert_array_equal(found, readings.T)
    assert all(column.flags.c_contiguous for column in found)
