"""Dissimilarities: the paper's formulas, and the axioms of metrics."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from anisomap.errors import InputError
from anisomap.numerics.graph.dissimilarity import information_distance, regularised_reciprocal
from anisomap.numerics.similarity.information import information_from_codes

R = np.array([[1, 0.5, -0.2], [0.5, 1, 0.1], [-0.2, 0.1, 1]])


@pytest.mark.parametrize("mu", [1.0, 0.1, 0.01])
def test_the_reciprocal_follows_the_paper(mu):
    expected = [[0, 1 / (0.5 + mu * 0.1), 1 / (mu * 0.1)], [0, 0, 1 / (0.1 + mu * 0.1)], [0, 0, 0]]
    found = regularised_reciprocal(R, mu)
    np.testing.assert_allclose(np.triu(found), expected, rtol=1e-15)
    np.testing.assert_array_equal(found, found.T)


def test_without_regularisation_unrelated_pairs_are_infinitely_far_apart():
    found = regularised_reciprocal(R, 0)
    assert np.isinf(found[0, 2])
    assert found[0, 1] == 2


def test_rounding_errors_count_as_zero_similarity():
    similarity = R.copy()
    similarity[0, 2] = similarity[2, 0] = 1e-17
    np.testing.assert_array_equal(regularised_reciprocal(similarity), regularised_reciprocal(R))


def test_without_positive_similarities_all_pairs_are_infinitely_far_apart():
    assert np.isinf(regularised_reciprocal(-np.ones((3, 3)))[0, 1])


@given(arrays(np.uint8, (40, 4), elements=st.integers(0, 3)))
def test_information_distance_is_a_metric(codes):
    distance = information_distance(information_from_codes(codes))
    assert (distance >= 0).all()
    assert not np.diag(distance).any()
    through = (distance[:, :, None] + distance[None, :, :]).min(axis=1)
    assert (distance <= through + 1e-12).all()


def test_information_distance_of_copies_and_independent_series():
    independent = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    distance = information_distance(information_from_codes(independent))
    assert distance[0, 1] == pytest.approx(2 * np.log(2))
    copies = information_distance(information_from_codes(independent[:, [0, 0]]))
    assert copies[0, 1] == 0


@pytest.mark.parametrize("mu", [-1, np.nan, np.inf])
def test_an_invalid_mu_is_rejected(mu):
    with pytest.raises(InputError, match="mu"):
        regularised_reciprocal(R, mu)
