"""Placing a patch by touching it with another one: simulated robots of two arms."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from benchmarks.placing.self_touch import RADII, SPACING, URDF, simulate
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import special_ortho_group

from anisomap import Recording, SensorMap, reconstruct
from anisomap.errors import InputError
from anisomap.io import read_robot
from anisomap.placement import place_by_self_touch
from anisomap.placement.self_touch import fit_pose


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "robot.urdf"
    path.write_text(URDF)
    return read_robot(path)


@pytest.fixture(scope="module")
def scenes(robot):
    """Scenes by seed, number of contacts and form, simulated once."""
    return cache(lambda *given: simulate(robot, *given))


def off(found, scene):
    return np.linalg.norm(found.map.positions - scene.truth, axis=1) / SPACING


@pytest.mark.parametrize("form", RADII)
def test_a_patch_is_placed_within_a_fraction_of_a_spacing(scenes, form):
    errors, within, astray = [], [], []
    for seed in range(501, 504):
        scene = scenes(seed, 60, form)
        found = place_by_self_touch(scene.shape, scene.touches, scene.other, exact=True)
        errors.append(np.median(off(found, scene)))
        within.append(np.mean(off(found, scene) * SPACING <= found.map.errors))
        astray.append(np.mean(~found.used))
        assert (found.map.frame, found.map.units, found.map.anchored) == ("left", "m", True)
    # Of eight seeds, the medians are 0.06 spacings and 1.
    assert np.median(errors) < 0.2
    assert np.median(within) > 0.7
    assert 0.02 < np.mean(astray) < 0.25


def test_a_patch_of_unknown_positions_is_placed_from_its_map(scenes):
    errors = []
    for seed, form in ((501, "flat"), (502, "curved"), (503, "curved")):
        scene = scenes(seed, 60, form)
        own_map = reconstruct(scene.rubbing, "r-anisomap", dimensions=2)
        found = place_by_self_touch(own_map, scene.touches, scene.other)
        errors.append(np.median(off(found, scene)))
    assert np.median(errors) < 0.5  # 0.13 to 0.19


def test_touches_tell_the_scale_and_the_hand_of_a_map(scenes):
    for seed in (511, 512):
        scene = scenes(seed, 40, "curved")
        for flip in ([1, 1, 1], [-1, 1, 1]):
            shape = SensorMap(170 * scene.shape.positions * flip, names=scene.shape.names)
            found = place_by_self_touch(shape, scene.touches, scene.other)
            assert np.median(off(found, scene)) < 0.5
            assert (found.map.mirrored, found.map.handed) == (flip[0] < 0, True)


@pytest.mark.parametrize("seed", [531, 532])
def test_angles_of_other_postures_are_refused(scenes, seed):
    scene = scenes(seed, 40, "flat")
    order = 2 * np.random.default_rng(seed).permutation(40)
    shuffled = {name: np.repeat(column[order], 2) for name, column in scene.touches.angles.items()}
    wrong = replace(scene.touches, angles=shuffled)
    with pytest.raises(InputError, match="no better than chance"):
        place_by_self_touch(scene.shape, wrong, scene.other, exact=True)


def test_what_does_not_determine_a_pose_is_refused(scenes):
    scene = scenes(541, 20, "flat")
    touches, shape = scene.touches, scene.shape
    still = np.zeros_like(touches.recording.readings)
    still[:, 0] = np.arange(len(still)) % 2
    never = replace(touches, recording=Recording(still, names=touches.recording.names))
    short = replace(touches, angles={k: v[:7] for k, v in touches.angles.items()})
    strangers = replace(shape, names=tuple(f"x{i}" for i in range(60)))
    for known, felt, message in (
        (shape, never, "got 0"),
        (shape, short, "each of 40 frames"),
        (shape, replace(touches, other_link="left"), "no moving joint"),
        (strangers, touches, "sensors of the map or more, got 0"),
        (replace(shape, units="arbitrary"), touches, "unit of length"),
    ):
        with pytest.raises(InputError, match=message):
            place_by_self_touch(known, felt, scene.other, exact=True)


def test_a_pose_does_not_depend_on_gains_zeros_and_durations(scenes):
    scene = scenes(511, 40, "curved")
    touches, recording = scene.touches, scene.touches.recording
    turned = replace(touches, recording=replace(recording, readings=300 - 7 * recording.readings))
    longer = replace(
        touches,
        recording=Recording(np.repeat(recording.readings, 3, axis=0), names=recording.names),
        angles={name: np.repeat(column, 3) for name, column in touches.angles.items()},
    )
    found, same, thrice = (
        place_by_self_touch(scene.shape, given, scene.other, exact=True)
        for given in (touches, turned, longer)
    )
    np.testing.assert_allclose(same.map.positions, found.map.positions, atol=1e-9)
    # A contact that lasts counts once.
    assert len(thrice.frames) == len(found.frames) == 40
    np.testing.assert_allclose(thrice.map.positions, found.map.positions, atol=1e-4)


def touched(seed, count=30):
    """Places on a patch, and the same points in the frame of its link."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, 1, (count, 3)) * [3, 2, 0.5]
    turn = special_ortho_group.rvs(3, random_state=rng)
    return places, places @ turn.T + rng.normal(size=3)


@given(st.integers(0, 10_000))
@settings(max_examples=10)
def test_the_pose_of_an_exact_patch_with_wrong_contacts(seed):
    places, targets = touched(seed)
    wrong = np.arange(0, 30, 5)
    moved = targets.copy()
    moved[wrong] += np.random.default_rng(seed).normal(0, 5, (len(wrong), 3))
    found = fit_pose(places, moved, places)
    np.testing.assert_allclose(found.positions, targets, atol=1e-6)
    assert np.flatnonzero(~found.used).tolist() == wrong.tolist()


def test_errors_of_a_pose_are_as_large_as_stated():
    """The squared error of a point over its variance has the mean 1."""
    ratios = []
    for seed in range(80):
        places, targets = touched(seed)
        noisy = targets + np.random.default_rng(seed).normal(0, 0.05, targets.shape)
        found = fit_pose(places[1:], noisy[1:], places[:1])
        ratios.append(np.sum((found.positions - targets[0]) ** 2) / found.spread[0])
    assert np.mean(ratios) == pytest.approx(1, abs=4 * np.std(ratios) / len(ratios) ** 0.5)


def test_contacts_on_a_line_do_not_determine_a_pose():
    line = touched(1)[0] * [1, 0, 0]
    with pytest.raises(InputError, match="lie on a line"):
        fit_pose(line, line, line)
