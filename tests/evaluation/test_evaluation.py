"""Mantel r, alignment, neighbourhoods, diagnostics of scaling: closed forms and oracles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import procrustes
from scipy.spatial.distance import pdist, squareform
from scipy.stats import ortho_group, pearsonr

from anisomap import Recording, SensorMap
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation import align, compare_maps, mantel, neighbour_agreement, score
from skins import lattice, moved_freely

seeds = st.integers(0, 10_000)


def cloud(n=20, k=3, seed=0):
    return np.random.default_rng(seed).normal(size=(n, k))


def test_mantel_r_is_pearson_r_of_the_pairs_and_its_null_relabels_sensors():
    a, b = cloud(6), cloud(6, seed=1)
    found = mantel(a, b, permutations=30, rng=3)
    assert found.r == pytest.approx(pearsonr(pdist(a), pdist(b)).statistic, abs=1e-12)
    rng = np.random.default_rng(3)
    for r in found.null:
        order = rng.permutation(6)
        assert r == pytest.approx(pearsonr(pdist(a[order]), pdist(b)).statistic, abs=1e-5)
    assert found.quantiles()[0.5] == pytest.approx(np.median(found.null))
    from_distances = mantel(squareform(pdist(a)), squareform(pdist(b)), permutations=0)
    assert from_distances.r == pytest.approx(found.r)
    square = cloud(4, 4)  # positions all the same
    assert score(SensorMap(square), square, permutations=0).mantel.r == pytest.approx(1)


def test_the_p_value_includes_the_identity():
    a = cloud(30)
    assert mantel(a, a, permutations=99).p_value == pytest.approx(0.01)
    ps = [mantel(cloud(10, seed=s), cloud(10, seed=s + 100), permutations=99).p_value
          for s in range(60)]  # fmt: skip
    # Unrelated configurations give p values spread over (0, 1): the mean of 60 is within 4 errors.
    assert np.mean(ps) == pytest.approx(0.5, abs=4 * (1 / 12 / 60) ** 0.5)


@given(seeds)
@settings(max_examples=10)
def test_scores_are_invariant_under_similarity_transforms(seed):
    truth = cloud(12)
    still = truth + cloud(12, seed=1) / 4
    moved = moved_freely(still, np.random.default_rng(seed))
    assert mantel(moved, truth, permutations=0).r == pytest.approx(
        mantel(still, truth, permutations=0).r, abs=1e-9
    )
    assert align(moved, truth).rms == pytest.approx(align(still, truth).rms, abs=1e-9)
    assert neighbour_agreement(moved, truth) == neighbour_agreement(still, truth)


@given(seeds, st.sampled_from([2, 3]))
@settings(max_examples=15)
def test_alignment_inverts_a_similarity_transform_also_of_other_points(seed, k):
    points, rng = cloud(20, k), np.random.default_rng(seed)
    truth = moved_freely(points, rng)
    found = align(points[:8], truth[:8])
    assert found.rms < 1e-9
    assert found.scale == pytest.approx(3)
    turn = ortho_group.rvs(k, random_state=np.random.default_rng(seed))
    assert found.reflected == (np.linalg.det(turn) < 0)
    np.testing.assert_allclose(found.apply(points), truth, atol=1e-9)
    np.testing.assert_array_equal(found.apply(points[:8]), found.aligned)
    in_space = align(points[:8], np.pad(truth[:8], ((0, 0), (0, 1))))
    np.testing.assert_allclose(in_space.apply(points)[:, :k], truth, atol=1e-9)
    with pytest.raises(InputError, match=f"at most {k} columns"):
        found.apply(np.zeros((3, k + 1)))


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e200, -1.7e308])
def test_a_sensor_that_cannot_be_aligned_is_named(wrong):
    truth = lattice(4, 5)
    moved = truth.copy()
    moved[3, 1] = wrong
    for pair in ((moved, truth), (truth, moved)):
        with pytest.raises(InputError, match=r"s3 is at .* out of range"):
            align(*pair)
    if np.isfinite(wrong):
        for compare in (score, compare_maps):
            with pytest.raises(InputError, match=r"s3 is at .* out of range"):
                compare(SensorMap(truth), SensorMap(moved))


def test_alignment_is_as_good_as_scipys():
    a, b = cloud(seed=4), cloud(seed=5)
    b_centred = b - b.mean(axis=0)
    _, _, disparity = procrustes(b, a)
    found = align(a, b)
    assert (found.errors**2).sum() == pytest.approx(disparity * (b_centred**2).sum())
    rebuilt = found.scale * a @ found.rotation.T + found.translation
    np.testing.assert_allclose(rebuilt, found.aligned, atol=1e-12)
    np.testing.assert_allclose(found.rotation @ found.rotation.T, np.eye(3), atol=1e-12)


def test_flat_and_spatial_configurations_can_be_compared():
    flat = lattice()
    lifted = np.column_stack([flat, np.zeros(len(flat))])
    for a, b in [(flat, lifted), (lifted, flat), (lifted * [1, -1, 1], flat)]:
        found = align(a, b)
        assert found.rms < 1e-9
        assert not found.reflected  # a flat skin turned over is its own mirror image
    assert align(flat * [1, -1], flat).reflected


LATTICES = {
    "triangular": lattice(),
    "square": np.stack(np.meshgrid(range(7), range(5)), axis=-1).reshape(-1, 2) * 1.0,
    "cubic": np.stack(np.meshgrid(range(4), range(4), range(3)), axis=-1).reshape(-1, 3) * 1.0,
    "rings": np.array([
        [np.cos(angle), np.sin(angle), height]
        for height in np.arange(5) * 0.5 for angle in 2 * np.pi * np.arange(12) / 12
    ]),
    "two points": np.repeat([[0.0, 0.0], [1.0, 0.0]], 9, axis=0),
}  # fmt: skip


@pytest.mark.parametrize("points", LATTICES.values(), ids=LATTICES)
@given(seed=seeds, n_neighbours=st.integers(1, 12))
@settings(max_examples=8)
def test_ties_of_distance_are_ties(points, seed, n_neighbours):
    rng = np.random.default_rng(seed)
    turned = moved_freely(points, rng)
    assert neighbour_agreement(turned, points, n_neighbours=n_neighbours) == pytest.approx(1)
    order = rng.permutation(len(points))
    renumbered = neighbour_agreement(turned[order], points[order], n_neighbours=n_neighbours)
    assert renumbered == pytest.approx(1)
    # A map with errors has no ties; turning or renumbering it must not change its score either.
    noisy, other = points + rng.normal(0, 0.3, points.shape), rng.normal(size=points.shape)
    for places in (noisy, other, points[order]):
        once = neighbour_agreement(places, points, n_neighbours=n_neighbours)
        assert 0 <= once <= 1
        for again in (
            neighbour_agreement(places, turned, n_neighbours=n_neighbours),
            neighbour_agreement(places[order], turned[order], n_neighbours=n_neighbours),
        ):
            assert again == pytest.approx(once)


def test_a_small_error_breaks_no_ties():
    points = LATTICES["square"]
    noise = np.random.default_rng(0).normal(0, 0.02, points.shape)
    assert neighbour_agreement(points + noise, points, n_neighbours=6) == 1


def test_without_ties_neighbours_are_those_of_a_sorted_distance_matrix():
    x, y = cloud(30, seed=1), cloud(30, seed=2)
    near = [np.argsort(squareform(pdist(p)), axis=1)[:, 1:7].tolist() for p in (x, y)]
    expected = np.mean([len(set(a) & set(b)) / 6 for a, b in zip(*near, strict=True)])
    assert neighbour_agreement(x, y) == pytest.approx(expected)


def test_a_collapsed_map_keeps_no_more_neighbours_than_chance():
    truth = cloud(40, 2)
    assert neighbour_agreement(np.zeros((40, 2)), truth) == pytest.approx(6 / 39)
    halves = np.repeat([[0.0, 0.0], [1.0, 1.0]], 20, axis=0)
    assert 0 <= neighbour_agreement(halves, truth, n_neighbours=3) <= 1


def noisy_map(seed=0, **fields):
    flat = np.column_stack([lattice(), np.zeros(42)])
    return SensorMap(moved_freely(flat, np.random.default_rng(seed)), **fields)


def test_a_score_notes_sensors_that_are_not_compared():
    positions = np.array(noisy_map().positions)
    component = np.zeros(42, int)
    positions[0], component[0] = np.nan, -1
    component[1:3] = 1
    truth = lattice()
    truth[5] = np.nan
    found = score(SensorMap(positions, component=component), truth, exclude=[7])
    np.testing.assert_array_equal(found.sensors, np.setdiff1d(np.arange(42), [0, 1, 2, 5, 7]))
    for reason in ("no position", "excluded", "outside the largest", "no known true position"):
        assert any(reason in note for note in found.notes)
    assert found.mantel.r == pytest.approx(1)
    assert found.rms < 1e-9


def test_error_in_spacings_is_the_error_over_the_spacing():
    truth = 4 * lattice()
    noise = np.random.default_rng(0).normal(size=truth.shape)
    found = score(SensorMap(truth + noise), truth, permutations=0)
    assert found.spacing == pytest.approx(4)
    assert found.rms_in_spacings == pytest.approx(found.rms / 4)
    assert found.rms == pytest.approx(np.sqrt(2), rel=0.2)


def test_the_scale_of_a_map_is_compared_where_both_have_units():
    truth = cloud(k=2)
    centred = truth - truth.mean(axis=0)
    found = score(
        SensorMap(moved_freely(truth, np.random.default_rng(3), 1390), units="mm"),
        SensorMap(truth, units="m"),
    )
    assert found.rms == pytest.approx(0, abs=1e-9)
    assert found.scale == pytest.approx(1.39)
    assert found.rigid_rms == pytest.approx(0.39 * np.sqrt((centred**2).sum(axis=1).mean()))
    assert np.isnan(score(SensorMap(truth), SensorMap(truth, units="m")).scale)


def test_maps_are_matched_by_name_and_else_by_order():
    names = [f"pad {i}" for i in range(42)]
    order = np.random.default_rng(0).permutation(42)
    truth = SensorMap(lattice()[order], names=[names[i] for i in order], units="mm")
    by_name = score(noisy_map(names=names), truth, permutations=0)
    assert by_name.mantel.r == pytest.approx(1)
    assert by_name.units == "mm"
    with pytest.warns(AnisomapWarning, match="matched by order"):
        by_order = score(noisy_map(), truth, permutations=0)
    assert by_order.mantel.r < 0.5
    assert "by order" in by_order.notes[0]
    with pytest.raises(InputError, match="share no sensor name"):
        score(noisy_map(), truth.select(range(10)))


@pytest.mark.parametrize(
    ("first", "second", "message"),
    [
        (cloud(5), cloud(6), "must be equal, got 5 and 6"),
        (cloud(3), cloud(3), "at least 4"),
        (np.zeros((5, 2)), cloud(5), "all distances are equal"),
        (np.full((5, 2), np.nan), cloud(5), "must be finite"),
        (np.triu(np.ones((5, 5))), cloud(5), "symmetric with a zero diagonal"),
        (np.zeros(5), cloud(5), "expected positions"),
    ],
)
def test_incomparable_configurations_are_refused(first, second, message):
    with pytest.raises(InputError, match=message):
        mantel(first, second)


@pytest.mark.parametrize("seed", range(3))
def test_identical_permutations_count_in_the_p_value(seed):
    points = cloud(5, seed=seed)
    found = mantel(points + cloud(5, seed=seed + 50) / 100, points, permutations=5000)
    # One labelling in 5! = 120 is the true one, and none is better; its r is rounded differently.
    assert found.p_value == pytest.approx(1 / 120, rel=0.5)


def test_a_recording_with_positions_is_a_truth():
    truth = cloud(12, 2)
    made = SensorMap(truth)
    found = score(made, Recording(np.eye(12), positions=truth, units="mm"), permutations=9)
    assert found.mantel.r == pytest.approx(1)
    assert found.units == "mm"
    assert len(repr(found)) < 150
    assert len(repr(found.mantel)) < 80
    with pytest.raises(InputError, match="no true positions"):
        score(made, Recording(np.eye(12)))
    with pytest.raises(InputError, match="takes a SensorMap first"):
        score(truth, truth)
