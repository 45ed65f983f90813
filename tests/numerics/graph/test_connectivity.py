"""Neighbour graphs."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import squareform

from anisomap.numerics.graph.neighbour_graphs import (
    components,
    neighbour_graph,
    smallest_connected_neighbour_graph,
)
from anisomap.numerics.neighbours import spanning_tree


@given(st.integers(2, 12), st.integers(0, 10_000))
def test_the_neighbour_graph_is_the_smallest_connected_one(n, seed):
    similarity = squareform(np.random.default_rng(seed).uniform(size=n * (n - 1) // 2))
    joined, k = smallest_connected_neighbour_graph(similarity)
    reached = components(np.where(joined, 1.0, np.inf))
    assert reached.max() == 0
    if k > 1:
        fewer = neighbour_graph(similarity, k - 1)
        assert components(np.where(fewer, 1.0, np.inf)).max() > 0


@given(st.integers(2, 12), st.integers(1, 14), st.integers(1, 3), st.integers(0, 10_000))
def test_of_equally_similar_objects_the_first_are_joined(n, k, n_values, seed):
    similarity = squareform(np.random.default_rng(seed).integers(n_values, size=n * (n - 1) // 2))
    expected = np.zeros((n, n), dtype=bool)
    for i, row in enumerate(similarity):
        others = sorted((j for j in range(n) if j != i), key=lambda j: (-row[j], j))
        expected[i, others[:k]] = True
    np.testing.assert_array_equal(neighbour_graph(similarity, k), expected | expected.T)


@given(st.integers(1, 12), st.integers(1, 40), st.integers(0, 10_000))
def test_the_spanning_tree_is_as_short_as_that_of_scipy(n, n_values, seed):
    lengths = squareform(
        1.0 + np.random.default_rng(seed).integers(n_values, size=n * (n - 1) // 2)
    )
    lengths = lengths if n > 1 else np.zeros((1, 1))
    tree = spanning_tree(lengths)
    np.testing.assert_array_equal(tree, tree.T)
    assert np.count_nonzero(tree) == 2 * (n - 1)
    assert components(np.where(tree, 1.0, np.inf)).max() == 0
    assert lengths[tree].sum() == 2 * minimum_spanning_tree(lengths).sum()
