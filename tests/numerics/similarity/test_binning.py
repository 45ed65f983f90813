"""Maximum-entropy binning: optimal, in order, and equal values together."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from anisomap.errors import InputError
from anisomap.numerics.similarity.binning import maximum_entropy_bins, maximum_entropy_codes
from anisomap.numerics.similarity.co_occurrence import MIN_COMPILED_SENSORS

counts = st.lists(st.integers(1, 1000), min_size=1, max_size=40)
bins = st.integers(2, 9)


@given(counts, bins)
def test_no_bin_is_empty_and_none_exceeds_the_maximum(counts, bins):
    found = maximum_entropy_bins(counts, bins)
    assert set(found) == set(range(found.max() + 1))
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


@given(counts, bins)
def test_bins_are_intervals_in_order(counts, bins):
    assert set(np.diff(maximum_entropy_bins(counts, bins))) <= {0, 1}


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


@given(
    arrays(np.float64, (50, 2), elements=st.integers(-20, 20).map(float)),
    bins,
)
def test_codes_depend_only_on_order_and_ties(readings, bins):
    stretched = 3 * np.sign(readings) * readings**2 + 7
    np.testing.assert_array_equal(
        maximum_entropy_codes(readings, bins), maximum_entropy_codes(stretched, bins)
    )


@given(
    arrays(np.float64, st.tuples(st.integers(1, 60), st.just(9)), elements=st.integers(-9, 9)),
    st.integers(0, 2**32 - 1),
    bins,
)
@settings(max_examples=8)
def test_the_codes_of_a_sensor_do_not_depend_on_the_number_of_sensors(few, seed, bins):
    """Many sensors are divided by compiled loops, and few by numpy."""
    rng = np.random.default_rng(seed)
    continuous = np.maximum(rng.normal(size=(len(few), MIN_COMPILED_SENSORS)), -0.5)
    both = np.hstack([few, continuous])
    found = maximum_entropy_codes(both, bins)
    chosen = [*range(9), *rng.integers(9, both.shape[1], 9)]
    np.testing.assert_array_equal(found[:, chosen], maximum_entropy_codes(both[:, chosen], bins))


@pytest.mark.parametrize("bins", [1, 0, -3, 1025])
def test_an_invalid_number_of_bins_is_rejected(bins):
    with pytest.raises(InputError, match=str(bins)):
        maximum_entropy_codes(np.eye(3), bins)
