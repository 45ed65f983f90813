"""Neighbour graphs, and maps of path lengths on them: invariances and known lattices."""

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
    fit_path_lengths,
    refine_by_even_spacing,
    split_half_agreement,
    unevenness,
)
from anisomap.numerics.graph.dissimilarity import partial_correlation
from anisomap.numerics.reliability.split_half import blended_correlation
from skins import flat_skin, lattice, likeness, rubbed


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


def grid(rows=6, columns=7):
    """A square lattice, which unlike a triangular one offers no detour around a long link."""
    return np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2) * 1.0


def nearest(positions, reach=1.01):
    distances = cdist(positions, positions)
    return (distances < reach) & (distances > 0)


def test_a_straight_chain_is_recovered():
    gaps = np.array([1.0, 0.5, 2.0, 1.0, 1.5])
    lengths = np.diag(gaps, k=1) + np.diag(gaps, k=-1)
    found = fit_path_lengths(lengths, 2)
    np.testing.assert_allclose(np.diag(cdist(found, found), k=1), gaps, rtol=1e-3)
    assert likeness(found, np.cumsum(np.append(0, gaps))[:, None]) > 0.9999


def test_a_lattice_is_recovered_from_its_links():
    positions = lattice()
    assert likeness(fit_path_lengths(nearest(positions).astype(float), 2), positions) > 0.98


def test_an_even_guide_is_followed_and_an_uneven_one_is_ignored():
    positions = grid()
    links = nearest(positions).astype(float)
    alone, squeezed = fit_path_lengths(links, 2), positions * [1, 0.2]
    followed = fit_path_lengths(links, guide=7 * positions)
    assert 1 - likeness(followed, positions) < 0.1 * (1 - likeness(alone, positions))
    ignored = fit_path_lengths(links, guide=squeezed)
    np.testing.assert_array_equal(ignored, alone)
    assert likeness(squeezed, positions) < 0.9 < likeness(ignored, positions)


@given(st.integers(0, 20))
def test_the_fit_is_equivariant_to_labels(seed):
    positions, order = lattice(4, 4), np.random.default_rng(seed).permutation(16)
    links = nearest(positions) * 1.0
    straight = fit_path_lengths(links, guide=positions)
    other = fit_path_lengths(links[np.ix_(order, order)], guide=positions[order])
    np.testing.assert_allclose(cdist(other, other), cdist(straight[order], straight[order]),
                               atol=1e-6)  # fmt: skip


def test_even_spacing_corrects_a_compressed_map_and_keeps_its_unit():
    positions = grid()
    readings = rubbed(positions, 2000)
    squeezed = 30 * positions * [1, 0.2]
    found = refine_by_even_spacing(readings, squeezed)
    assert likeness(squeezed, positions) < 0.9
    assert likeness(found, positions) > 0.97
    links = nearest(positions)
    before, after = (np.log(cdist(x, x)[links]).mean() for x in (squeezed, found))
    assert after == pytest.approx(before, abs=0.1)


def test_without_agreement_of_halves_an_uneven_map_is_unchanged():
    noise = np.random.default_rng(1).standard_normal((1000, 30))
    places = np.random.default_rng(2).normal(size=(30, 2)) * [1, 0.01]
    assert refine_by_even_spacing(noise, places) is None


def test_disconnected_links_are_refused():
    with pytest.raises(InputError, match="separate"):
        fit_path_lengths(np.zeros((4, 4)), 2)
