"""Significant links of large skins: short-range, and enough to connect each skin."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist, pdist

from anisomap.evaluation import mantel
from anisomap.numerics.graph.dissimilarity import direct_dissimilarity
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.reliability import sampling_noise
from anisomap.numerics.reliability.sampling_noise import (
    count_shared_neighbours,
    links_with_shared_neighbours,
    remove_insignificant_links,
    sampling_variance,
    significant_links,
    standardised_correlation,
)
from anisomap.numerics.scaling.multidimensional_scaling import torgerson
from anisomap.numerics.similarity.correlation import pearson

REACH = 3.0
"""Radius of a contact: sensors further apart than twice this never share one."""


def strip(n_frames, seed, length=90, width=7):
    """Positions on a long skin, and readings of two contacts at a time."""
    rng = np.random.default_rng(seed)
    positions = np.stack(np.meshgrid(np.arange(length), np.arange(width)), axis=-1).reshape(-1, 2)
    readings = np.zeros((n_frames, len(positions)))
    for _ in range(2):
        contacts = rng.uniform((-1, -1), (length, width), (n_frames, 2))
        depths = np.maximum(0, REACH - cdist(contacts, positions)) * rng.uniform(
            0.5, 1, (n_frames, 1)
        )
        readings = np.maximum(readings, depths)
    return positions.astype(float), readings


def links_of(readings):
    return pearson(readings), sampling_variance(readings)


@pytest.fixture(scope="module", params=[0, 1])
def short(request):
    return strip(700, request.param)


def test_significant_links_join_sensors_of_one_contact(short):
    positions, readings = short
    similarity, variance = links_of(readings)
    followed = significant_links(similarity, variance)
    apart = cdist(positions, positions)
    assert (followed == followed.T).all()
    assert not followed.diagonal().any()
    assert apart[followed].max() < 2 * REACH
    assert followed[(apart > 0) & (apart < 1.5)].mean() > 0.9
    # Three standard deviations alone would keep links of unrelated sensors.
    strong = standardised_correlation(similarity, variance) > 3
    assert strong[apart > 2 * REACH].any()


def test_insignificant_links_shorten_paths_across_the_skin(short):
    positions, readings = short
    similarity, variance = links_of(readings)
    dissimilarity = direct_dissimilarity(similarity, variance)

    def agreement(lengths):
        return mantel(torgerson(metricise(lengths), 2), positions, permutations=0).r

    significant = agreement(remove_insignificant_links(dissimilarity.copy(), similarity, variance))
    assert significant > 0.99
    assert significant > agreement(dissimilarity)


def test_components_stay_connected_and_separate():
    readings = np.hstack([strip(2500, seed)[1] for seed in (5, 6)])
    size = readings.shape[1] // 2
    similarity, variance = links_of(readings)
    similarity[:size, size:] = similarity[size:, :size] = 0
    apart = remove_insignificant_links(np.ones_like(similarity), similarity, variance)
    assert np.isinf(apart[:size, size:]).all()
    for piece in (apart[:size, :size], apart[size:, size:]):
        assert 0.01 < np.isfinite(piece).mean() < 0.3
        assert connected_components(np.isfinite(piece), directed=False)[0] == 1


def test_all_links_are_kept_if_the_significant_ones_hardly_connect_the_skin():
    positions, readings = strip(60, 0)
    followed = significant_links(*links_of(readings))
    np.testing.assert_array_equal(followed, ~np.eye(len(positions), dtype=bool))


def test_rarely_touched_sensors_keep_their_strongest_link():
    readings = strip(700, 0)[1]
    readings[20:, 100] = 0
    readings[:20, 100] = readings[:20, 101]
    similarity, variance = links_of(readings)
    followed = significant_links(similarity, variance)
    assert connected_components(followed, directed=False)[0] == 1
    assert followed[100].any()


def test_relabelling_sensors_relabels_links(short):
    _, readings = short
    order = np.random.default_rng(0).permutation(readings.shape[1])
    expected = significant_links(*links_of(readings))[np.ix_(order, order)]
    found = significant_links(*links_of(readings[:, order]))
    assert (found != expected).mean() < 1e-5  # rounding may break ties differently


def test_all_links_of_few_sensors_are_kept():
    readings = strip(700, 0, length=20)[1]
    similarity, variance = links_of(readings)
    lengths = pdist(np.random.default_rng(0).uniform(size=(len(similarity), 2)))
    apart = np.zeros_like(similarity)
    apart[np.triu_indices(len(apart), 1)] = lengths
    apart += apart.T
    found = remove_insignificant_links(apart.copy(), similarity, variance)
    np.testing.assert_array_equal(found, apart)


@given(st.integers(0, 99))
def test_shared_neighbours_are_counted_as_by_a_matrix_product(seed):
    rng = np.random.default_rng(seed)
    links = np.triu(rng.uniform(size=(12, 12)) < rng.uniform(), 1)
    links |= links.T
    graph = csr_array(links)
    expected = (links.astype(int) @ links)[graph.tocoo().coords]
    np.testing.assert_array_equal(count_shared_neighbours(graph), expected)


def test_links_are_kept_if_counting_shared_neighbours_is_too_costly(monkeypatch):
    path = np.eye(9, k=1, dtype=bool) | np.eye(9, k=-1, dtype=bool)
    assert not links_with_shared_neighbours(path).any()
    monkeypatch.setattr(sampling_noise, "MAX_PRODUCTS", 1)
    np.testing.assert_array_equal(links_with_shared_neighbours(path), path)
