"""Metricising and graphs: theorems of the paper's Text S3, and scipy as an oracle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.sparse.csgraph import floyd_warshall
from scipy.spatial.distance import pdist, squareform

from anisomap.errors import InputError
from anisomap.numerics.graph.metric import metricise, minimax_paths
from anisomap.numerics.graph.neighbour_graphs import components


@st.composite
def semi_metrics(draw, lengths=None):
    n = draw(st.integers(1, 9))
    if lengths is None:
        lengths = st.one_of(st.floats(0.01, 100), st.just(np.inf), st.just(0.0))
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


@given(semi_metrics(), st.randoms(use_true_random=False))
def test_relabelling_objects_relabels_the_metric(dissimilarity, random):
    order = list(range(len(dissimilarity)))
    random.shuffle(order)
    relabelled = np.ix_(order, order)
    np.testing.assert_allclose(
        metricise(dissimilarity[relabelled]), metricise(dissimilarity)[relabelled], rtol=1e-12
    )


@pytest.mark.parametrize("seed", range(2))
def test_equal_to_scipy(seed):
    rng = np.random.default_rng(seed)
    dissimilarity = squareform(rng.uniform(0.01, 1, size=60 * 59 // 2))
    expected = floyd_warshall(dissimilarity, directed=False)
    np.testing.assert_allclose(metricise(dissimilarity), expected, rtol=1e-12)


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
        ([[0, -1], [-1, 0]], "must be at least 0"),
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
    with pytest.raises(InputError, match="must be finite"):
        minimax_paths([[0, np.inf], [np.inf, 0]])
