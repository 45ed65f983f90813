"""Maximum-entropy binning: optimal, in order, equal values together, and mergeable."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from anisomap.errors import InputError
from anisomap.numerics.similarity.binning import (
    Recoding,
    ValueCounts,
    maximum_entropy_bins,
    maximum_entropy_codes,
)
from anisomap.numerics.similarity.rest import estimate_rest, quantile_from_counts, rest_from_counts

counts = st.lists(st.integers(1, 1000), min_size=1, max_size=40)
bins = st.integers(2, 9)


@given(counts, bins)
def test_bins_are_intervals_in_order_and_at_most_as_many_as_asked_for(counts, bins):
    found = maximum_entropy_bins(counts, bins)
    assert found[0] == 0
    assert set(np.diff(found)) <= {0, 1}
    assert found.max() < bins


def entropy(sizes):
    shares = np.asarray(sizes) / np.sum(sizes)
    return -float(np.sum(shares * np.log(shares)))


def best_entropy(counts, bins):
    """Return the greatest entropy of all divisions into intervals, by trying each."""
    ends = np.cumsum([0, *counts])
    return max(
        entropy(np.diff(ends[[0, *inner, len(counts)]]))
        for inner in combinations(range(1, len(counts)), min(bins, len(counts)) - 1)
    )


few_counts = st.lists(st.one_of(st.integers(1, 3), st.integers(1, 1000)), min_size=1, max_size=9)


@given(few_counts, st.integers(2, 5))
def test_no_division_into_intervals_has_a_greater_entropy(counts, bins):
    sizes = np.bincount(maximum_entropy_bins(counts, bins), counts)
    assert entropy(sizes) == pytest.approx(best_entropy(counts, bins), abs=1e-12)


@pytest.mark.parametrize("size", [300, 1200])
def test_long_lists_of_values_are_divided_as_well_as_by_the_full_programme(size):
    """A dynamic programme over all cuts, without the shortcut that the cost allows."""
    counts = np.random.default_rng(size).zipf(1.5, size).clip(max=4000)
    ends = np.concatenate([[0], np.cumsum(counts)])
    sizes = np.subtract.outer(ends, ends)  # [j, i]: from i to j
    cost = np.where(sizes > 0, sizes * np.log(np.maximum(sizes, 1)), np.inf)
    least = cost[:, 0]
    for _ in range(3):
        least = (least + cost).min(axis=1)
    found = np.bincount(maximum_entropy_bins(counts, 4), counts)
    assert np.sum(found * np.log(found)) == pytest.approx(least[-1], rel=1e-12)


@given(st.integers(1, 60), bins)
def test_values_without_ties_are_shared_equally(n, bins):
    sizes = np.bincount(maximum_entropy_bins(np.ones(n), bins))
    assert sizes.max() - sizes.min() <= 1


def test_a_frequent_rest_value_leaves_the_other_bins_equal():
    readings = np.concatenate([np.zeros(900), np.arange(1, 100 + 1)])[:, None]
    codes = maximum_entropy_codes(readings, 4)[:, 0]
    assert len(set(codes[:900])) == 1
    assert sorted(np.bincount(codes)) == [33, 33, 34, 900]


@given(arrays(np.float64, (50, 2), elements=st.integers(-20, 20).map(float)), bins)
def test_codes_depend_only_on_order_and_ties(readings, bins):
    stretched = 3 * np.sign(readings) * readings**2 + 7
    np.testing.assert_array_equal(
        maximum_entropy_codes(readings, bins), maximum_entropy_codes(stretched, bins)
    )


@pytest.mark.parametrize("bins", [1, 0, -3, 1025])
def test_an_invalid_number_of_bins_is_rejected(bins):
    with pytest.raises(InputError, match=str(bins)):
        maximum_entropy_codes(np.eye(3), bins)


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
