"""Sampling variance of correlations, blocks that resample them, and significant links."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist, pdist, squareform

from anisomap.errors import InputError
from anisomap.evaluation import mantel
from anisomap.method.evidence import Evidence
from anisomap.numerics.graph.dissimilarity import direct_dissimilarity
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.reliability.sampling_noise import (
    MAX_BLOCKS,
    MIN_BLOCKS,
    Blend,
    balanced_weights,
    blended_correlation,
    block_edges,
    correlation_time,
    group_sensors,
    remove_insignificant_links,
    sampling_variance,
    significant_links,
    standardised_correlation,
    thinning,
    typical_variance,
    without_slow_changes,
)
from anisomap.numerics.scaling.multidimensional_scaling import torgerson
from anisomap.numerics.similarity.contact_agreement import Contacts, contact_agreement
from anisomap.numerics.similarity.correlation import pearson, resampled_correlation
from anisomap.recording import Recording
from skins import flat_skin


def autoregressive(n_frames, n_sensors, coefficient, seed=0):
    """Independent sensors whose frames are an AR(1) process."""
    noise = np.random.default_rng(seed).normal(size=(n_frames, n_sensors))
    for t in range(1, n_frames):
        noise[t] += coefficient * noise[t - 1]
    return noise


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.9])
def test_the_variance_is_that_of_correlations_of_unrelated_series(memory):
    n_frames = 3000
    found = [autoregressive(n_frames, 40, memory, seed) for seed in range(3)]
    observed = np.mean([pearson(x)[np.triu_indices(40, 1)].var() for x in found])
    estimated = np.mean([typical_variance(sampling_variance(x)) for x in found])
    assert estimated == pytest.approx(observed, rel=0.2)
    # Closed form for two autoregressive series of memory a: (1 + a^2) / (1 - a^2) / T.
    assert estimated == pytest.approx((1 + memory**2) / (1 - memory**2) / n_frames, rel=0.2)


def test_the_variance_does_not_depend_on_the_frame_rate():
    x = autoregressive(2000, 12, 0.8, 0)
    slow, fast = (typical_variance(sampling_variance(y)) for y in (x, np.repeat(x, 4, axis=0)))
    assert fast == pytest.approx(slow, rel=0.1)


@given(st.integers(0, 99))
def test_the_variance_is_symmetric_and_at_least_that_of_independent_frames(seed):
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((60, 5)) * rng.integers(0, 2, 5)
    found = sampling_variance(x)
    np.testing.assert_allclose(found, found.T)
    assert (found >= 1 / 60 - 1e-15).all()
    np.testing.assert_allclose(sampling_variance(7 - 3 * x), found, rtol=1e-6)


@pytest.mark.parametrize(
    ("lag", "noise", "hum"),
    [(20, 0.0, 0), (20, 0.5, 0), (60, 0.1, 0), (60, 0.1, 2), (20, 0, 8.04), (60, 0.1, 16.1)],
)
def test_long_recordings_have_the_variance_of_all_their_frames(lag, noise, hum):
    """Bartlett's sum over all lags, of frames of which `sampling_variance` uses some."""
    rng = np.random.default_rng(lag)
    n_frames, n_sensors = 12_000, 12
    smooth = gaussian_filter1d(rng.standard_normal((n_frames, n_sensors)), lag / 3, axis=0)
    x = smooth / smooth.std() + noise * rng.standard_normal(smooth.shape)
    if hum:  # a sine of this period
        x += np.sin(2 * np.pi * (np.arange(n_frames)[:, None] / hum + rng.uniform(size=n_sensors)))
    centred = x - x.mean(axis=0)
    products = np.array(
        [(centred[: n_frames - lag] * centred[lag:]).sum(axis=0) for lag in range(1000)]
    )
    faded = int(np.argmax(np.median(products / products[0], axis=1) < 0.1))
    assert correlation_time(x) == pytest.approx(faded, rel=0.1, abs=1)
    window = max(10, 2 * correlation_time(x))
    products = products[: window + 1]
    taper = np.where(np.arange(window + 1), 2.0, 1.0) * (1 - np.arange(window + 1) / (window + 1))
    weighted = np.sqrt(taper / n_frames)[:, None] * products / products[0]
    expected = typical_variance(weighted.T @ weighted)
    assert typical_variance(sampling_variance(x)) == pytest.approx(expected, rel=0.05)
    assert typical_variance(sampling_variance(x.astype(np.float32))) == pytest.approx(
        expected, rel=0.05
    )


def test_one_frame_is_rejected():
    with pytest.raises(InputError, match="at least 2 frames"):
        sampling_variance(np.ones((1, 4)))


@pytest.mark.parametrize(
    "statistic", ["pearson", "spearman", "co-activation", "blended-correlation"]
)
@pytest.mark.parametrize("response", ["sparse", "heavy tails"])
def test_the_variance_is_that_of_the_statistic_and_not_of_the_readings(statistic, response):
    """Autocorrelation differs between readings, their ranks and contacts."""
    found = [autoregressive(4000, 30, 0.95, seed) / 3.2 for seed in range(4)]
    respond = {"sparse": lambda x: np.maximum(0, x - 1.3), "heavy tails": lambda x: np.exp(2 * x)}
    readings = [respond[response](x) for x in found]
    pairs = np.triu_indices(30, 1)
    runs = map(Recording, readings)
    computed = [Evidence.of(run, statistic, bins=4, with_variance=True) for run in runs]
    observed = np.mean([one.similarity[pairs].var() for one in computed])
    estimated = np.mean([one.noise for one in computed])
    assert estimated == pytest.approx(observed, rel=0.3)


def test_readings_in_any_memory_order_are_left_alone():
    by_column = np.asfortranarray(np.random.default_rng(0).normal(size=(100, 5)))
    by_column.setflags(write=False)
    expected = sampling_variance(np.ascontiguousarray(by_column))
    np.testing.assert_array_equal(sampling_variance(by_column), expected)


@given(st.integers(8, 500), st.integers(1, 5), st.floats(0, 0.99))
def test_blocks_cover_the_recording(n_frames, n_sensors, coefficient):
    edges = block_edges(autoregressive(n_frames, n_sensors, coefficient))
    assert edges[0] == 0
    assert edges[-1] == n_frames
    assert (np.diff(edges) > 0).all()
    assert min(MIN_BLOCKS, n_frames) <= len(edges) - 1 <= MAX_BLOCKS


def test_blocks_are_longer_for_slower_readings():
    lengths = [np.diff(block_edges(autoregressive(3000, 4, c))).mean() for c in (0.8, 0.95, 0.99)]
    assert lengths == sorted(lengths)
    assert lengths[0] < lengths[1] / 2


@given(st.integers(1, 30), st.integers(1, 30), st.integers(0, 9))
def test_every_block_is_drawn_equally_often(n_blocks, n_resamples, seed):
    weights = balanced_weights(n_blocks, n_resamples, np.random.default_rng(seed))
    assert weights.shape == (n_resamples, n_blocks)
    assert (weights.sum(axis=1) == n_blocks).all()
    assert (weights.sum(axis=0) == n_resamples).all()


@given(st.integers(0, 99), st.sampled_from([4, 9]))
def test_weighted_correlations_are_those_of_repeated_blocks(seed, n_blocks):
    rng = np.random.default_rng(seed)
    readings = rng.normal(size=(60, 5)) + 3
    readings[:, 4] = 2.0
    edges = np.sort(rng.choice(np.arange(1, 60), n_blocks - 1, replace=False))
    edges = np.concatenate([[0], edges, [60]])
    weights = rng.integers(0, 3, (3, n_blocks)).astype(float)
    weights[:, 0] += 1
    found = resampled_correlation(readings, edges, weights)
    for correlation, weight in zip(found, weights.astype(int), strict=True):
        frames = np.repeat(np.arange(60), np.repeat(weight, np.diff(edges)))
        if np.ptp(readings[frames, :4], axis=0).min() > 0:
            np.testing.assert_allclose(correlation, pearson(readings[frames]), atol=1e-5)


def test_equal_weights_give_the_agreement_of_contacts():
    readings = np.random.default_rng(0).random((300, 7)) < 0.4
    edges = np.array([0, 50, 110, 300])
    weights = np.array([[1.0, 1, 1], [2, 2, 2], [1, 0, 3]])
    found = Contacts.of(readings).resampled(edges, weights)
    np.testing.assert_allclose(found[0], contact_agreement(readings), atol=1e-12)
    np.testing.assert_allclose(found[0], found[1], atol=1e-12)
    assert np.abs(found[2] - found[0]).max() > 0.01
    np.testing.assert_array_equal(found[2], found[2].T)


@pytest.mark.parametrize("coefficient", [0.0, 0.9])
def test_resamples_spread_as_independent_recordings_do(coefficient):
    """The variance of correlations of AR(1) sensors is (1 + a^2) / (1 - a^2) / T (Bartlett)."""
    n_frames = 2000
    expected = (1 + coefficient**2) / (1 - coefficient**2) / n_frames
    pairs = np.triu_indices(30, 1)
    found = []
    for seed in range(3):
        readings = autoregressive(n_frames, 30, coefficient, seed)
        edges = block_edges(readings)
        drawn = balanced_weights(len(edges) - 1, 12, np.random.default_rng(seed))
        for step in (1.0, 0.5):
            made = resampled_correlation(readings, edges, 1 + step * (drawn - 1))
            found.append(made[:, *pairs].var(axis=0, ddof=1).mean() / step**2)
    assert np.mean(found) == pytest.approx(expected, rel=0.2)


@pytest.mark.parametrize("coefficient", [0.98, 0.985])
@pytest.mark.parametrize(("noise", "most"), [(0, 1.05), (0.5, 1.2), (1, 1.2)])
def test_thinned_readings_resample_as_all_of_them(coefficient, noise, most):
    pairs, ratios = np.triu_indices(20, 1), []
    for seed in range(3):
        smooth = autoregressive(6000, 20, coefficient, seed)
        readings = smooth / smooth.std()
        readings += noise * np.random.default_rng(9 + seed).standard_normal(smooth.shape)
        step = thinning(readings)
        assert step > 1
        edges = block_edges(readings)
        drawn = balanced_weights(len(edges) - 1, 12, np.random.default_rng(seed))
        every = resampled_correlation(readings, edges, drawn)
        some = resampled_correlation(readings[::step], -(-edges // step), drawn)
        every, some = (found[:, *pairs].var(axis=0, ddof=1).mean() for found in (every, some))
        ratios.append(some / every)
    assert 0.95 < np.mean(ratios) < most


def test_readings_that_fade_at_once_or_slowly_or_oscillate_are_not_thinned():
    assert thinning(autoregressive(3000, 5, 0.5)) == thinning(autoregressive(6000, 5, 0.998)) == 1
    smooth = autoregressive(6000, 5, 0.995)
    phases = np.arange(6000)[:, None] / 8.04 + np.arange(5) / 5
    assert thinning(smooth / smooth.std() + 3 * np.sin(2 * np.pi * phases)) <= 2


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


def test_links_across_a_gap_are_kept_whatever_neighbours_their_sensors_share(short):
    positions, readings = short
    beside = positions[:, 0] != 45
    x, y = positions[beside].T
    followed = significant_links(*links_of(readings[:, beside]))
    for row in range(7):
        assert followed[(x == 44) & (y == row), (x == 46) & (y == row)].all()


def filtered(lengths, similarity, variance):
    related = group_sensors(similarity, variance).related
    return remove_insignificant_links(lengths.copy(), similarity, variance, related)


def test_insignificant_links_shorten_paths_across_the_skin(short):
    positions, readings = short
    similarity, variance = links_of(readings)
    dissimilarity = direct_dissimilarity(similarity, variance)

    def agreement(lengths):
        return mantel(torgerson(metricise(lengths), 2), positions, permutations=0).r

    significant = agreement(filtered(dissimilarity, similarity, variance))
    assert significant > 0.99
    assert significant > agreement(dissimilarity)


def test_components_stay_connected_and_separate():
    readings = np.hstack([strip(2500, seed)[1] for seed in (5, 6)])
    size = readings.shape[1] // 2
    similarity, variance = links_of(readings)
    similarity[:size, size:] = similarity[size:, :size] = 0
    apart = filtered(np.ones_like(similarity), similarity, variance)
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
    apart = squareform(pdist(np.random.default_rng(0).uniform(size=(len(similarity), 2))))
    np.testing.assert_array_equal(filtered(apart, similarity, variance), apart)


def grouped(readings):
    return group_sensors(blended_correlation(readings), sampling_variance(readings))


def test_skins_touched_independently_are_separate_components():
    parted = []
    for seed in range(8):
        first, second = (flat_skin(seed=s).readings for s in (seed, seed + 10))
        both = np.hstack([first, second[:, :25]])
        order = np.random.default_rng(seed).permutation(both.shape[1])
        alone, together, shuffled = (
            grouped(readings).related for readings in (first, both, both[:, order])
        )
        assert not alone.any()
        np.testing.assert_array_equal(shuffled, together[order])
        parted.append(np.array_equal(together, np.repeat([0, 1], [42, 25])))
    assert np.mean(parted) > 0.5


@pytest.mark.parametrize("seed", range(4))
def test_noise_links_few_sensors_and_shows_none_to_be_unrelated(seed):
    noise = np.random.default_rng(seed).standard_normal((2000, 40))
    found = grouped(noise)
    assert np.bincount(found.linked).max() <= 6
    assert not found.related.any()
    assert found.hidden.size >= 34


@pytest.mark.parametrize("noise", [0.5, 1.0, 2.0])
def test_noise_that_hides_links_does_not_part_a_skin(noise):
    readings = flat_skin().readings
    found = grouped(readings + np.random.default_rng(0).normal(0, noise, readings.shape))
    assert not found.related.any()


def test_a_sensor_of_noise_alone_is_parted_from_a_skin_with_clear_links():
    readings = np.array(flat_skin().readings)
    readings[:, 7] = np.random.default_rng(0).normal(size=len(readings))
    np.testing.assert_array_equal(np.flatnonzero(grouped(readings).related), [7])


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_few_long_contacts_connect_a_skin(seed):
    """A correlation of nearly 1 is clear evidence, though few standard deviations from 0."""
    rng = np.random.default_rng(seed)
    places = np.stack(np.meshgrid(range(8), range(8)), -1).reshape(-1, 2)
    presses = rng.uniform(0, 7, (12, 1, 2))
    depth = np.maximum(0, 3 - np.linalg.norm(presses - places, axis=2))
    course = np.sin(np.linspace(0, np.pi, 100))
    readings = np.concatenate([course[:, None] * press for press in depth])
    readings = readings[:, depth.any(axis=0)]
    assert not grouped(readings).related.any()


def test_drift_of_single_sensors_is_removed_where_it_hides_contacts():
    skin = flat_skin(n_frames=2000)
    touches, positions = np.asarray(skin.readings), np.asarray(skin.positions)
    drift = np.cumsum(np.random.default_rng(1).normal(size=touches.shape), axis=0)
    drifting = touches + drift * (touches.std() / drift.std())
    assert without_slow_changes(touches) is touches
    distance, r = pdist(positions), pearson(without_slow_changes(drifting))
    near = r[np.triu_indices(len(r), 1)]
    assert np.corrcoef(near, distance)[0, 1] < -0.4


def test_noise_does_not_attenuate_correlations_of_slow_changes():
    rng = np.random.default_rng(4)
    slow = autoregressive(4000, 2, 0.998) @ rng.normal(size=(2, 20))
    slow /= slow.std(axis=0)
    noisy = slow + rng.uniform(0.2, 2, 20) * rng.normal(size=slow.shape)
    true = pearson(slow)
    found = Blend.of(noisy)
    assert np.abs(pearson(noisy) - true).max() > 0.6
    assert np.abs(found.similarity - true).max() < 0.25
    (whole,) = found.resampled(np.array([0, 4000]), np.ones((1, 1)))
    np.testing.assert_allclose(whole, found.similarity, atol=1e-3)


@pytest.mark.parametrize("coefficient", [0.0, 0.95])
def test_noise_without_drift_is_left_as_it_is(coefficient):
    noise = autoregressive(2000, 20, coefficient)
    assert without_slow_changes(noise) is noise
