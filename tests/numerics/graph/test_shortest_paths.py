"""The compiled search for shortest paths: both ways, forced on small graphs, against scipy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.sparse.csgraph import csgraph_from_dense, floyd_warshall
from scipy.spatial.distance import pdist, squareform

from anisomap.numerics.compiled import parallel
from anisomap.numerics.graph import metric, shortest_paths
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.graph.shortest_paths import (
    CHECKED,
    along_few_edges,
    holds,
    through_all_nodes,
)
from skins import lattice


def oracle(lengths):
    return floyd_warshall(csgraph_from_dense(lengths, null_value=np.inf), directed=False)


def skin_like(n_rows, seed):
    """Dissimilarities of a skin: reciprocals of similarities that fall with the distance."""
    distances = pdist(lattice(n_rows, n_rows))
    noise = np.random.default_rng(seed).uniform(0.9, 1.1, len(distances))
    return squareform(np.exp(np.minimum(distances**2 / 2, 30)) * noise)


@pytest.fixture(params=["few edges", "all nodes"])
def search(request, monkeypatch):
    """Both ways, with blocks so small that a few nodes already make several."""
    monkeypatch.setattr(shortest_paths, "TILE", 4)
    monkeypatch.setattr(shortest_paths, "SOURCES", 3)
    monkeypatch.setattr(shortest_paths, "NEAREST", 2)
    monkeypatch.setattr(shortest_paths, "FEW", 1.0)
    return along_few_edges if request.param == "few edges" else through_all_nodes


ANY_LENGTH = st.one_of(st.floats(0.01, 100), st.sampled_from([np.inf, np.inf, 0.0, 1.0]))
WHOLE_LENGTH = st.integers(0, 9).map(float)


@st.composite
def graphs(draw, lengths=ANY_LENGTH):
    n = draw(st.integers(1, 14))
    pairs = draw(arrays(np.float64, n * (n - 1) // 2, elements=lengths))
    return squareform(pairs) if n > 1 else np.zeros((1, 1))


fixed_search = settings(deadline=None, suppress_health_check=["function_scoped_fixture"])


@given(graphs())
@fixed_search
def test_equal_to_scipy_whatever_is_missing_tied_or_zero(search, lengths):
    found = search(lengths)
    np.testing.assert_allclose(found, oracle(lengths), rtol=1e-12)
    np.testing.assert_array_equal(found, found.T)


@given(graphs(lengths=WHOLE_LENGTH))
@fixed_search
def test_whole_numbers_come_out_exactly(search, lengths):
    np.testing.assert_array_equal(search(lengths), oracle(lengths))


@given(graphs())
@fixed_search
def test_searching_again_finds_the_same(search, lengths):
    found = search(lengths)
    np.testing.assert_allclose(search(found), found, rtol=1e-12)


@given(graphs())
@settings(deadline=None)
def test_the_check_passes_what_is_shortest_and_nothing_else_from_its_sources(lengths):
    shortest = oracle(lengths)
    assert holds(shortest, lengths)
    sources = np.linspace(0, len(shortest) - 1, CHECKED).astype(int)
    finite = np.isfinite(shortest) & (shortest > 0) & np.isin(np.arange(len(shortest)), sources)
    if finite.any():
        j, i = np.argwhere(finite)[0]
        wrong = shortest.copy()
        wrong[i, j] = wrong[j, i] = 1.01 * shortest[i, j]
        assert not holds(wrong, lengths)


@pytest.mark.parametrize("seed", range(3))
def test_a_skin_of_hundreds(seed):
    lengths = skin_like(18, seed)
    expected = oracle(lengths)
    for found in (along_few_edges(lengths), through_all_nodes(lengths)):
        np.testing.assert_allclose(found, expected, rtol=1e-12)
        np.testing.assert_array_equal(found, found.T)


def test_pure_noise_and_a_metric_come_out_right():
    rng = np.random.default_rng(0)
    noise = squareform(rng.uniform(0.01, 1, 300 * 299 // 2))
    metric = squareform(pdist(rng.normal(size=(300, 3))))
    for lengths in (noise, metric):
        np.testing.assert_allclose(
            shortest_paths.shortest_paths(lengths), oracle(lengths), rtol=1e-12
        )
    assert along_few_edges(metric) is None  # every edge is a shortest path: they are not few


def test_separate_pieces_and_crowds_of_twins(search):
    # More twins than the nearest edges that are looked at first.
    lengths = np.full((70, 70), np.inf)
    lengths[:30, :30] = skin_like(6, 0)[:30, :30]
    lengths[30:, 30:] = squareform(pdist(np.repeat(np.arange(5.0), 8)[:, None]))
    np.testing.assert_allclose(search(lengths), oracle(lengths), rtol=1e-12)


def test_one_ulp_of_asymmetry_misleads_nobody(monkeypatch):
    monkeypatch.setattr(metric, "MIN_COMPILED_ROWS", 1)
    lengths = skin_like(12, 0)
    upset = np.triu(np.nextafter(lengths, np.inf), 1) + np.tril(lengths)
    assert (upset != upset.T).any()
    found = metricise(upset)
    np.testing.assert_allclose(found, oracle(lengths), rtol=1e-12)
    np.testing.assert_array_equal(found, found.T)


def test_a_wrong_answer_is_noticed_and_mended(monkeypatch, caplog):
    monkeypatch.setattr(shortest_paths, "along_few_edges", lambda lengths: 1.5 * lengths)
    lengths = skin_like(8, 0)
    np.testing.assert_allclose(shortest_paths.shortest_paths(lengths), oracle(lengths), rtol=1e-12)
    assert "not the shortest" in caplog.text


@pytest.mark.parametrize("search", [along_few_edges, through_all_nodes])
def test_threads_change_nothing(search, monkeypatch):
    lengths = skin_like(20, 0)
    alone = search(lengths)
    monkeypatch.setattr(parallel, "MIN_PARALLEL_ROWS", 1)
    monkeypatch.setattr(parallel, "thread_count", lambda: 3)
    np.testing.assert_array_equal(search(lengths), alone)
