"""Heights of contacts: known lengths; only compressed maps use them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter1d
from scipy.spatial.distance import cdist
from scipy.stats import rankdata

from anisomap import Recording
from anisomap.method.evidence import compare
from anisomap.method.options import MethodOptions
from anisomap.method.refinements import by_heights
from anisomap.numerics.geodesic.contact_heights import (
    MIN_PEAKS,
    ContactHeights,
    HeightSimilarity,
    contacts_of,
    explained_share,
    height_links,
    peak_lengths,
)
from anisomap.numerics.neighbours import local_dimension
from anisomap.numerics.similarity.rest import estimate_rest
from skins import flat_skin, lattice, likeness, swept

SEEDS = range(301, 303)


def scattered(seed):
    """Return an uneven flat skin of 64 sensors, without columns."""
    return lattice(8, 8) + np.random.default_rng(seed).uniform(-0.3, 0.3, (64, 2))


def heights_of(readings):
    return ContactHeights.of(estimate_rest(readings).depth(readings))


def corrected(readings, positions):
    """Return what the heights of contacts propose in place of a map."""
    pairs = compare([Recording(readings)], "blended-correlation", bins=4, with_noise=True)
    return by_heights(pairs, pairs.similarity, positions, MethodOptions())


def compressed(positions, factor=0.05):
    return positions * [1, factor]


def exact(positions, reach=2.0, n_contacts=1e4):
    """Return the similarity of heights on smooth ground without errors of sampling."""
    similarity = np.exp(-((cdist(positions, positions) / reach) ** 2))
    partial = -np.linalg.inv(similarity + np.eye(len(similarity)))
    np.fill_diagonal(partial, 0)
    return HeightSimilarity(similarity, partial, np.full(similarity.shape, n_contacts))


@pytest.mark.parametrize("seed", SEEDS)
def test_heights_resolve_the_direction_that_readings_do_not(seed):
    places = scattered(seed)
    readings = swept(places, seed=seed)
    along = [(i, j) for i in range(64) for j in range(i) if abs(places[i, 0] - places[j, 0]) < 0.4]
    first, second = np.transpose(along)
    distance = np.abs(places[first, 1] - places[second, 1])
    by_reading = np.corrcoef(readings.T)[first, second]
    by_height = heights_of(readings).compare().similarity[first, second]
    assert by_reading.min() > 0.6
    assert np.corrcoef(distance[distance < 3], by_height[distance < 3])[0, 1] < -0.85


@settings(max_examples=15)
@given(st.integers(0, 50))
def test_heights_do_not_depend_on_gain_offset_and_sign(seed):
    readings, rng = swept(lattice(4, 4), 20, seed=seed), np.random.default_rng(seed)
    gains = 2.0 ** rng.integers(-5, 6, 16) * rng.choice([-1, 1], 16)
    again = heights_of(readings * gains).compare()
    found = heights_of(readings).compare()
    np.testing.assert_allclose(again.similarity, found.similarity, atol=1e-9)
    np.testing.assert_allclose(again.partial, found.partial, atol=1e-9)


def test_heights_are_equivariant_to_labels():
    readings, order = swept(lattice(4, 4), 30), np.random.default_rng(0).permutation(16)
    found, again = (heights_of(x).compare() for x in (readings, readings[:, order]))
    np.testing.assert_allclose(again.similarity, found.similarity[np.ix_(order, order)])
    np.testing.assert_allclose(again.partial, found.partial[np.ix_(order, order)], atol=1e-9)


@pytest.mark.parametrize("half", [1, 4, 11])
def test_ranks_are_those_of_the_highest_reading_around_a_frame(half):
    """Contacts of 1 / .75 times `half` frames are compared over that many frames to each side."""
    rng = np.random.default_rng(half)
    lasting = round(half / 0.75)
    readings = np.zeros((40 * lasting, 3))  # depths beyond rest
    for begin in range(0, len(readings), 4 * lasting):
        readings[begin + lasting : begin + 2 * lasting] = rng.integers(1, 9, (lasting, 3))
    found = ContactHeights.of(readings)
    highest = maximum_filter1d(readings, 2 * half + 1, axis=0)
    np.testing.assert_allclose(found.ranks, rankdata(highest, axis=0) / len(readings), rtol=1e-6)


def test_thresholded_readings_have_no_heights():
    readings = swept(lattice(4, 4), 30)
    assert heights_of(readings).usable
    assert not heights_of((readings > 1).astype(float)).usable
    assert not heights_of(np.zeros((50, 4))).usable


@pytest.mark.parametrize("seed", SEEDS)
def test_a_map_explains_heights_unless_it_is_compressed_or_scrambled(seed):
    places = scattered(seed)
    readings = swept(places, seed=seed)
    halves = heights_of(readings).halves
    sharing = np.corrcoef(readings.T) > 0.05
    right = explained_share(halves, places, sharing)
    assert right.reliability > 0.7
    assert right.share > 0.9
    scrambled = places[np.random.default_rng(seed).permutation(64)]
    for wrong in (compressed(places), scrambled):
        assert explained_share(halves, wrong, sharing).share < 0.5


def test_heights_without_common_variation_explain_nothing():
    halves = [exact(lattice(8, 8))] * 2
    none = np.zeros((64, 64), dtype=bool)
    assert np.isnan(explained_share(halves, lattice(8, 8), none).share)
    flat = HeightSimilarity(np.ones((64, 64)), np.zeros((64, 64)), np.full((64, 64), 99.0))
    assert np.isnan(explained_share([flat] * 2, lattice(8, 8), ~none).share)


def test_exact_similarities_link_neighbours_only():
    places = scattered(301)
    assert cdist(places, places)[height_links(exact(places))].max() < 2.5, "no shortcuts"


@pytest.mark.parametrize("seed", SEEDS)
def test_a_compressed_map_of_a_swept_skin_is_corrected(seed):
    places = scattered(seed)
    found = corrected(swept(places, seed=seed), compressed(places))
    assert found.precision == np.inf
    assert likeness(found.positions, places) > 0.95 > likeness(compressed(places), places) + 0.1
    # The direction that was not compressed keeps its size.
    assert np.ptp(found.positions @ np.linalg.svd(found.positions)[2][:2].T) < 3 * np.ptp(places)


@pytest.mark.parametrize("seed", SEEDS)
def test_right_maps_and_skins_touched_by_compact_contacts_are_left_alone(seed):
    places = scattered(seed)
    for readings, given_map in (
        (swept(places, seed=seed), places),
        (flat_skin(seed=seed).readings, lattice()),
    ):
        found = corrected(readings, given_map)
        assert found.precision == 0
        assert not found.distorted
        np.testing.assert_array_equal(found.positions, given_map)


@pytest.mark.parametrize("seed", SEEDS)
def test_spikes_of_boards_are_not_taken_for_heights(seed):
    rng = np.random.default_rng(seed)
    skin = flat_skin(seed=seed)
    board = rng.permutation(42) % 4
    spikes = (rng.random((len(skin.readings), 4)) < 0.02) * rng.uniform(3, 9)
    found = corrected(skin.readings + spikes[:, board], lattice())
    assert found.precision == 0


def test_a_curve_has_one_dimension_and_a_surface_two():
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0.02 * np.cos(40 * angle)])
    assert local_dimension(ring) < 1.4
    assert local_dimension(scattered(0)) > 1.8
    assert local_dimension(lattice(6, 10)) > 1.8
    ball = np.random.default_rng(0).normal(size=(400, 3))
    assert local_dimension(ball / np.linalg.norm(ball, axis=1, keepdims=True)) > 1.8
    assert np.isnan(local_dimension(lattice(5, 5)))
    assert np.isnan(local_dimension(np.zeros((60, 2))))


PULSE = np.array([0, 1, 3, 6, 3, 1, 0]) / 6


def rolled_over(similar: np.ndarray, n_contacts: int, seed: int = 0, delay: int = 0) -> np.ndarray:
    """Simulate contacts over a line of sensors with autoregressive heights.

    The heights of neighbours i and i + 1 have the correlation ``similar[i]``, `delay` frames apart.
    """
    rng = np.random.default_rng(seed)
    heights = [rng.standard_normal(n_contacts)]
    for a in similar:
        heights.append(a * heights[-1] + np.sqrt(1 - a * a) * rng.standard_normal(n_contacts))
    readings = np.zeros((40 * n_contacts + 40, len(heights)))
    for i, column in enumerate(heights):
        pulses = 5 + column.clip(-4, 4)
        for n in range(n_contacts):
            at = 10 + 40 * n + delay * i
            readings[at : at + len(PULSE), i] = pulses[n] * PULSE
    return readings


def chain(n: int) -> np.ndarray:
    return np.eye(n, k=1, dtype=bool) | np.eye(n, k=-1, dtype=bool)


def lengths_of(readings, links):
    return peak_lengths(ContactHeights.of(estimate_rest(readings).depth(readings)), links)


def test_peaks_are_the_maxima_of_contacts():
    raised = np.array([0.0, 0, 5, 9, 5, 0, 0, 4, 4, 0, 8])
    frames, heights, _ = contacts_of(raised)
    assert frames.tolist() == [3, 7, 10]
    assert heights.tolist() == [9, 4, 8]


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=60))
def test_peaks_are_ordered_readings(values):
    raised = np.array(values)
    frames, heights, _ = contacts_of(raised)
    assert (np.diff(frames) > 1).all()
    np.testing.assert_array_equal(heights, raised[frames])


@pytest.mark.parametrize("delay", [0, 3])
def test_lengths_of_autoregressive_ground_equal_the_closed_form(delay):
    similar = np.array([0.9, 0.7, 0.4, 0.0])
    found = lengths_of(rolled_over(similar, 4000, delay=delay), chain(5))
    # Spearman's rho of two normal variables of correlation a is 6 / pi asin(a / 2).
    expected = np.sqrt(1 - 6 / np.pi * np.arcsin(similar / 2))
    np.testing.assert_allclose(np.diag(found, k=1), expected, atol=0.03)
    assert np.array_equal(found, found.T, equal_nan=True)
    assert np.array_equal(np.isfinite(found), chain(5))


@given(st.integers(0, 50))
def test_lengths_do_not_depend_on_gain_offset_and_sign(seed):
    readings, rng = rolled_over(np.array([0.8, 0.5]), 30, seed), np.random.default_rng(seed)
    gains = 2.0 ** rng.integers(-5, 6, 3) * rng.choice([-1, 1], 3)
    found = lengths_of(readings * gains + rng.integers(-9, 9, 3), chain(3))
    np.testing.assert_allclose(found, lengths_of(readings, chain(3)))


def test_lengths_are_equivariant_to_labels():
    readings, order = rolled_over(np.array([0.9, 0.5, 0.7]), 60, delay=2), [2, 0, 3, 1]
    found = lengths_of(readings, chain(4))
    again = lengths_of(readings[:, order], chain(4)[np.ix_(order, order)])
    np.testing.assert_array_equal(again, found[np.ix_(order, order)])


def test_few_peaks_and_binary_readings_give_no_lengths():
    few = rolled_over(np.array([0.9]), MIN_PEAKS - 1)
    assert np.isnan(lengths_of(few, chain(2))).all()
    enough = rolled_over(np.array([0.9]), MIN_PEAKS)
    assert np.isfinite(lengths_of(enough, chain(2))).any()
    assert np.isnan(lengths_of(enough > 0, chain(2))).all()
