"""Detectors of systematic errors fire where they must, and are silent where they must be."""

import math
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.footprints import FOOTPRINTS
from hypothesis import given, settings
from hypothesis import strategies as st

import anisomap
from anisomap import reconstruct
from anisomap.diagnosis import Evidence, judge
from anisomap.diagnosis.diagnostics import collect_evidence
from anisomap.diagnosis.doubts import compare_with_other_maps, extent_in_spacings, systematic_doubts
from anisomap.diagnosis.verdict import TYPICAL
from anisomap.evaluation.scoring import spacing_variation
from anisomap.health import Finding
from anisomap.numerics.reliability.blending import blended_correlation
from skins import flat_skin, lattice

pytestmark = pytest.mark.filterwarnings("ignore::anisomap.AnisomapWarning")


def sizes(doubts):
    return {doubt.kind: doubt.size for doubt in doubts}


def touched(kind, seed=0, n_frames=2000, places=None):
    """Return a recording of a flat lattice that is touched in one of the ways of the benchmark."""
    places = lattice(8, 9) if places is None else places
    solid = np.column_stack([places, np.zeros(len(places))])
    readings = FOOTPRINTS[kind](solid, n_frames, np.random.default_rng(seed))
    return anisomap.Recording(readings, positions=places, rate_hz=20.0)


@pytest.fixture(scope="module")
def skin():
    return flat_skin(n_frames=1000)


def others(skin, positions):
    return compare_with_other_maps(skin.readings, positions, blended_correlation(skin.readings))


def test_true_positions_agree_with_other_maps_and_wrong_ones_do_not(skin):
    truth = skin.positions
    right = others(skin, truth)
    assert max(right.paths, right.even) < 0.5
    folded = np.column_stack([np.abs(truth[:, 0] - truth[:, 0].mean()), truth[:, 1]])
    thin = truth * [4, 1]
    exchanged = truth[np.random.default_rng(0).permutation(len(truth))]
    for wrong in (folded, thin, exchanged):
        found = others(skin, wrong)
        assert min(found.paths, found.even) > 2 * max(right.paths, right.even)
        error = anisomap.align(wrong, truth).rms / anisomap.evaluation.median_spacing(wrong)
        assert max(found.paths, found.even) > error / 2


def test_differences_of_maps_do_not_depend_on_frame_scale_and_order(skin):
    rng = np.random.default_rng(1)
    truth, order = skin.positions, rng.permutation(skin.n_sensors)
    right = others(skin, truth)
    turned = 3 * truth @ np.linalg.qr(rng.normal(size=(2, 2)))[0] + 7
    again = compare_with_other_maps(
        skin.readings[:, order],
        turned[order],
        blended_correlation(skin.readings[:, order]),
    )
    assert again.paths == pytest.approx(right.paths, abs=0.02)
    assert again.even == pytest.approx(right.even, abs=0.02)


def test_sensors_at_one_place_make_no_map(skin):
    found = others(skin, np.zeros_like(skin.positions))
    assert math.isinf(found.paths)
    assert math.isinf(found.even)


@pytest.mark.parametrize("kind", ["bars-of-all-directions", "regions-in-turn"])
@pytest.mark.slow
def test_contacts_that_are_alike_leave_little_doubt(kind):
    skin = touched(kind)
    evidence = collect_evidence(reconstruct(skin, dimensions=2), skin)
    assert math.hypot(*sizes(evidence.doubts).values()) < 0.25
    assert judge(evidence).level == "usable"


@pytest.mark.parametrize("kind", ["bars", "grasp", "unlike-sizes"])
@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.slow
def test_contacts_that_are_long_or_differ_between_places_raise_doubts(kind, seed):
    skin = touched(kind, seed)
    made = reconstruct(skin, dimensions=2)
    true = anisomap.score(made, skin.positions, permutations=0)
    assert true.rms_in_spacings > 0.8, "the map is not wrong"
    evidence = collect_evidence(made, skin)
    assert math.hypot(*sizes(evidence.doubts).values()) > 0.35
    assert judge(evidence).level != "usable"


@pytest.mark.parametrize(
    ("body", "n_sensors", "fires"), [("tube", 70, True), ("sphere", 60, False)]
)
def test_a_map_that_is_too_short_in_one_direction_raises_a_doubt(body, n_sensors, fires):
    # A flat surface touches a tube along lines, and a sphere at points.
    skin = anisomap.simulate(body, "pressing", n_sensors=n_sensors, n_frames=1000, seed=401)
    made = reconstruct(skin, dimensions=3)
    true = anisomap.score(made, skin.positions, permutations=0)
    assert (true.rms_in_spacings > 1) is fires
    evidence = collect_evidence(made, skin)
    assert (sizes(evidence.doubts)["spacing"] > 0.3) is fires
    assert (judge(evidence).level == "usable") is not fires


@settings(deadline=None)
@given(st.floats(0, 0.9), st.integers(0, 100))
def test_the_variation_of_spacings_is_that_of_pairs(spread, seed):
    # Pairs of sensors far apart: each is the nearest neighbour of the other.
    gaps = 1 + spread * np.random.default_rng(seed).choice([-1, 1], 20)
    starts = 10.0 * np.arange(20)
    places = np.concatenate([starts, starts + gaps])[:, None]
    assert spacing_variation(3 * places + 1) == pytest.approx(gaps.std() / gaps.mean(), abs=1e-9)


@pytest.mark.parametrize(
    ("repeatability", "halves", "level"),
    [
        (0.1, 0.1, "usable"),
        (0.3, 0.1, "usable"),
        (0.1, 1.0, "usable locally"),
        (0.1, 2.0, "not usable"),
        (0.1, math.inf, "not usable"),
    ],
)
def test_fits_that_end_in_different_maps_raise_doubts(skin, repeatability, halves, level):
    doubts = systematic_doubts(
        anisomap.SensorMap(skin.positions),
        readings=skin.readings,
        similarity=blended_correlation(skin.readings),
        repeatability=repeatability,
        halves=halves,
    )
    verdict = judge(Evidence(repeatability, 2.0, 2, doubts))
    assert verdict.level == level
    assert verdict.expected_error >= max(repeatability, TYPICAL * halves) * (1 - 1e-9)
    assert any("halves" in reason for reason in verdict.reasons) is (halves > repeatability)


@pytest.mark.parametrize("share", [0.05, 0.2])
def test_the_doubt_about_copies_is_the_error_that_they_make(skin, share):
    rng = np.random.default_rng(2)
    n_copies = round(share * skin.n_sensors)
    squares = []
    for _ in range(20):
        chosen = rng.permutation(skin.n_sensors)[: 2 * n_copies]
        wrong = skin.positions.copy()
        wrong[chosen[:n_copies]] = wrong[chosen[n_copies:]]
        squares.append(anisomap.align(wrong, skin.positions).rms ** 2)
        spacing = anisomap.evaluation.median_spacing(skin.positions)
        names = tuple(skin.names[i] for i in chosen)
        found = Finding("copies", names, share, "share", "copies", "wrong", mendable=True)
        doubts = systematic_doubts(anisomap.SensorMap(skin.positions, names=skin.names), [found])
    expected = sizes(doubts)["copies"] * spacing
    assert 0.8 < expected / np.sqrt(np.mean(squares)) < 1.3


@pytest.mark.parametrize(
    ("kind", "level"),
    [
        ("clock-jitter", "usable"),
        ("few-contacts", "usable"),
        ("hum", "usable locally"),
        ("drift", "usable locally"),
        ("one-period", "not usable"),
    ],
)
@pytest.mark.slow
def test_faults_that_are_found_limit_the_level(kind, level):
    skin = touched("bars-of-all-directions")
    made = reconstruct(skin, dimensions=2)
    fault = Finding(kind, (), 1.0, "", "a fault", "a wrong map", mendable=False)
    assert judge(collect_evidence(made, skin, [fault])).level == level


def test_several_components_and_distortions_raise_doubts():
    places = lattice(5, 8)
    apart = anisomap.SensorMap(places, component=np.repeat([0, 1], [20, 20]))
    assert "components" in sizes(systematic_doubts(apart))
    pieces = anisomap.SensorMap(places, component=np.repeat([0, 1, 2, 3], 10))
    evidence = Evidence(0.0, 2.0, 2, systematic_doubts(pieces))
    assert judge(evidence).level == "not usable"
    assert judge(replace(evidence, doubts=systematic_doubts(apart))).level == "usable locally"
    bent = anisomap.SensorMap(places, uneven=True)
    assert judge(Evidence(0.0, 2.0, 2, systematic_doubts(bent))).level == "usable locally"
    assert systematic_doubts(anisomap.SensorMap(places)) == ()


def test_the_extent_is_in_spacings():
    assert extent_in_spacings(7 * lattice(6, 6)) == pytest.approx(extent_in_spacings(lattice(6, 6)))
    assert math.isinf(extent_in_spacings(np.zeros((4, 2))))
