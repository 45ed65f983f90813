"""Compiled searches for shortest paths, compared with scipy."""

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.sparse.csgraph import csgraph_from_dense, floyd_warshall
from scipy.spatial.distance import pdist, squareform

from anisomap.numerics.compiled.graphs import SIDE
from anisomap.numerics.compiled.parallel import MIN_COMPILED_ROWS, MIN_PARALLEL_ROWS
from anisomap.numerics.graph.metric import metricise, shortest_paths
from skins import lattice


def oracle(lengths):
    return floyd_warshall(csgraph_from_dense(lengths, null_value=np.inf), directed=False)


def skin_like(n_rows, seed):
    """Dissimilarities of a skin: reciprocals of similarities that decrease with distance."""
    distances = pdist(lattice(n_rows, n_rows))
    noise = np.random.default_rng(seed).uniform(0.9, 1.1, len(distances))
    return squareform(np.exp(np.minimum(distances**2 / 2, 30)) * noise)


def search(lengths):
    """Search with the nodes spread over three tiles, among isolated ones."""
    n = 2 * SIDE + 10
    places = np.linspace(0, n - 1, len(lengths)).astype(int)
    spread = np.full((n, n), np.inf)
    np.fill_diagonal(spread, 0)
    spread[np.ix_(places, places)] = lengths
    found = shortest_paths(spread)
    isolated = np.setdiff1d(np.arange(n), places)
    assert np.isinf(found[np.ix_(isolated, places)]).all()
    return found[np.ix_(places, places)]


ANY_LENGTH = st.one_of(st.floats(0.01, 100), st.sampled_from([np.inf, np.inf, 0.0, 1.0]))
WHOLE_LENGTH = st.integers(0, 9).map(float)


@st.composite
def graphs(draw, lengths=ANY_LENGTH):
    n = draw(st.integers(1, 14))
    pairs = draw(arrays(np.float64, n * (n - 1) // 2, elements=lengths))
    return squareform(pairs) if n > 1 else np.zeros((1, 1))


@given(lengths=graphs())
def test_missing_tied_and_zero_lengths_as_in_scipy(lengths):
    found = search(lengths)
    np.testing.assert_allclose(found, oracle(lengths), rtol=1e-12)
    np.testing.assert_array_equal(found, found.T)


@given(lengths=graphs(lengths=WHOLE_LENGTH))
def test_integer_lengths_are_exact(lengths):
    np.testing.assert_array_equal(search(lengths), oracle(lengths))


@pytest.mark.parametrize("seed", range(3))
def test_a_skin_of_hundreds_of_sensors(seed):
    lengths = skin_like(18, seed)
    found = shortest_paths(lengths)
    np.testing.assert_allclose(found, oracle(lengths), rtol=1e-12)
    np.testing.assert_array_equal(found, found.T)


@pytest.mark.parametrize("n_nodes", [1, 2, SIDE - 1, SIDE, SIDE + 1, 3 * SIDE])
@pytest.mark.parametrize("real", [np.float32, np.float64])
def test_all_numbers_of_nodes_around_those_of_whole_tiles(n_nodes, real):
    rng = np.random.default_rng(n_nodes)
    lengths = np.triu(rng.exponential(size=(n_nodes, n_nodes)).astype(real), 1)
    lengths += lengths.T
    found = shortest_paths(lengths)
    assert found.dtype == real
    np.testing.assert_allclose(found, oracle(lengths), rtol=4 * np.finfo(real).eps)
    np.testing.assert_array_equal(found, found.T)


def test_random_lengths_and_a_metric():
    rng = np.random.default_rng(0)
    noise = squareform(rng.uniform(0.01, 1, 300 * 299 // 2))
    metric = squareform(pdist(rng.normal(size=(300, 3))))
    for lengths in (noise, metric):
        np.testing.assert_allclose(shortest_paths(lengths), oracle(lengths), rtol=1e-12)


def test_components_and_many_identical_sensors():
    lengths = np.full((70, 70), np.inf)
    lengths[:30, :30] = skin_like(6, 0)[:30, :30]
    lengths[30:, 30:] = squareform(pdist(np.repeat(np.arange(5.0), 8)[:, None]))
    np.testing.assert_allclose(search(lengths), oracle(lengths), rtol=1e-12)


def test_asymmetry_by_one_bit_does_not_matter():
    lengths = skin_like(23, 0)
    assert len(lengths) >= MIN_COMPILED_ROWS
    uneven = np.triu(np.nextafter(lengths, np.inf), 1) + np.tril(lengths)
    found = metricise(uneven)
    np.testing.assert_allclose(found, oracle(lengths), rtol=1e-12)
    np.testing.assert_array_equal(found, found.T)


def test_results_do_not_depend_on_the_number_of_threads(monkeypatch):
    rng = np.random.default_rng(0)
    lengths = np.full((MIN_PARALLEL_ROWS, MIN_PARALLEL_ROWS), np.inf)
    for step in (1, 2, 40):
        edges = rng.uniform(size=MIN_PARALLEL_ROWS - step)
        lengths[np.arange(len(edges)), np.arange(len(edges)) + step] = edges
    lengths = np.minimum(lengths, lengths.T)
    np.fill_diagonal(lengths, 0)
    results = []
    for n_threads in (1, 3):
        monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", n_threads)
        results.append(shortest_paths(lengths))
    np.testing.assert_array_equal(*results)
