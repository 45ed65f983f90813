"""Neighbour graphs, and distances along paths of neighbours."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import cdist, squareform
from sklearn.manifold import Isomap

from anisomap.numerics.covariogram.covariogram_fit import unexplained_share
from anisomap.numerics.graph.neighbour_graphs import (
    local_path_lengths,
    neighbour_graph,
    smallest_connected_neighbour_graph,
)
from anisomap.numerics.neighbours import components, spanning_tree


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


def scattered(seed, n_sensors=80):
    return np.random.default_rng(seed).uniform(0, 5, (n_sensors, 2))


@pytest.mark.parametrize("seed", range(3))
def test_paths_equal_those_of_isomap_on_a_gaussian_covariogram(seed):
    places = scattered(seed)
    distances = cdist(places, places)
    paths = local_path_lengths(np.exp(-((distances / 2) ** 2)), 10)
    oracle = Isomap(n_neighbors=10, metric="precomputed").fit(distances / 2).dist_matrix_
    assert paths == pytest.approx(oracle, abs=1e-5)  # in float32


def test_paths_cross_gaps_and_are_symmetric():
    places = scattered(4)
    places[40:] += 100
    similarity = np.exp(-(cdist(places, places) ** 2))
    similarity[:40, 40:] = similarity[40:, :40] = 0
    paths = local_path_lengths(similarity)
    assert np.isfinite(paths).all()
    assert np.array_equal(paths, paths.T)
    assert paths[:40, 40:].min() > np.median(paths[:40, :40])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("noise", [0.02, 0.05])
def test_noise_alone_leaves_nothing_unexplained(seed, noise):
    generator, places = np.random.default_rng(seed), scattered(seed, 120)
    expected = 0.9 * np.exp(-cdist(places, places))
    error = noise * (1 - expected**2) * generator.normal(size=expected.shape)
    similarity = expected + (np.triu(error, 1) + np.triu(error, 1).T)
    assert abs(unexplained_share(similarity, places, noise**2)) < 0.015


@pytest.mark.parametrize("seed", range(5))
def test_contacts_of_two_widths_stay_unexplained(seed):
    places = scattered(seed, 120)
    width = np.where(places[:, 0] < 2.5, 0.5, 1.5)
    similarity = np.exp(-cdist(places, places) / np.sqrt(np.outer(width, width)))
    assert unexplained_share(similarity, places, 1e-4) > 0.1


@pytest.mark.parametrize("unit", [2.0**-200, 2.0**200])
def test_what_is_left_unexplained_does_not_depend_on_the_unit(unit):
    places = scattered(0, 120)
    width = np.where(places[:, 0] < 2.5, 0.5, 1.5)
    similarity = np.exp(-cdist(places, places) / np.sqrt(np.outer(width, width)))
    found = [unexplained_share(similarity, one, 1e-4) for one in (places, unit * places)]
    assert found[0] == found[1]


def test_few_pairs_determine_no_share():
    assert unexplained_share(np.eye(5), np.arange(10.0).reshape(5, 2), 0.01) == 0
