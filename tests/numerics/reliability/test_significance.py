"""Chance links are short cuts across a large skin: they are left out, and nothing is torn."""

import numpy as np
import pytest
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist, pdist

from anisomap import Recording, reconstruct
from anisomap.evaluation import mantel
from anisomap.health import assess
from anisomap.numerics.reliability import significance
from anisomap.numerics.reliability.sampling_noise import sampling_variance
from anisomap.numerics.reliability.significance import (
    remove_insignificant_links,
    significant_links,
    standardised_correlation,
)
from anisomap.numerics.similarity.correlation import pearson

REACH = 3.0
"""Two sensors further apart than twice this are never touched by one contact."""


def strip(n_frames, seed, length=90, width=7):
    """Places on a long skin, and what they read of two contacts at a time."""
    rng = np.random.default_rng(seed)
    places = np.stack(np.meshgrid(np.arange(length), np.arange(width)), axis=-1).reshape(-1, 2)
    readings = np.zeros((n_frames, len(places)))
    for _ in range(2):
        contacts = rng.uniform((-1, -1), (length, width), (n_frames, 2))
        depths = np.maximum(0, REACH - cdist(contacts, places)) * rng.uniform(0.5, 1, (n_frames, 1))
        readings = np.maximum(readings, depths)
    return places.astype(float), readings


def links_of(readings):
    return pearson(readings), sampling_variance(readings)


@pytest.fixture(scope="module", params=[0, 1, 2])
def short(request):
    return strip(700, request.param)


def test_links_that_are_followed_join_sensors_of_one_contact(short):
    places, readings = short
    similarity, variance = links_of(readings)
    followed = significant_links(similarity, variance)
    apart = cdist(places, places)
    assert (followed == followed.T).all()
    assert not followed.diagonal().any()
    assert apart[followed].max() < 2 * REACH
    assert followed[(apart > 0) & (apart < 1.5)].mean() > 0.9
    # Without a look at chance, some of those that are never touched together seem related.
    strong = standardised_correlation(similarity, variance) > 3
    assert strong[apart > 2 * REACH].any()


def test_maps_of_large_skins_from_few_frames(short, monkeypatch):
    places, readings = short
    recording = Recording(readings)
    options = {"dimensions": 2, "judge": False, "health": assess(recording)}

    def agreement():
        found = reconstruct(recording, **options).positions
        return mantel(found, places, permutations=0).r

    aware = agreement()
    monkeypatch.setattr(significance, "MIN_FILTERED_SENSORS", 10_000)
    assert aware > 0.995
    assert aware > agreement()


def test_pieces_stay_whole_and_apart():
    readings = np.hstack([strip(2500, seed)[1] for seed in (5, 6)])
    size = readings.shape[1] // 2
    similarity, variance = links_of(readings)
    similarity[:size, size:] = similarity[size:, :size] = 0
    apart = remove_insignificant_links(np.ones_like(similarity), similarity, variance)
    assert np.isinf(apart[:size, size:]).all()
    for piece in (apart[:size, :size], apart[size:, size:]):
        assert 0.01 < np.isfinite(piece).mean() < 0.3
        assert connected_components(np.isfinite(piece), directed=False)[0] == 1


def test_where_links_beyond_chance_hardly_hold_together_all_are_followed():
    places, readings = strip(60, 0)
    followed = significant_links(*links_of(readings))
    np.testing.assert_array_equal(followed, ~np.eye(len(places), dtype=bool))


def test_sensors_that_were_hardly_touched_keep_their_strongest_link():
    readings = strip(700, 0)[1]
    readings[20:, 100] = 0
    readings[:20, 100] = readings[:20, 101]
    similarity, variance = links_of(readings)
    followed = significant_links(similarity, variance)
    assert connected_components(followed, directed=False)[0] == 1
    assert followed[100].any()


def test_in_whatever_order_sensors_come(short):
    _, readings = short
    order = np.random.default_rng(0).permutation(readings.shape[1])
    expected = significant_links(*links_of(readings))[np.ix_(order, order)]
    found = significant_links(*links_of(readings[:, order]))
    assert (found != expected).mean() < 1e-5  # ties of rounding aside


def test_of_few_sensors_all_links_count():
    readings = strip(700, 0, length=20)[1]
    similarity, variance = links_of(readings)
    lengths = pdist(np.random.default_rng(0).uniform(size=(len(similarity), 2)))
    apart = np.zeros_like(similarity)
    apart[np.triu_indices(len(apart), 1)] = lengths
    apart += apart.T
    found = remove_insignificant_links(apart.copy(), similarity, variance)
    np.testing.assert_array_equal(found, apart)


def test_where_contacts_cover_much_of_the_skin_links_are_not_looked_through(short, monkeypatch):
    _, readings = short
    similarity, variance = links_of(readings)
    expected = standardised_correlation(similarity, variance)
    monkeypatch.setattr(significance, "MOST_PRODUCTS", 1)
    monkeypatch.setattr(significance, "FOLLOWED", 0.5)
    followed = significant_links(similarity, variance)
    n_pairs = len(similarity) * (len(similarity) - 1) // 2
    strong = expected >= 0.5 * np.sqrt(2 * np.log(n_pairs))
    np.fill_diagonal(strong, val=False)
    assert (followed >= strong).all()
