"""The number of dimensions: of a metric, and of a map, chosen from readings or given."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import pdist, squareform
from scipy.stats import special_ortho_group

import anisomap
from anisomap import Recording, reconstruct, reconstruct_from
from anisomap.errors import AnisomapWarning, InputError
from anisomap.estimators import SensorMapper
from anisomap.method.dimensions import choose_dimensions
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.similarity.information import mutual_information
from anisomap.simulation import simulate
from skins import flat_map, flat_skin, quietly

LOOKS_FLAT, UNCLEAR = "the map looks flat", "whether the skin is flat"


@cache
def body(name, scenario="rubbing", **settings):
    return simulate(name, scenario, n_frames=1000, seed=11, **settings)


def test_a_flat_skin_is_mapped_as_with_2_dimensions():
    skin = flat_skin()
    chosen, given = reconstruct(skin), flat_map()
    np.testing.assert_array_equal(chosen.positions, given.positions)
    assert chosen.notes == given.notes == ()
    assert chosen.provenance["chosen_dimensions"] == 2
    assert "sheet of paper" in chosen.provenance["dimensions_because"]
    assert chosen.provenance["elbow_3"] < chosen.provenance["elbow_2"]
    assert "chosen_dimensions" not in given.provenance


def test_a_sphere_is_mapped_as_with_3_dimensions():
    skin = body("sphere")
    chosen, given = reconstruct(skin), reconstruct(skin, dimensions=3)
    np.testing.assert_array_equal(chosen.positions, given.positions)
    assert chosen.notes == given.notes
    assert chosen.provenance["chosen_dimensions"] == 3


def test_half_a_sphere_is_not_flat():
    assert quietly(reconstruct, body("hemisphere"), "r-anisomap").dimensions == 3


def test_a_given_number_is_kept_and_a_flat_skin_in_3_dimensions_is_noted():
    skin = flat_skin()
    with pytest.warns(AnisomapWarning, match=LOOKS_FLAT):
        made = reconstruct(skin, dimensions=3)
    assert made.dimensions == 3
    published = reconstruct(skin, "r-anisomap", dimensions=3)
    assert published.notes == ()  # the paper's methods are left as they are
    assert quietly(reconstruct, body("sphere"), dimensions=2).dimensions == 2


def test_sensors_along_a_line_are_noted():
    places, touches = np.arange(30.0), np.random.default_rng(0).uniform(0, 29, (2000, 1))
    made = quietly(reconstruct, np.maximum(0, 3 - abs(touches - places)))
    assert made.dimensions == 2
    assert any("along a line" in note for note in made.notes)


def test_every_method_chooses_by_the_same_metric():
    for skin, expected in ((flat_skin(), 2), (body("sphere"), 3)):
        for method in ("r-anisomap", "i-anisomap"):
            made = quietly(reconstruct, skin, method)
            assert made.dimensions == expected
            assert made.provenance["chosen_dimensions"] == expected


def test_few_sensors_are_mapped_in_3_dimensions_with_a_note():
    skin = flat_skin()
    made = quietly(reconstruct, skin.select(np.arange(6)))
    assert made.dimensions == 3
    assert any(UNCLEAR in note for note in made.notes)


def test_other_ways_to_a_map_choose_as_well():
    skin = flat_skin()
    similarity = np.corrcoef(skin.readings.T)
    for method in ("covariogram", "r-anisomap"):
        made = quietly(reconstruct_from, similarity=similarity, method=method)
        assert made.dimensions == 2
    information = mutual_information(skin.readings)  # is no correlation
    unclear = quietly(reconstruct_from, similarity=information, method="i-anisomap")
    assert unclear.dimensions == 3
    assert any(UNCLEAR in note for note in unclear.notes)
    mapper = SensorMapper("auto")
    assert quietly(mapper.fit, skin.readings).positions_.shape == (42, 2)
    assert mapper.get_feature_names_out().shape == (2,)
    points = skin.positions[:, :2]
    metric = np.linalg.norm(points[:, None] - points, axis=2)
    assert quietly(reconstruct_from, metric=metric).dimensions == 2
    started = quietly(reconstruct_from, metric=metric, start=np.pad(points, ((0, 0), (0, 1))))
    assert started.dimensions == 3


@pytest.mark.parametrize("dimensions", [0, -1, 1.5, "flat", None])
def test_other_numbers_are_refused(dimensions):
    with pytest.raises(InputError, match="dimensions must be auto or a whole number above 0"):
        reconstruct(flat_skin(), dimensions=dimensions)


@pytest.mark.parametrize(
    ("name", "expected"), [("icub_hexagon", {2}), ("icub_palm", {2}), ("plantar", {2, "not clear"})]
)
def test_real_flat_skins(recordings_folder, name, expected):
    assert chosen_for(anisomap.read(recordings_folder / f"{name}.npz")) in expected


@pytest.mark.parametrize(
    ("name", "expected"), [("nao_head", {3, "not clear"}), ("retina_stacy", {2, "not clear"})]
)
def test_hard_recordings(hard_recordings_folder, name, expected):
    assert chosen_for(anisomap.read(hard_recordings_folder / f"{name}.npz")) in expected


def chosen_for(recording):
    made = quietly(reconstruct, Recording(recording.readings, names=recording.names))
    return "not clear" if any(UNCLEAR in note for note in made.notes) else made.dimensions


seeds = st.integers(0, 10_000)


def plane(rng, n=40):
    return np.column_stack([rng.uniform(0, 3, n), rng.uniform(0, 2, n), np.zeros(n)])


def sphere(rng, n=40):
    points = rng.normal(size=(n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def line(rng, n=40):
    return np.outer(rng.uniform(0, 10, n), [1.0, 0.0, 0.0])


SHAPES = {"plane": (plane, 2), "sphere": (sphere, 3), "line": (line, 2)}


def distances(points, rng=None, noise=0.0):
    lengths = pdist(points)
    if noise:
        lengths = lengths * np.exp(rng.normal(0, noise, len(lengths)))
    return squareform(lengths)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_plane_line_and_sphere_are_told_apart(shape, noise):
    make, expected = SHAPES[shape]
    for seed in range(5):
        rng = np.random.default_rng(seed)
        found = choose_dimensions(metricise(distances(make(rng), rng, noise)))
        assert bool(found.shown)
        assert found.dimensions == expected
        assert found.line == (shape == "line")


@pytest.mark.parametrize("noise", [0.0, 0.03])
def test_a_strip_of_three_rows_is_no_line(noise):
    across, along = np.meshgrid(np.arange(3.0), np.arange(16.0))
    points = np.column_stack([along.ravel(), across.ravel()])
    for seed in range(5):
        rng = np.random.default_rng(seed)
        assert not choose_dimensions(metricise(distances(points, rng, noise))).line


@settings(max_examples=15)
@given(seed=seeds, shape=st.sampled_from(sorted(SHAPES)), unit=st.floats(1e-6, 1e6))
def test_neither_rotation_order_nor_unit_matters(seed, shape, unit):
    rng = np.random.default_rng(seed)
    points = SHAPES[shape][0](rng)
    found = choose_dimensions(distances(points))
    turned = unit * (points @ special_ortho_group.rvs(3, random_state=rng).T + rng.normal(size=3))
    again = choose_dimensions(distances(turned[rng.permutation(len(points))]))
    assert (again.dimensions, bool(again.shown), again.line) == (
        found.dimensions,
        bool(found.shown),
        found.line,
    )


def test_half_a_cylinder_spans_the_dimensions_of_the_sheet_it_is_bent_from():
    # Bending without stretching leaves lengths along the surface unchanged.
    angles, heights = np.meshgrid(np.linspace(0, np.pi, 12), np.linspace(0, 4, 10))
    sheet = np.column_stack([angles.ravel(), heights.ravel()])
    bent = np.column_stack([np.cos(angles.ravel()), np.sin(angles.ravel()), heights.ravel()])
    assert choose_dimensions(distances(sheet)).dimensions == 2
    chords = distances(bent)
    along_the_surface = metricise(np.where(chords < 0.7, chords, 100 * chords))
    assert choose_dimensions(along_the_surface).dimensions == 2
    assert choose_dimensions(chords).dimensions == 3


def test_a_third_dimension_needs_more_evidence_where_the_signal_is_common():
    rng = np.random.default_rng(0)
    flat, round_body = (distances(make(rng, 60), rng, 0.03) for make in (plane, sphere))
    for share in (0.0, 0.5, 0.99):
        found = choose_dimensions(metricise(flat), common_share=share)
        assert (found.dimensions, bool(found.shown)) == (2, True)
    assert choose_dimensions(metricise(round_body), common_share=0.5).shown
    unclear = choose_dimensions(metricise(round_body), common_share=0.99)
    assert (unclear.dimensions, bool(unclear.shown)) == (3, False)


def test_the_elbow_is_the_ratio_of_the_gains_of_two_dimensions():
    rng = np.random.default_rng(0)
    found = choose_dimensions(distances(rng.normal(size=(60, 6))))
    one, two, three, four = found.stress
    assert one > two > three > four
    expected = (two / three) / (three / four)
    assert found.elbow(3) == pytest.approx(expected, rel=0.02)  # up to the floor of the stress
    assert found.dimensions == 3  # of space
    assert not bool(found.shown)


def test_the_largest_component_is_examined():
    rng = np.random.default_rng(0)
    parts = [distances(plane(rng, 40)), distances(sphere(rng, 20))]
    both = np.full((60, 60), np.inf)
    both[:40, :40], both[40:, 40:] = parts
    assert choose_dimensions(both).stress == choose_dimensions(parts[0]).stress


def test_unknown_pairs_are_left_out():
    rng = np.random.default_rng(0)
    lengths = distances(plane(rng, 40))
    weights = np.triu(rng.random((40, 40)) < 0.8, 1).astype(float)
    weights += weights.T
    wrong = squareform(rng.uniform(1, 50, 40 * 39 // 2))
    found = choose_dimensions(np.where(weights > 0, lengths, wrong), weights)
    assert bool(found.shown)
    assert found.dimensions == 2


def test_few_points_show_nothing():
    rng = np.random.default_rng(0)
    found = choose_dimensions(distances(plane(rng, 7)))
    assert (found.dimensions, bool(found.shown), found.stress) == (3, False, ())
    assert np.isnan(found.elbow(2))
