"""Modules of layouts: injected faults are found, in bent layouts too, and on a real robot."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import anisomap
from anisomap import Recording, SensorMap, check_layout
from anisomap.layout import find_modules, reading_statistics
from anisomap.layout.modules import Mounting
from anisomap.placement import modules_by_size
from skins import lattice, rubbed, triangles

PADS = triangles(columns=1, rows=1)[:10]
TEMPLATE = SensorMap(PADS, names=[f"P{i}" for i in range(10)], units="mm")
TRUTH = triangles(columns=3, rows=2)
NAMES = tuple(f"taxel{i}" for i in range(len(TRUTH)))
MODULES = modules_by_size(NAMES, 10, first=0).with_template(TEMPLATE)
RIGHT = SensorMap(TRUTH, names=NAMES, units="mm")
MOUNTING = Mounting.of(MODULES, TRUTH, "mm")
MIRRORED = [o for o, one in enumerate(MOUNTING.orientations) if one.reflected and one.fits]
BACKWARDS = len(MOUNTING.orientations) - 1
TURNED = [o for o, one in enumerate(MOUNTING.orientations[:BACKWARDS]) if o and not one.reflected]


@pytest.fixture(scope="module")
def statistics():
    return reading_statistics(RECORDING.readings, np.random.default_rng(0))


RECORDING = Recording(rubbed(TRUTH, 2500, seed=430), names=NAMES)


def with_orientations(turns):
    """Return the layout with modules in other orientations at their places."""
    stated = TRUTH.copy()
    for m, turn in turns.items():
        stated[MOUNTING.members[m]] = MOUNTING.places(m, m, turn)
    return replace(RIGHT, positions=stated)


def named(found):
    """Return the modules of which sensors are flagged."""
    return {int(m) for m in found.module[found.flagged]}


@given(data=st.data())
@settings(max_examples=8)
def test_modules_in_any_orientations_are_named_and_restored(data, statistics):
    count = data.draw(st.integers(0, MOUNTING.n_modules))
    chosen = data.draw(st.permutations(range(MOUNTING.n_modules)))[:count]
    turns = {m: data.draw(st.integers(1, 5)) for m in chosen}
    found = check_layout(
        with_orientations(turns), RECORDING, modules=MODULES, statistics=statistics
    )
    assert named(found) == set(turns)
    assert found.consistent == (not turns)
    np.testing.assert_allclose(found.corrected.positions, TRUTH, atol=1e-9)


@pytest.mark.parametrize("turn", range(1, BACKWARDS + 1))
def test_every_orientation_is_named_with_its_angle(turn, statistics):
    """Turns by 60 and 180 degrees map no pads onto pads; the last one reverses the pads."""
    stated = with_orientations({5: turn})
    found = check_layout(stated, RECORDING, modules=MODULES, statistics=statistics)
    (finding,) = found.findings
    assert named(found) == {5}
    np.testing.assert_allclose(found.corrected.positions, TRUTH, atol=1e-9)
    way = MOUNTING.orientations[turn]
    expected = "reversed" if way.backwards else "mirrored" if way.reflected else "turned"
    assert finding.kind == expected
    assert finding.explanation.endswith("pads in reverse order") == way.backwards
    assert finding.certainty == "certain"
    (module,) = finding.modules
    assert module.mirror == way.reflected
    if not way.reflected:
        assert abs(module.angle) == pytest.approx(abs(way.angle), abs=0.1)
    turned = module.new_orientation - module.old_orientation
    assert (turned - module.angle + 180) % 360 == pytest.approx(180, abs=0.2)


@pytest.mark.parametrize("run", [(2, 5), (1, 4)])
def test_modules_in_reverse_order_are_one_finding(run, statistics):
    first, last = run
    stated = TRUTH.copy()
    for m in range(first, last + 1):
        stated[MOUNTING.members[m]] = MOUNTING.places(m, first + last - m, 0)
    layout = replace(RIGHT, positions=stated)
    found = check_layout(layout, RECORDING, modules=MODULES, statistics=statistics)
    (finding,) = found.findings
    assert named(found) == set(range(first, last + 1))
    np.testing.assert_allclose(found.corrected.positions, TRUTH, atol=1e-9)
    if finding.kind == "reversed":  # else the row is a patch that is turned as one
        assert finding.explanation.endswith(f"{last - first + 1} in a row, in reverse order")


@given(seed=st.integers(0, 10_000), count=st.integers(1, 4))
@settings(max_examples=40)
def test_exchanged_pads_do_not_flip_their_module(seed, count):
    rng = np.random.default_rng(seed)
    inside = rng.permutation(10)[: 2 * (count // 2) or 2]
    stated = TRUTH.copy()
    if count % 2:  # with a pad of another module
        stated[[50 + inside[0], 3]] = stated[[3, 50 + inside[0]]]
    else:
        stated[50 + inside] = stated[50 + np.roll(inside, 1)]
    mounting = Mounting.of(MODULES, stated, "mm")
    there = mounting.places(5, 5, 0)
    np.testing.assert_allclose(there, TRUTH[mounting.members[5]], atol=0.2)


def test_modules_on_each_other_are_a_finding(statistics):
    stated = TRUTH.copy()
    far, near = MOUNTING.members[7], MOUNTING.members[0]
    stated[far] += stated[near].mean(axis=0) - stated[far].mean(axis=0) + [0.4, 0.2]
    silent = np.array(RECORDING.readings)
    silent[:, far] = 0
    found = check_layout(
        replace(RIGHT, positions=stated), Recording(silent, names=NAMES), modules=MODULES
    )
    (finding,) = (one for one in found.findings if one.kind == "overlapping")
    assert "adjacent modules of this shape" in finding.explanation
    assert {int(found.module[i]) for i in finding.sensors} <= {0, 7}


def test_a_consistent_layout_names_what_was_not_tested():
    """Patches are moved from ten contacts on."""
    few = Recording(np.asarray(RECORDING.readings)[:300], names=NAMES)
    for recording, told in ((few, True), (RECORDING, False)):
        found = check_layout(RIGHT, recording, modules=MODULES)
        assert found.consistent
        assert "less than 2 to 3 spacings (1.73 and 2.6 mm)" in " ".join(found.notes)
        assert ("moved patches" in " ".join(found.notes)) == told


def test_a_mirrored_patch_is_one_finding(statistics):
    turns = dict.fromkeys(range(4), MIRRORED[0])
    found = check_layout(
        with_orientations(turns), RECORDING, modules=MODULES, statistics=statistics
    )
    (finding,) = found.findings
    assert finding.kind == "mirrored"
    assert finding.explanation.startswith("the 4 modules taxel0 to taxel9, taxel10 to taxel19")
    assert finding.explanation.endswith("of one patch are mirrored in their places")
    assert finding.certainty == "certain"


@pytest.mark.parametrize(
    ("patch", "angle", "hand", "words"),
    [
        ((1, 2, 3, 6, 7, 8), 60, 1, ""),
        ((6, 7, 8, 9), 180, 1, "turned together by 180 degrees"),
        ((7, 8, 9, 10, 11), 0, -1, "mirrored together"),
    ],
)
def test_a_patch_that_is_turned_or_mirrored_as_one_is_one_finding(patch, angle, hand, words):
    recording = Recording(rubbed(TRUTH, 4000, seed=431), names=NAMES)
    inside = np.concatenate([MOUNTING.members[m] for m in patch])
    cos, sin = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    turn = np.array([[cos, -hand * sin], [sin, hand * cos]])
    centre = TRUTH[inside].mean(axis=0)
    stated = TRUTH.copy()
    stated[inside] = (TRUTH[inside] - centre) @ turn.T + centre
    layout = replace(RIGHT, positions=stated)
    found = check_layout(layout, recording, modules=MODULES)
    (finding,) = (one for one in found.findings if one.kind != "dead")
    if 2 * len(patch) == MOUNTING.n_modules:  # one half against the other
        assert finding.kind == "contradicting"
        assert not found.flagged.any()
        assert not found.consistent
        return
    assert named(found) == set(patch)
    assert finding.explanation.endswith(f"of one patch are {words}")
    assert check_layout(found.corrected, recording, modules=MODULES).consistent


def test_that_nothing_tells_how_a_separate_patch_lies_is_said():
    """No contact reaches both patches."""
    second = TRUTH @ np.diag([1, -1]) + [30, 0]
    names = tuple(f"taxel{i}" for i in range(2 * len(TRUTH)))
    modules = modules_by_size(names, 10, first=0).with_template(TEMPLATE)
    readings = np.zeros((5000, len(names)))
    readings[:2500, : len(TRUTH)] = rubbed(TRUTH, 2500, seed=430)
    readings[2500:, len(TRUTH) :] = rubbed(TRUTH, 2500, seed=431)
    layout = SensorMap(np.vstack([TRUTH, second]), names=names, units="mm")
    found = check_layout(layout, Recording(readings, names=names), modules=modules)
    assert found.consistent
    assert "begin with modules taxel120 to taxel129" in " ".join(found.notes)


@pytest.mark.parametrize("turn", [0, *TURNED, MIRRORED[0]])
def test_modules_of_bent_layouts_are_turned_by_the_template(turn, statistics):
    """A layout on a cylinder, whose places are off by a quarter of a spacing besides."""
    radius = 7.0
    rng = np.random.default_rng(431)
    flat = with_orientations({5: turn}).positions
    x, y = flat.T
    bent = np.column_stack([radius * np.sin(x / radius), y, radius * np.cos(x / radius)])
    bent += rng.normal(0, 0.25 / 3**0.5, bent.shape)
    layout = SensorMap(bent, names=NAMES, units="mm")
    found = check_layout(layout, RECORDING, modules=MODULES, statistics=statistics)
    assert named(found) == ({5} if turn else set())
    again = check_layout(found.corrected, RECORDING, modules=MODULES, statistics=statistics)
    assert again.consistent


def test_dead_and_missing_pads_do_not_hide_a_turned_module():
    gone = [52, 57]
    readings = np.array(RECORDING.readings)
    readings[:, 55] = 0
    layout = with_orientations({5: TURNED[0]})
    kept = np.delete(np.arange(len(TRUTH)), gone)
    recording = Recording(readings, names=NAMES)
    found = check_layout(layout.select(kept), recording, modules=MODULES.select(kept))
    kinds = {finding.kind: finding for finding in found.findings}
    assert set(kinds) == {"turned", "dead"}
    assert kinds["turned"].explanation.endswith("(7 of 8 pads tested)")
    fixed = check_layout(found.corrected, recording, modules=MODULES.select(kept))
    assert fixed.consistent
    assert [finding.kind for finding in fixed.findings] == ["dead"]


@pytest.mark.parametrize(("step", "kind"), [(0, "reversed"), (1, "shifted"), (-3, "shifted")])
def test_a_whole_order_is_named(step, kind, statistics):
    everyone = np.arange(len(TRUTH))
    order = np.roll(everyone, -step) if step else everyone[::-1]
    layout = replace(RIGHT, positions=TRUTH[np.argsort(order)])
    found = check_layout(layout, RECORDING, modules=MODULES, statistics=statistics)
    assert [finding.kind for finding in found.findings] == [kind]
    np.testing.assert_array_equal(found.corrected.positions, TRUTH)


def test_the_symmetry_of_a_layout_is_told_and_few_frames_say_nothing():
    grid = np.array([(x, y) for y in range(8) for x in range(12)], dtype=float)
    readings = rubbed(grid, 1500, seed=7)
    for stated in (grid, grid[::-1]):
        found = check_layout(stated, Recording(readings))
        assert found.consistent
        assert "fit the recording equally well: 3" in found.notes[-1]
    for order in (np.arange(96), np.roll(np.arange(96), 3), np.arange(96)[::-1]):
        assert check_layout(grid[order], Recording(readings[:300])).verdict != "consistent"


def test_contacts_in_pairs_flag_nobody():
    """A hand that touches itself: each place always together with the same other one."""
    half = lattice(5, 6)
    readings = rubbed(half, 2500, seed=1)
    found = check_layout(
        np.vstack([half, half * [-1, 1] - [8, 0]]), Recording(np.tile(readings, 2))
    )
    assert found.verdict == "unknown"
    assert not found.findings
    assert "contacts at pairs of places" in found.notes[0]


ROBOT = {
    "icub_torso": {"torso_flat": {"taxel3073", "taxel3121"}, "torso_torso": {"taxel3313"}},
    "icub_torso_A": {"torso_flat": {"taxel3073", "taxel3121"}, "torso_torso": {"taxel3313"}},
    "icub_right_forearm": {
        "forearm_flat": {"taxel1537"},
        "forearm_forearm_mesh": {"taxel1537"},
        "forearm_forearm_nomesh": {"taxel1537"},
    },
    "icub_right_arm": {
        "arm_flat": {f"taxel{n}" for n in (2113, 2305, 1957, 1993)},
        "arm_arm": {"taxel1957", "taxel1969", "taxel1993"},
        "arm_arm_mesh": {"taxel2053", "taxel2113", "taxel2305", "taxel2425"},
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOT)
def test_wrong_triangles_of_a_real_robot_are_named_and_no_other(name, recordings_folder):
    """`docs/robots/icub.md` lists what confirms each of them."""
    robot = recordings_folder.parent / "robot"
    if not robot.is_dir():
        pytest.skip("the layouts of the robot are not here")
    path = robot / f"{name}.npz"
    recording = anisomap.read(path if path.exists() else recordings_folder / f"{name}.npz")
    statistics = reading_statistics(recording.readings, np.random.default_rng(0))
    for layout, wrong in ROBOT[name].items():
        stated = anisomap.read_map(robot / f"{layout}.csv")
        modules = find_modules(stated, 12).with_template(anisomap.read_map(robot / "triangle.csv"))
        found = check_layout(stated, recording, modules=modules, statistics=statistics)
        on_places = [finding for finding in found.findings if finding.kind != "dead"]
        assert {found.names(finding)[0] for finding in on_places} == wrong
        if layout == "torso_flat":
            # As the robot's display states them: from 120 degrees to 0, and from 120 to 240.
            senses = [finding.explanation.split()[-1] for finding in on_places]
            assert senses == ["clockwise", "counterclockwise"]
        again = check_layout(found.corrected, recording, modules=modules, statistics=statistics)
        assert {finding.kind for finding in again.findings} <= {"dead", "overlapping"}


@pytest.mark.slow
def test_the_display_of_a_real_robot_is_corrected_as_its_later_revision(recordings_folder):
    robot = recordings_folder.parent / "robot"
    if not robot.is_dir():
        pytest.skip("the layouts of the robot are not here")
    recording = anisomap.read(robot / "icub_right_forearm.npz")
    stated = anisomap.read_map(robot / "right_forearm.ini")
    later = anisomap.read_map(robot / "right_forearm_V2.ini")
    template = anisomap.read_map(robot / "triangle.csv")
    found = check_layout(
        stated, recording, modules=find_modules(stated, 12).with_template(template)
    )
    assert "matched by number, such as b0.t0.k0 to taxel1537" in found.notes[0]
    first, ours = later.select(np.arange(10)), found.corrected.select(np.arange(10))
    assert ours.names == first.names
    np.testing.assert_allclose(
        ours.positions - ours.positions.mean(axis=0),
        first.positions - first.positions.mean(axis=0),
        atol=1e-2,
    )
