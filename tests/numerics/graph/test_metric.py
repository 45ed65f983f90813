"""Metricising: theorems of the paper's Text S3, and scipy as an oracle."""

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.sparse.csgraph import csgraph_from_dense, floyd_warshall
from scipy.spatial.distance import cdist, pdist, squareform

from anisomap.errors import InputError
from anisomap.numerics.compiled.graphs import SIDE
from anisomap.numerics.compiled.parallel import MIN_COMPILED_ROWS, MIN_PARALLEL_ROWS
from anisomap.numerics.graph.metric import (
    metricise,
    minimax_paths,
    shortest_paths,
    with_bounded_stems,
)
from anisomap.numerics.neighbours import components
from skins import lattice

ANY_LENGTH = st.one_of(st.floats(0.01, 100), st.sampled_from([np.inf, np.inf, 0.0, 1.0]))
WHOLE_LENGTH = st.integers(0, 9).map(float)


@st.composite
def semi_metrics(draw, lengths=ANY_LENGTH, most=9):
    n = draw(st.integers(1, most))
    pairs = draw(arrays(np.float64, n * (n - 1) // 2, elements=lengths))
    return squareform(pairs) if n > 1 else np.zeros((1, 1))


@given(semi_metrics())
def test_the_triangle_inequality_holds_afterwards(dissimilarity):
    metric = metricise(dissimilarity)
    through = (metric[:, :, None] + metric[None, :, :]).min(axis=1)
    assert (metric <= through * (1 + 1e-12)).all()


@given(semi_metrics())
def test_no_length_grows_and_symmetry_is_exact(dissimilarity):
    metric = metricise(dissimilarity)
    assert (metric <= dissimilarity).all()
    np.testing.assert_array_equal(metric, metric.T)
    assert not np.diag(metric).any()


@given(semi_metrics())
def test_a_metric_is_unchanged(dissimilarity):
    metric = metricise(dissimilarity)
    np.testing.assert_allclose(metricise(metric), metric, rtol=1e-12)


@given(arrays(np.float64, (6, 3), elements=st.floats(-10, 10)), semi_metrics())
def test_the_result_is_the_greatest_metric_below_the_input(points, added):
    n = len(added)
    metric = squareform(pdist(points))[:n, :n]
    added = added[: len(metric), : len(metric)]
    assert (metric <= metricise(metric + added) * (1 + 1e-12)).all()


def test_identical_sensors_have_distance_zero():
    # In dense graphs, scipy reads 0 as "no edge", which gives a distance of 10.
    dissimilarity = np.array([[0.0, 0, 5], [0, 0, 7], [5, 7, 0]])
    np.testing.assert_array_equal(metricise(dissimilarity), [[0, 0, 5], [0, 0, 5], [5, 5, 0]])


def test_components_are_numbered_by_size():
    dissimilarity = np.full((6, 6), np.inf)
    for group in ([0], [1, 4], [2, 3, 5]):
        dissimilarity[np.ix_(group, group)] = 1
    np.fill_diagonal(dissimilarity, 0)
    np.testing.assert_array_equal(components(dissimilarity), [2, 1, 0, 0, 1, 0])
    metric = metricise(dissimilarity)
    assert np.isinf(metric[0, 1])
    assert metric[2, 5] == 1


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.zeros((2, 3)), "square"),
        ([[0, -1], [-1, 0]], "is negative: -1"),
        ([[0, 1], [2, 0]], "not symmetric"),
        ([[0, np.nan], [np.nan, 0]], "0 and 1 is NaN"),
        ([[1, 2], [2, 1]], "to itself"),
    ],
)
def test_matrices_that_are_not_semi_metrics_are_rejected(matrix, message):
    with pytest.raises(InputError, match=message):
        metricise(matrix)


@given(semi_metrics(st.floats(0.0, 100)))
def test_minimax_paths_equal_brute_force(dissimilarity):
    # Floyd's algorithm with the maximum in place of the sum.
    expected = dissimilarity.copy()
    for k in range(len(expected)):
        expected = np.minimum(expected, np.maximum.outer(expected[:, k], expected[k]))
    found = minimax_paths(dissimilarity)
    np.testing.assert_array_equal(found, expected)
    assert (found <= dissimilarity).all()


def test_minimax_paths_of_infinite_lengths_are_rejected():
    with pytest.raises(InputError, match="need finite"):
        minimax_paths([[0, np.inf], [np.inf, 0]])


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


@given(lengths=semi_metrics(most=14))
def test_missing_tied_and_zero_lengths_as_in_scipy(lengths):
    found = search(lengths)
    np.testing.assert_allclose(found, oracle(lengths), rtol=1e-12)
    np.testing.assert_array_equal(found, found.T)


@given(lengths=semi_metrics(WHOLE_LENGTH, 14))
def test_integer_lengths_are_exact(lengths):
    np.testing.assert_array_equal(search(lengths), oracle(lengths))


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


@given(
    st.integers(4, 20).flatmap(lambda n: st.tuples(st.just(n), st.integers(1, n // 2))),
    st.floats(0, 100),
    st.integers(0, 99),
)
def test_stems_end_where_the_others_do(sizes, stem, seed):
    """Nodes at the end of a stem of any length come to the extent of the others, but no nearer."""
    n_others, n_hidden = sizes
    points = np.random.default_rng(seed).random((n_others + n_hidden, 2))
    stems = np.where(np.arange(len(points)) < n_others, 0, stem)
    lengths = cdist(points, points) + np.add.outer(stems, stems)
    np.fill_diagonal(lengths, 0)
    hidden = np.arange(n_others, len(points))
    found = with_bounded_stems(lengths, hidden)
    among = np.ix_(np.arange(n_others), np.arange(n_others))
    np.testing.assert_array_equal(found[among], lengths[among])
    np.testing.assert_array_equal(found, found.T)
    extent = np.quantile(lengths[among], 0.9)
    nearest, before = (x[hidden, :n_others].min(axis=1) for x in (found, lengths))
    np.testing.assert_allclose(nearest, np.minimum(before, extent), atol=1e-9)
    assert (found <= lengths + 1e-9).all()
