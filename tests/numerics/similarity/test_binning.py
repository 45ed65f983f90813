"""Maximum-entropy binning: ties, order and equal shares."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from anisomap.errors import InputError
from anisomap.numerics.similarity.binning import maximum_entropy_bins, maximum_entropy_codes

counts = st.lists(st.integers(1, 1000), min_size=1, max_size=40)
bins = st.integers(2, 9)


@given(counts, bins)
def test_no_bin_is_empty_and_none_exceeds_the_maximum(counts, bins):
    found = maximum_entropy_bins(counts, bins)
    assert set(found) == set(range(found.max() + 1))
    assert found.max() < bins


@given(counts, bins)
def test_few_distinct_values_each_get_a_bin(counts, bins):
    found = maximum_entropy_bins(counts, bins)
    if len(counts) <= bins:
        assert len(set(found)) == len(counts)


@given(counts, bins)
def test_an_atom_has_its_own_bin(counts, bins):
    found = maximum_entropy_bins(counts, bins)
    for value in np.flatnonzero(np.array(counts) * bins > sum(counts)):
        assert np.count_nonzero(found == found[value]) == 1


@given(st.integers(1, 60), bins)
def test_values_without_ties_are_shared_equally(n, bins):
    sizes = np.bincount(maximum_entropy_bins(np.ones(n), bins))
    assert sizes.max() - sizes.min() <= 1


@given(counts, bins)
def test_bins_of_other_values_are_in_order(counts, bins):
    found = maximum_entropy_bins(counts, bins)
    shared = [b for b in found if np.count_nonzero(found == b) > 1]
    assert shared == sorted(shared)


def test_a_frequent_rest_value_leaves_the_other_bins_equal():
    readings = np.concatenate([np.zeros(900), np.arange(1, 100 + 1)])[:, None]
    codes = maximum_entropy_codes(readings, 4)[:, 0]
    assert len(set(codes[:900])) == 1
    assert sorted(np.bincount(codes)) == [33, 33, 34, 900]


def test_rest_may_lie_between_other_values():
    values, counts = [238, 239, 240, 241], [5, 10, 80, 5]
    found = maximum_entropy_bins(counts, 4)
    assert len(set(found)) == len(values)


@given(
    arrays(np.float64, (50, 2), elements=st.integers(-20, 20).map(float)),
    bins,
)
def test_codes_depend_only_on_order_and_ties(readings, bins):
    stretched = 3 * np.sign(readings) * readings**2 + 7
    np.testing.assert_array_equal(
        maximum_entropy_codes(readings, bins), maximum_entropy_codes(stretched, bins)
    )


@pytest.mark.parametrize("bins", [1, 0, -3, 2**16 + 1])
def test_an_invalid_number_of_bins_is_rejected(bins):
    with pytest.raises(InputError, match=str(bins)):
        maximum_entropy_codes(np.eye(3), bins)
