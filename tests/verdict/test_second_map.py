"""Graphs of adjacent sensors: invariances and known lattices."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from anisomap.numerics.graph.dissimilarity import partial_correlation
from anisomap.numerics.reliability.sampling_noise import blended_correlation
from anisomap.simulation.bodies import sphere
from anisomap.verdict.second_map import adjacency_graph, spacing_varies
from skins import lattice, rubbed


def smooth_noise(n_frames: int, n_sensors: int, seed: int) -> np.ndarray:
    """Readings without spatial structure, which must still give a connected graph."""
    rng = np.random.default_rng(seed)
    return rng.standard_normal((n_frames, 3)) @ rng.standard_normal(
        (3, n_sensors)
    ) + rng.standard_normal((n_frames, n_sensors))


def linked(readings: np.ndarray, positions: np.ndarray | None = None) -> np.ndarray:
    """Link sensors by the correlations of their readings."""
    changes = blended_correlation(np.diff(readings, axis=0))
    return adjacency_graph(blended_correlation(readings), changes, positions)


@given(st.integers(3, 200), st.integers(2, 12), st.integers(0, 99))
def test_the_graph_is_symmetric_connected_and_without_loops(n_frames, n_sensors, seed):
    readings = smooth_noise(n_frames, n_sensors, seed)
    joined = linked(readings, np.random.default_rng(seed).normal(size=(n_sensors, 2)))
    assert np.array_equal(joined, joined.T)
    assert not np.diag(joined).any()
    assert connected_components(joined, directed=False)[0] == 1


@given(st.integers(0, 99))
def test_the_graph_is_equivariant_to_labels(seed):
    readings, rng = smooth_noise(120, 10, seed), np.random.default_rng(seed)
    positions, order = rng.normal(size=(10, 3)), rng.permutation(10)
    joined = linked(readings, positions)
    np.testing.assert_array_equal(
        linked(readings[:, order], positions[order]), joined[np.ix_(order, order)]
    )


@given(st.integers(0, 99))
def test_the_graph_does_not_depend_on_gain_and_offset(seed):
    readings, rng = smooth_noise(120, 8, seed), np.random.default_rng(seed)
    other = readings * rng.uniform(0.1, 10, 8) + rng.normal(size=8)
    np.testing.assert_array_equal(linked(other), linked(readings))


def test_a_rubbed_lattice_is_recovered():
    positions = lattice()
    readings = rubbed(positions, 3000)
    near = cdist(positions, positions) < 1.01
    np.fill_diagonal(near, val=False)
    joined = linked(readings, positions)
    assert (joined & near).sum() > 0.98 * joined.sum(), "hardly a shortcut"


@pytest.mark.parametrize("sign", [1, -1])
def test_two_sensors_are_linked_even_if_they_are_opposites(sign):
    first = np.random.default_rng(0).standard_normal((300, 1))
    links = linked(np.hstack([first, sign * first + 0.1 * first[::-1]]))
    assert links.tolist() == [[False, True], [True, False]]


@given(st.integers(25, 200))
def test_an_even_sphere_is_not_crowded_but_one_with_a_dense_half(count):
    places = sphere(count).positions.copy()
    assert not spacing_varies(places)[1]
    places[: count // 2] = [0, 0, 1] + 0.3 * (places[: count // 2] - [0, 0, 1])
    assert spacing_varies(places)[1]


def test_only_edges_of_the_tree_have_much_stronger_detours():
    readings = smooth_noise(400, 14, 3)
    joined = linked(readings)
    partial = partial_correlation(blended_correlation(readings), 0.1)
    weak = [
        (i, j)
        for i, j in np.argwhere(np.triu(joined))
        if max(min(partial[i, k], partial[j, k]) for k in range(14) if k not in (i, j))
        > 1.2 * partial[i, j]
    ]
    assert len(weak) <= 13, "no more than a tree has edges"
    assert joined.sum() // 2 > 13
