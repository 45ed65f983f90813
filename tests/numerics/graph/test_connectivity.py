"""Neighbour graphs."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.distance import squareform

from anisomap.numerics.graph.connectivity import (
    components,
    neighbour_graph,
    smallest_connected_neighbour_graph,
)


@given(st.integers(2, 12), st.integers(0, 10_000))
def test_the_neighbour_graph_is_the_smallest_connected_one(n, seed):
    similarity = squareform(np.random.default_rng(seed).uniform(size=n * (n - 1) // 2))
    joined, k = smallest_connected_neighbour_graph(similarity)
    reached = components(np.where(joined, 1.0, np.inf))
    assert reached.max() == 0
    if k > 1:
        fewer = neighbour_graph(similarity, k - 1)
        assert components(np.where(fewer, 1.0, np.inf)).max() > 0


def test_every_object_is_joined_to_its_most_similar_ones():
    similarity = squareform(np.random.default_rng(0).uniform(size=45))
    joined = neighbour_graph(similarity, 3)
    np.testing.assert_array_equal(joined, joined.T)
    assert not np.diag(joined).any()
    for i in range(10):
        nearest = np.argsort(np.where(np.arange(10) == i, np.inf, -similarity[i]))[:3]
        assert joined[i, nearest].all()
