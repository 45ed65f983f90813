"""Checks of layouts: seeded faults are found and right sensors are not flagged."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.skins.corrections import read_corrected
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

import anisomap
from anisomap import InputError, Recording, SensorMap, check_layout
from anisomap.layout import KINDS, find_modules, reading_statistics
from anisomap.layout.explanation import turn_in_words
from anisomap.layout.modules import orientations
from anisomap.placement import modules_by_name, modules_by_size
from skins import lattice, rubbed, triangles

TRUTH = triangles(columns=3)
NAMES = tuple(f"taxel{i}" for i in range(len(TRUTH)))
LAYOUT = SensorMap(TRUTH, names=NAMES, units="mm")
MODULE = 40  # first sensor of a module in the middle


@pytest.fixture(scope="module")
def recording():
    return Recording(rubbed(TRUTH, 2000, seed=400), names=NAMES)


@pytest.fixture(scope="module")
def check(recording):
    """Check layouts of the recording, whose statistics are computed once."""
    statistics = reading_statistics(recording.readings, np.random.default_rng(0))
    return lambda layout, **options: check_layout(
        layout, recording, statistics=statistics, **options
    )


def with_places(sensors, places):
    """Return the layout with the true places of some sensors at others."""
    stated = TRUTH.copy()
    stated[sensors] = TRUTH[places]
    return replace(LAYOUT, positions=stated)


def images(*, reflected):
    inside = np.arange(MODULE, MODULE + 10)
    turned = [one for one in orientations(TRUTH[inside])[1:] if one.fits]
    places = next(one.places for one in turned if one.reflected == reflected)
    return inside, inside[cdist(places, TRUTH[inside]).argmin(axis=1)]


def faults():
    """Return stated layouts, by the kind of finding that each should lead to."""
    run = np.arange(60, 90)
    first, second = np.arange(20, 30), np.arange(110, 120)
    both = np.concatenate([first, second])
    moved = TRUTH.copy()
    patch = np.argsort(np.linalg.norm(TRUTH - TRUTH[75], axis=1))[:9]
    moved[patch] += [4.3, 3.1]
    alone = TRUTH.copy()
    alone[44] = TRUTH[115] + [0.5, 0.3]
    return {
        "swapped": with_places([3, 77], [77, 3]),
        "cycle": with_places([5, 66, 112], [66, 112, 5]),
        "shifted": with_places(run, np.roll(run, -1)),
        "turned": with_places(*images(reflected=False)),
        "mirrored": with_places(*images(reflected=True)),
        "exchanged": with_places(both, np.concatenate([second, first])),
        "moved": replace(LAYOUT, positions=moved),
        "moved alone": replace(LAYOUT, positions=alone),
    }


def test_a_right_layout_is_consistent(check):
    found = check(LAYOUT)
    assert found.consistent
    assert set(found.status) <= {"ok", "not tested"}
    assert found.n_tested > 0.9 * len(TRUTH)
    assert found.corrected.names == NAMES
    np.testing.assert_array_equal(found.corrected.positions, TRUTH)
    assert found.n_modules == 12
    assert np.nanmedian(found.agreement) > 0.3


def test_right_layouts_are_not_flagged_whatever_the_recording():
    for seed in (401, 402):
        found = check_layout(LAYOUT, Recording(rubbed(TRUTH, 1200, seed=seed), names=NAMES))
        assert found.flagged.sum() <= 0.05 * len(TRUTH)


@pytest.mark.parametrize("kind", faults())
def test_each_fault_is_found_and_explained(kind, check):
    stated = faults()[kind]
    wrong = (stated.positions != TRUTH).any(axis=1)
    found = check(stated)
    np.testing.assert_array_equal(found.flagged, wrong)
    error = np.linalg.norm(found.corrected.positions - TRUTH, axis=1)
    assert error.max() < (0.5 if kind.startswith("moved") else 1e-9)
    (finding,) = found.findings
    assert finding.kind == kind.split()[0]
    assert finding.gain > 0
    assert finding.displacement > 0.5
    assert finding.agreement_proposed > finding.agreement_stated or np.isnan(
        finding.agreement_stated
    )
    assert {found.status[i] for i in finding.sensors} == {finding.kind}


def test_every_kind_of_finding_has_a_test():
    others = {"dead", "doubled", "reversed", "overlapping", "contradicting"}
    assert {name.split()[0] for name in faults()} | others == set(KINDS)


def test_several_faults_are_told_apart(check):
    stated = TRUTH.copy()
    for kind in ("turned", "swapped", "exchanged"):
        wrong = faults()[kind].positions
        changed = (wrong != TRUTH).any(axis=1)
        stated[changed] = wrong[changed]
    found = check(replace(LAYOUT, positions=stated))
    assert {finding.kind for finding in found.findings} == {"turned", "exchanged", "swapped"}
    assert len(found.findings) == 3
    np.testing.assert_array_equal(found.corrected.positions, TRUTH)


def test_dead_doubled_and_untouched_sensors(recording):
    readings = np.array(recording.readings)
    readings[:, 33] = 0
    readings[:, 100] = readings[:, 12]
    far = TRUTH[:, 0] > np.quantile(TRUTH[:, 0], 0.9)
    readings[:, far] = 0  # never touched, with neighbours that were not touched either
    found = check_layout(LAYOUT, Recording(readings, names=NAMES))
    kinds = {NAMES[f.sensors[0]]: f.kind for f in found.findings}
    assert kinds["taxel33"] == "dead"
    assert kinds.get("taxel100", kinds.get("taxel12")) == "doubled"
    corner = int(TRUTH[:, 0].argmax())
    assert found.status[corner] == "not tested"
    assert "cannot test" in found.notes[0]
    assert found.n_tested < len(TRUTH)
    np.testing.assert_array_equal(found.corrected.positions, TRUTH)


def test_a_sensor_in_the_place_of_a_dead_one(recording):
    readings = np.array(recording.readings)
    readings[:, 91] = 0
    found = check_layout(with_places([30, 91], [91, 30]), Recording(readings, names=NAMES))
    swapped, dead = found.findings
    assert (swapped.kind, dead.kind) == ("swapped", "dead")
    assert swapped.explanation == (
        "taxel30 and taxel91 have each other's places (taxel91 not tested)"
    )
    assert found.names(dead) == ("taxel91",)
    np.testing.assert_array_equal(found.corrected.positions, TRUTH)


def test_two_sides_that_are_loaded_alike_are_neither_doubled_nor_copies():
    """Even steps on two equal soles, of which no reading shows that they are two."""
    sole = np.array([(x, y, 0) for x in range(4) for y in range(14)], dtype=float)
    frames = np.arange(520)
    step, phase = frames // 40, frames % 40 / 40
    along = np.exp(-(((sole[:, 1] / 13 - (1.4 * phase - 0.2)[:, None]) / 0.22) ** 2))
    across = 1 + 0.3 * np.sin(2.3 * step[:, None] + sole[:, 0])
    load = np.maximum(along * across - 0.1, 0) * (phase < 0.7)[:, None]
    both = Recording(np.hstack([load, load]))
    assert not anisomap.find_faults(both)
    assert not check_layout(np.vstack([sole, np.add(sole, [0, 0, 9])]), both).findings


def test_noise_flags_nobody():
    noise = np.random.default_rng(404).normal(size=(400, len(TRUTH)))
    with pytest.raises(InputError, match=r"0 of 120 .* record more contacts"):
        check_layout(LAYOUT, Recording(noise, names=NAMES))


@pytest.mark.parametrize("share", [0.6, 1.0])
def test_no_sensor_of_a_shuffled_layout_is_flagged(share, check):
    chosen = np.random.default_rng(7).permutation(len(TRUTH))[: int(share * len(TRUTH))]
    found = check(with_places(chosen, np.roll(chosen, 1)))
    assert found.verdict == "rejected"
    assert found.findings == ()
    assert not found.flagged.any()
    assert found.explained < 0.25


def test_right_sensors_among_shuffled_ones_are_not_flagged():
    """Wide contacts: a run of right channels with a few wrong ones agrees better one place on."""
    places = lattice(11, 13)
    chosen = np.random.default_rng(7).permutation(len(places))[: len(places) // 10]
    stated = places.copy()
    stated[chosen] = places[np.roll(chosen, 1)]
    found = check_layout(stated, Recording(rubbed(places, 1500, seed=400, reach=6.0)))
    assert not found.consistent
    assert found.flagged.any()
    assert set(np.flatnonzero(found.flagged)) <= set(chosen)


@given(turns=st.integers(1, 5), seed=st.integers(0, 99))
@settings(max_examples=20)
def test_turns_have_a_direction(turns, seed):
    rng = np.random.default_rng(seed)
    flat, angle = rng.normal(size=(7, 2)), turns * np.pi / 3
    flat -= flat.mean(axis=0)
    turned = flat @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    size = 60 * min(turns, 6 - turns)
    there, back = turn_in_words(flat, turned, size), turn_in_words(turned, flat, size)
    if turns == 3:
        assert there == back == "180 degrees"
        return
    expected = ("counterclockwise", "clockwise") if turns < 3 else ("clockwise", "counterclockwise")
    assert (there, back) == tuple(f"{size} degrees {sense}" for sense in expected)
    frame = np.linalg.qr(rng.normal(size=(3, 3)))[0][:2]
    there, back = (
        turn_in_words(a @ frame, b @ frame, size) for a, b in ((flat, turned), (turned, flat))
    )
    assert there[1:] == back[1:]
    assert {there[0], back[0]} == {"+", "-"}


@pytest.mark.parametrize("hand", [1, -1])
def test_the_frame_of_the_layout_does_not_matter(hand, check):
    turn = np.array([[np.cos(0.7), -hand * np.sin(0.7)], [np.sin(0.7), hand * np.cos(0.7)]])
    stated = faults()["mirrored"]
    found = check(replace(stated, positions=1e-3 * stated.positions @ turn.T + [0.3, -2]))
    assert [finding.kind for finding in found.findings] == ["mirrored"]
    expected = 1e-3 * TRUTH @ turn.T + [0.3, -2]
    np.testing.assert_allclose(found.corrected.positions, expected, atol=1e-12)
    assert check(found.corrected).consistent


def test_sensors_are_matched_by_name_or_by_order(check):
    order = np.random.default_rng(405).permutation(len(TRUTH))
    stated = faults()["swapped"]
    shuffled = check(stated.select(order))
    (finding,) = shuffled.findings
    assert sorted(shuffled.names(finding)) == ["taxel3", "taxel77"]

    unnamed = check(stated.positions)
    assert "matched by order" in unnamed.notes[0]
    assert unnamed.findings[0].sensors.tolist() == [3, 77]

    part = check(stated.select(np.arange(80)))
    assert "sensors of the recording that the layout lacks: 40" in part.notes[0]
    assert [f.kind for f in part.findings] == ["swapped"]


def test_normals_stay_with_the_places(check):
    angle = TRUTH[:, 0] / TRUTH[:, 0].max()
    normals = np.column_stack([np.sin(angle), np.zeros(len(angle)), np.cos(angle)])
    stated = np.arange(len(TRUTH))
    stated[[3, 77]] = stated[[77, 3]]
    in_space = np.column_stack([TRUTH, np.zeros(len(TRUTH))])
    found = check(SensorMap(in_space[stated], names=NAMES, normals=normals[stated]))
    np.testing.assert_array_equal(found.corrected.positions[:, :2], TRUTH)
    np.testing.assert_allclose(found.corrected.normals, normals, atol=1e-12)


def test_modules_can_be_given(check):
    stated = faults()["turned"]
    by_size = modules_by_size(NAMES, 10, first=0)
    assigned = {name: (str(i // 10), None) for i, name in enumerate(NAMES)}
    for modules in (10, by_size, modules_by_name(NAMES, assigned)):
        (finding,) = check(stated, modules=modules).findings
        assert finding.kind == "turned"
        assert "turned by 120 degrees" in finding.explanation


def test_modules_are_found_with_gaps_in_the_numbers():
    # Channels 4 and 9 of 12 have no sensor, as the thermal pads of the iCub's triangles.
    channels = [c for c in range(12) if c not in (4, 9)]
    numbers = [2749 + 12 * (i // 10) + channels[i % 10] for i in range(len(TRUTH))]
    layout = SensorMap(TRUTH, names=[f"taxel{n}" for n in numbers])
    for modules in (None, 12):
        found = find_modules(layout, modules)
        members = [found.members(m).tolist() for m in range(found.n_modules)]
        assert members == np.arange(120).reshape(12, 10).tolist()
    scattered = np.random.default_rng(406).normal(size=(60, 2))
    assert find_modules(SensorMap(scattered)).n_modules == 0


def test_the_same_seed_gives_the_same_result(recording):
    short = Recording(recording.readings[:1200], names=NAMES)
    first, second = (check_layout(faults()["swapped"], short, rng=3) for _ in range(2))
    assert first.status == second.status
    assert first.findings[0].z == second.findings[0].z
    assert "<LayoutCheck: not consistent, 2 of" in repr(first)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda r: (LAYOUT, Recording(r.readings[:30], names=NAMES)), "at least 40 frames"),
        (lambda r: (TRUTH[:30], r), "cannot be matched"),
        (lambda r: (np.zeros_like(TRUTH), r), "same position"),
        (lambda r: (np.hstack([TRUTH, TRUTH]), r), "2 or 3 coordinates"),
        (lambda r: ("layout.csv", r), "must be a SensorMap"),
        (lambda r: (LAYOUT, Recording(np.where(r.readings > 2.5, np.nan, r.readings))), "NaN"),
        (lambda r: (LAYOUT, r, {"n_shifts": 0}), "at least 1"),
        (lambda r: (LAYOUT, r, {"modules": 100}), "size of modules"),
        (
            lambda r: (LAYOUT, r, {"modules": modules_by_size(NAMES[:50], 10, first=0)}),
            "do not fit",
        ),
    ],
)
def test_bad_input_is_refused(recording, change, expected):
    layout, readings, *options = change(recording)
    with pytest.raises(InputError, match=expected):
        check_layout(layout, readings, **dict(*options))


def test_most_electrodes_are_not_moved_for_the_sake_of_one(hard_recordings_folder):
    """Fourteen electrodes of a retina fitted a place without electrodes, next to a single one."""
    whole = anisomap.read(hard_recordings_folder / "retina_macc2.npz")
    near = np.flatnonzero((np.asarray(whole.positions) > [1500, 1000]).all(axis=1))
    part = whole.select(near)
    layout = SensorMap(np.asarray(part.positions), names=part.names, units=part.units)
    assert check_layout(layout, part).consistent


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2001, 2005))
def test_a_moved_patch_flags_no_half_of_a_head(hard_recordings_folder, seed):
    whole = anisomap.read(hard_recordings_folder / "nao_head.npz")
    truth = np.asarray(whole.positions)
    spacing = np.sort(np.linalg.norm(truth[:, None] - truth, axis=2), axis=1)[:, 1].mean()
    rng = np.random.default_rng(seed)
    away = rng.normal(size=3)
    patch = np.argsort(np.linalg.norm(truth - truth[rng.integers(len(truth))], axis=1))[:5]
    stated = truth.copy()
    stated[patch] += rng.uniform(4, 10) * spacing * away / np.linalg.norm(away)
    found = check_layout(SensorMap(stated, names=whole.names), whole)
    assert not np.delete(found.flagged, patch).any()


@pytest.mark.slow
@pytest.mark.parametrize("patch", [(34, 35, 40, 41, 42, 43), (1, 3, 4, 5, 37, 38)])
def test_a_patch_that_is_mirrored_as_one_is_named(recordings_folder, patch):
    """Triangles of the torso, mirrored together about the long axis of the patch."""
    whole = read_corrected(recordings_folder / "icub_torso.npz")
    right = np.asarray(whole.positions)
    inside = np.concatenate([np.arange(10 * module, 10 * module + 10) for module in patch])
    middle = right[inside].mean(axis=0)
    apart = right[inside] - middle
    axis = np.linalg.svd(apart, full_matrices=False)[2][0]
    stated = right.copy()
    stated[inside] = middle + 2 * np.outer(apart @ axis, axis) - apart
    found = check_layout(SensorMap(stated, names=whole.names, units="mm"), whole, modules=12)
    assert {finding.kind for finding in found.findings} == {"mirrored"}
    np.testing.assert_array_equal(np.unique(np.flatnonzero(found.flagged) // 10), patch)


@pytest.mark.slow
def test_the_triangles_of_the_leg_that_were_corrected(recordings_folder):
    """The layout of the iCub's upper leg was shipped with turned triangles for years."""
    pytest.importorskip("mujoco", reason="needs the extra 'simulation'")
    folder = recordings_folder.parent / "geometry"
    if not folder.is_dir():
        pytest.skip("the geometry of the iCub is not here")
    right, shipped = (
        np.load(folder / f"icub_left_leg_upper{end}.npz") for end in ("", "_before_904")
    )
    names = tuple(f"taxel{i}" for i in right["taxel_index"])
    body = anisomap.simulation.body_from_points(right["positions"], names=names, units="m")
    recording = anisomap.simulate(
        body, "rubbing", n_frames=3000, seed=1007, hand_size=0.03, detection_radius=0.006,
        press_depth=0.004,
    )  # fmt: skip
    layout = SensorMap(shipped["positions"], names=names, units="m")
    old = check_layout(layout, recording, modules=12)
    wrong = (np.abs(right["positions"] - shipped["positions"]) > 1e-5).any(axis=1)
    assert {finding.kind for finding in old.findings} == {"turned"}
    modules = set(old.module[old.flagged].tolist())
    assert modules == set(old.module[wrong].tolist())
    np.testing.assert_array_equal(old.flagged, wrong)
    np.testing.assert_allclose(old.corrected.positions, right["positions"], atol=1e-5)


def test_a_consistent_body_without_modules_says_that_their_orientations_were_not_tested():
    recording = anisomap.simulate("sphere", "bombardment", n_frames=1500, seed=5)
    layout = SensorMap(recording.positions, names=recording.names, units="m")
    found = check_layout(layout, recording)
    assert found.consistent
    assert any("no orientations were tested" in note for note in found.notes)
