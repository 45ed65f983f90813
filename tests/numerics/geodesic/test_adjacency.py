"""Neighbour graphs: invariances, known lattices, agreement of halves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from anisomap.errors import InputError
from anisomap.numerics.geodesic.adjacency import (
    adjacency_graph,
    edge_distances,
    split_half_agreement,
    unevenness,
)
from anisomap.numerics.graph.dissimilarity import partial_correlation
from anisomap.numerics.reliability.split_half import blended_correlation
from skins import flat_skin, lattice, rubbed


def smooth_noise(n_frames: int, n_sensors: int, seed: int) -> np.ndarray:
    """Readings without spatial structure, which must still give a connected graph."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n_frames, 3)) @ rng.standard_normal(
        (3, n_sensors)
    ) + rng.standard_normal((n_frames, n_sensors))


@given(st.integers(3, 200), st.integers(2, 12), st.integers(0, 99))
def test_the_graph_is_symmetric_connected_and_without_loops(n_frames, n_sensors, seed):
    readings = smooth_noise(n_frames, n_sensors, seed)
    joined = adjacency_graph(readings, np.random.default_rng(seed).normal(size=(n_sensors, 2)))
    assert np.array_equal(joined, joined.T)
    assert not np.diag(joined).any()
    assert connected_components(joined, directed=False)[0] == 1


@given(st.integers(0, 99))
def test_the_graph_is_equivariant_to_labels(seed):
    readings, rng = smooth_noise(120, 10, seed), np.random.default_rng(seed)
    positions, order = rng.normal(size=(10, 3)), rng.permutation(10)
    joined = adjacency_graph(readings, positions)
    np.testing.assert_array_equal(
        adjacency_graph(readings[:, order], positions[order]), joined[np.ix_(order, order)]
    )


@given(st.integers(0, 99))
def test_the_graph_does_not_depend_on_gain_and_offset(seed):
    readings, rng = smooth_noise(120, 8, seed), np.random.default_rng(seed)
    other = readings * rng.uniform(0.1, 10, 8) + rng.normal(size=8)
    np.testing.assert_array_equal(adjacency_graph(other), adjacency_graph(readings))


def test_a_rubbed_lattice_is_recovered():
    positions = lattice()
    readings = rubbed(positions, 3000)
    near = cdist(positions, positions) < 1.01
    np.fill_diagonal(near, val=False)
    joined = adjacency_graph(readings, positions)
    assert (joined & near).sum() > 0.98 * joined.sum(), "hardly a shortcut"
    assert unevenness(positions, joined) < 0.1
    assert split_half_agreement(readings, positions) > 0.95


@pytest.mark.parametrize("sign", [1, -1])
def test_two_sensors_are_linked_even_if_they_are_opposites(sign):
    first = np.random.default_rng(0).standard_normal((300, 1))
    links = adjacency_graph(np.hstack([first, sign * first + 0.1 * first[::-1]]))
    assert links.tolist() == [[False, True], [True, False]]


def test_a_given_similarity_replaces_that_of_the_readings():
    readings = flat_skin().readings
    np.testing.assert_array_equal(
        adjacency_graph(readings, similarity=blended_correlation(readings)),
        adjacency_graph(readings),
    )


def test_only_edges_of_the_tree_have_much_stronger_detours():
    readings = smooth_noise(400, 14, 3)
    joined = adjacency_graph(readings)
    partial = partial_correlation(blended_correlation(readings), 0.1)
    weak = [
        (i, j)
        for i, j in np.argwhere(np.triu(joined))
        if max(min(partial[i, k], partial[j, k]) for k in range(14) if k not in (i, j))
        > 1.2 * partial[i, j]
    ]
    assert len(weak) <= 13, "no more than a tree has edges"
    assert joined.sum() // 2 > 13


@given(st.floats(1.1, 20), st.floats(1e-3, 1e3), st.integers(2, 9))
def test_unevenness_is_the_sd_of_log_distances_in_any_unit(ratio, unit, n):
    # A comb whose gaps are 1 and ratio by turns.
    x = np.concatenate([[0], np.cumsum(np.tile([1, ratio], n))])[:, None]
    joined = np.eye(len(x), k=1, dtype=bool) | np.eye(len(x), k=-1, dtype=bool)
    assert unevenness(unit * x, joined) == pytest.approx(np.log(ratio) / 2)
    np.testing.assert_allclose(edge_distances(unit * x, joined), unit * np.diff(x[:, 0]))
    assert unevenness(np.zeros_like(x), joined) == pytest.approx(0, abs=1e-9)


def test_halves_of_noise_or_of_few_frames_do_not_agree():
    noise = np.random.default_rng(0).standard_normal((2000, 30))
    assert split_half_agreement(noise) < 0.3
    assert split_half_agreement(noise[:4]) == 0
    silent = np.zeros((400, 5))
    silent[:20] = noise[:20, :5]
    assert split_half_agreement(silent) == 0


@pytest.mark.parametrize(
    ("readings", "positions"),
    [(np.ones((2, 5)), None), (np.ones((9, 1)), None), (np.eye(9), np.ones((3, 2)))],
)
def test_mismatched_shapes_are_refused(readings, positions):
    with pytest.raises(InputError, match="shape"):
        adjacency_graph(readings, positions)
