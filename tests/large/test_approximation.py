"""Approximate maps: agreement with exact maps, reproducibility and labels."""

import numpy as np
import pytest

import anisomap
from anisomap import Recording, mantel, reconstruct
from anisomap.errors import AnisomapWarning, InputError
from anisomap.large import ApproximateOptions, reconstruct_approximately
from anisomap.large.approximation import build_similarity_graph
from skins import lattice, rubbed

PLACES = lattice(15, 16)
READINGS = np.round(rubbed(PLACES, 3000) * 40).astype(np.uint8)
FEW = ApproximateOptions(n_candidates=30, n_landmarks=60)

pytestmark = pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")


def made(readings=READINGS, dimensions=2, **options):
    return reconstruct_approximately(readings, dimensions, **{"approximate": FEW, **options})


@pytest.fixture(scope="module")
def found():
    with pytest.warns(AnisomapWarning, match=r"this map is approximate.* 60 landmarks"):
        return made()


def agreement(found, other):
    return mantel(found, other, permutations=0).r


@pytest.mark.parametrize("dimensions", [2, 3])
def test_approximate_maps_resemble_exact_maps(dimensions):
    exact = reconstruct(Recording(READINGS), "r-anisomap", dimensions)
    approximate = made(dimensions=dimensions)
    assert agreement(approximate, exact) > 0.99
    assert agreement(approximate, PLACES) > agreement(exact, PLACES) - 0.01


def test_the_seed_determines_the_map_and_is_recorded(found):
    np.testing.assert_array_equal(made().positions, found.positions)
    facts = dict(found.provenance)
    assert (found.method, found.approximate) == ("r-anisomap", True)
    assert (facts["approximate_n_landmarks"], facts["approximate_seed"]) == (60, 0)
    assert facts["frames"] == len(READINGS)
    other = made(approximate=ApproximateOptions(n_candidates=30, n_landmarks=60, seed=1))
    assert not np.allclose(other.positions, found.positions)
    assert agreement(other, found) > 0.99


def test_chunk_boundaries_and_the_order_of_sensors_do_not_matter(found):
    parts = made(lambda: np.array_split(READINGS, [5, 700, 701, 2000]))
    assert agreement(parts, found) > 1 - 1e-6
    order = np.random.default_rng(0).permutation(len(PLACES))
    shuffled = made(READINGS[:, order])
    assert agreement(shuffled.positions, found.positions[order]) > 0.99


def test_skins_touched_independently_are_components():
    pause = np.zeros_like(READINGS)
    both = np.vstack([np.hstack([READINGS, pause]), np.hstack([pause, READINGS])])
    with pytest.warns(AnisomapWarning, match="2 separate components"):
        pair = made(both)
    np.testing.assert_array_equal(pair.component, np.repeat([0, 1], len(PLACES)))
    for piece in pair.split():
        assert agreement(piece, PLACES) > 0.98


def test_dead_and_dropped_sensors_are_unplaced_and_broken_wires_separate(monkeypatch):
    monkeypatch.setattr("anisomap.large.approximation.EXCERPT_READINGS", 1)
    readings = READINGS.copy()
    readings[:, 7] = 3
    rng = np.random.default_rng(0)
    readings[:, 50] = np.repeat(rng.integers(0, 60, len(readings) // 60), 60)
    names = [f"pad {i}" for i in range(len(PLACES))]
    skin = made(readings, names=names, drop=["pad 9"])
    np.testing.assert_array_equal(np.flatnonzero(~skin.placed), [7, 9])
    assert skin.health[7] == "silent"
    assert skin.health[50] == "isolated"
    assert skin.component[50] == 1
    assert len(skin.component_sizes) == 2
    assert skin.names == tuple(names)


def test_missing_readings_follow_the_policy():
    readings = READINGS.astype(np.float32)
    readings[100, 3] = np.nan
    with pytest.raises(InputError, match="sensor 3 in frame 100"):
        made(readings)
    expected = made(np.delete(readings, 100, axis=0)).positions
    np.testing.assert_array_equal(made(readings, missing="drop-frames").positions, expected)


@pytest.mark.parametrize(
    ("readings", "options", "message"),
    [
        (np.zeros((50, 9), np.uint8), {}, "got 0 of 9"),
        (list, {}, "no frames"),
        (np.random.default_rng(0).integers(0, 9, (300, 9)), {}, "at least 3 sensors with statist"),
        (READINGS[0], {}, "frames x sensors"),
        (READINGS, {"dimensions": 0}, "dimensions must be a whole number of at least 1"),
    ],
)
def test_what_gives_no_map_is_refused(readings, options, message):
    with pytest.raises(InputError, match=message):
        made(readings, **options)


def test_health_of_many_sensors_is_assessed_from_an_excerpt(monkeypatch):
    monkeypatch.setattr("anisomap.large.approximation.EXCERPT_READINGS", 1)
    found = build_similarity_graph(lambda: np.array_split(READINGS, 40), options=FEW)
    whole = anisomap.assess(Recording(READINGS))
    assert 500 <= found.excerpt.n_frames < len(READINGS)
    assert {sensor.status for sensor in found.health} == {"ok"}
    contacts = [[sensor.contacts for sensor in health] for health in (found.health, whole)]
    at_rest = READINGS[0] == 0
    np.testing.assert_array_equal(*np.array(contacts)[:, at_rest])


def test_mantel_r_of_very_many_sensors_uses_a_sample(found, monkeypatch):
    everyone = anisomap.score(found, PLACES, permutations=0)
    monkeypatch.setattr("anisomap.evaluation.scoring.MAX_ALL_PAIRS", 100)
    monkeypatch.setattr("anisomap.evaluation.scoring.SAMPLED", 90)
    sample = anisomap.score(found, PLACES, permutations=0)
    assert sample.mantel.n_sensors == 90
    assert sample.mantel.r == pytest.approx(everyone.mantel.r, abs=0.01)
    assert sample.rms == everyone.rms
    assert any("90 of the 240 sensors" in note for note in sample.notes)
    assert anisomap.score(found, PLACES, permutations=0).mantel.r == sample.mantel.r
