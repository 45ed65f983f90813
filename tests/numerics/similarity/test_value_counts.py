"""Value counts: merging, rounding, and agreement with the readings themselves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from anisomap.numerics.similarity.binning import (
    Recoding,
    ValueCounts,
    maximum_entropy_bins,
    maximum_entropy_codes,
)
from anisomap.numerics.similarity.rest import (
    estimate_rest,
    quantile_from_counts,
    rest_from_counts,
)

shapes = array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=20)
few = st.one_of(
    arrays(np.float64, shapes, elements=st.sampled_from([-2.5, -0.0, 0.0, 1e-300, 1.0, 7.0, 1e9])),
    arrays(np.uint8, shapes),
    arrays(np.int8, shapes),
    arrays(np.bool_, shapes),
)
finite = st.floats(-1e300, 1e300)


def recoded(counted, readings, bins):
    codes = [maximum_entropy_bins(counts, bins) for counts in counted.counts]
    return Recoding.of(counted.values, codes, np.uint16)(readings)


def parts_of(readings, data):
    cuts = sorted(data.draw(st.lists(st.integers(1, len(readings)), max_size=4)))
    parts = [part for part in np.split(readings, cuts) if len(part)]
    return data.draw(st.permutations(parts))


def assert_same(a, b):
    assert a.n_frames == b.n_frames
    np.testing.assert_array_equal(a.n_rounded_bits, b.n_rounded_bits)
    for mine, yours in zip((*a.values, *a.counts), (*b.values, *b.counts), strict=True):
        np.testing.assert_array_equal(mine, yours)


def merged(parts, most=None):
    total, *others = (ValueCounts.of(part, most) for part in parts)
    for other in others:
        total = total.merged(other)
    return total


@given(few, st.data())
@settings(max_examples=40)
def test_values_of_parts_merge_to_those_of_the_whole(readings, data):
    whole = ValueCounts.of(readings)
    assert whole.exact
    assert_same(merged(parts_of(readings, data)), whole)
    for column, values, counts in zip(readings.T, whole.values, whole.counts, strict=True):
        expected = np.unique(column.astype(float), return_counts=True)
        np.testing.assert_array_equal(values, expected[0])
        np.testing.assert_array_equal(counts, expected[1])


@given(arrays(np.float64, shapes, elements=finite), st.integers(2, 12), st.data())
@settings(max_examples=40)
def test_rounding_does_not_depend_on_the_order_of_merging(readings, most, data):
    whole = ValueCounts.of(readings, most)
    assert_same(merged(parts_of(readings, data), most), whole)
    every = zip(readings.T, whole.values, whole.counts, whole.n_rounded_bits, strict=True)
    for column, values, counts, grain in every:
        assert values.size <= most
        assert counts.sum() == len(readings)
        assert (np.diff(values) > 0).all()
        assert values[0] == column.min()
        if grain < 52:
            # Each reading is within the step of rounding.
            lower = values[np.searchsorted(values, column, side="right") - 1]
            step = 2.0 ** (grain - 52)
            assert (column - lower <= 2 * step * abs(column) + 1e-290).all()


@given(few, st.integers(2, 6))
@settings(max_examples=40)
def test_bins_and_rest_of_counts_equal_those_of_readings(readings, bins):
    counted = ValueCounts.of(readings)
    np.testing.assert_array_equal(
        recoded(counted, readings, bins), maximum_entropy_codes(readings, bins)
    )
    np.testing.assert_array_equal(counted.varying(), np.ptp(readings.astype(float), axis=0) > 0)
    found = rest_from_counts(zip(counted.values, counted.counts, strict=True))
    expected = estimate_rest(readings)
    np.testing.assert_array_equal(found.active(readings), expected.active(readings))


@given(
    st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20, unique=True).map(sorted),
    st.data(),
    st.sampled_from([0, 0.25, 0.5, 0.99, 1]),
)
def test_quantiles_of_counts_equal_numpy(values, data, level):
    counts = data.draw(arrays(np.int64, len(values), elements=st.integers(1, 9)))
    expected = np.quantile(np.repeat(values, counts), level)
    found = quantile_from_counts(np.array(values), counts, level)
    assert found == pytest.approx(expected, rel=1e-12)


def test_rounded_continuous_readings_have_nearly_equal_bins():
    readings = np.random.default_rng(0).normal(5, 1, (20_000, 3))
    counted = ValueCounts.of(readings, 1000)
    assert not counted.exact
    shares = [np.bincount(codes) / 20_000 for codes in recoded(counted, readings, 4).T]
    np.testing.assert_allclose(shares, 0.25, atol=0.005)
