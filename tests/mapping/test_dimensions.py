"""The number of dimensions of a map: chosen from readings, given, or not clear."""

from functools import cache

import numpy as np
import pytest

import anisomap
from anisomap import Recording, reconstruct, reconstruct_from
from anisomap.errors import AnisomapWarning, InputError
from anisomap.estimators import SensorMapper
from anisomap.large import reconstruct_approximately, reconstruct_chunks
from anisomap.simulation import simulate
from skins import flat_map, flat_skin, quietly, stored

LOOKS_FLAT, UNCLEAR = "this looks flat", "whether the skin is flat"


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


def test_a_body_that_rolls_is_not_flat():
    # Its contacts are lines across the path, which make the metric look flat.
    skin = stored("rolling-columns-1")
    made = quietly(reconstruct, skin)
    assert made.dimensions == 3
    assert any(UNCLEAR in note for note in made.notes)
    assert not any(LOOKS_FLAT in note for note in quietly(reconstruct, skin, dimensions=3).notes)


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
    assert quietly(reconstruct_chunks, skin.readings).dimensions == 2
    assert quietly(reconstruct_chunks, skin.readings, "r-anisomap").dimensions == 2
    unclear = quietly(reconstruct_chunks, skin.readings, "i-anisomap")  # has no correlation
    assert unclear.dimensions == 3
    assert any(UNCLEAR in note for note in unclear.notes)
    approximate = quietly(reconstruct_approximately, skin.readings)
    assert approximate.dimensions == 3
    assert any(UNCLEAR in note for note in approximate.notes)
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
    with pytest.raises(InputError, match="dimensions must be a whole number of at least 1, or aut"):
        reconstruct(flat_skin(), dimensions=dimensions)


@pytest.mark.parametrize(
    ("name", "expected"),
    [("icub_hexagon", {2}), ("icub_palm", {2}), ("plantar", {2, "not clear"})],
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
