"""Placing a patch by touching it with another one: simulated robots of two arms."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.self_touch import RADII, SPACING, URDF, simulate

from anisomap import Recording, SensorMap, reconstruct
from anisomap.errors import InputError
from anisomap.io import read_robot
from anisomap.placement import place_by_self_touch


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "robot.urdf"
    path.write_text(URDF)
    return read_robot(path)


def off(found, scene):
    return np.linalg.norm(found.map.positions - scene.truth, axis=1) / SPACING


@pytest.mark.parametrize("form", RADII)
def test_a_patch_of_known_shape_is_placed_within_a_fraction_of_a_spacing(robot, form):
    errors, within, astray = [], [], []
    for seed in range(501, 504):
        scene = simulate(robot, seed, 60, form)
        found = place_by_self_touch(scene.shape, scene.touches, scene.other, exact=True)
        errors.append(np.median(off(found, scene)))
        within.append(np.mean(off(found, scene) * SPACING <= found.map.errors))
        astray.append(np.mean(~found.used))
        assert (found.map.frame, found.map.units, found.map.anchored) == ("left", "m", True)
    assert max(errors) < 0.25
    assert np.mean(within) > 0.75
    assert 0.02 < np.mean(astray) < 0.25


@pytest.mark.parametrize("mirror", [False, True])
def test_touches_tell_the_scale_and_the_hand_of_a_map(robot, mirror):
    for seed in range(511, 514):
        scene = simulate(robot, seed, 40, "curved")
        flip = [-1, 1, 1] if mirror else [1, 1, 1]
        shape = SensorMap(170 * scene.shape.positions * flip, names=scene.shape.names)
        found = place_by_self_touch(shape, scene.touches, scene.other)
        assert np.median(off(found, scene)) < 0.4
        assert (found.map.mirrored, found.map.handed) == (mirror, True)


@pytest.mark.parametrize("form", RADII)
def test_a_patch_of_unknown_positions_is_placed_from_its_map(robot, form):
    errors = []
    for seed in (521,):
        scene = simulate(robot, seed, 60, form)
        found = place_by_self_touch(
            reconstruct(scene.rubbing, dimensions=2), scene.touches, scene.other
        )
        errors.append(np.median(off(found, scene)))
    assert max(errors) < 0.5


def test_angles_of_other_postures_are_refused(robot):
    for seed in range(531, 534):
        scene = simulate(robot, seed, 40, "flat")
        rng = np.random.default_rng(seed)
        order = 2 * rng.permutation(40)
        shuffled = {
            name: np.repeat(column[order], 2) for name, column in scene.touches.angles.items()
        }
        wrong = replace(scene.touches, angles=shuffled)
        with pytest.raises(InputError, match="no better than chance"):
            place_by_self_touch(scene.shape, wrong, scene.other, exact=True)


def test_what_does_not_determine_a_pose_is_refused(robot):
    scene = simulate(robot, 541, 20, "flat")
    still = np.zeros_like(scene.touches.recording.readings)
    still[:, 0] = np.arange(len(still)) % 2
    names = scene.touches.recording.names
    never = replace(scene.touches, recording=Recording(still, names=names))
    with pytest.raises(InputError, match="got 0"):
        place_by_self_touch(scene.shape, never, scene.other, exact=True)
    short = replace(scene.touches, angles={k: v[:7] for k, v in scene.touches.angles.items()})
    with pytest.raises(InputError, match="each of 40 frames"):
        place_by_self_touch(scene.shape, short, scene.other, exact=True)
    with pytest.raises(InputError, match="no moving joint"):
        place_by_self_touch(
            scene.shape, replace(scene.touches, other_link="left"), scene.other, exact=True
        )
    strangers = replace(scene.shape, names=tuple(f"x{i}" for i in range(60)))
    with pytest.raises(InputError, match="sensors of the map or more, got 0"):
        place_by_self_touch(strangers, scene.touches, scene.other, exact=True)
    unscaled = replace(scene.shape, units="arbitrary")
    with pytest.raises(InputError, match="unit of length"):
        place_by_self_touch(unscaled, scene.touches, scene.other, exact=True)


def test_a_pose_does_not_depend_on_gains_and_zeros_of_the_recording(robot):
    scene = simulate(robot, 551, 40, "curved")
    recording = scene.touches.recording
    found, same = (
        place_by_self_touch(
            scene.shape, replace(scene.touches, recording=each), scene.other, exact=True
        )
        for each in (recording, replace(recording, readings=300 - 7 * recording.readings))
    )
    np.testing.assert_allclose(same.map.positions, found.map.positions, atol=1e-9)


def test_a_contact_that_lasts_counts_once(robot):
    scene = simulate(robot, 561, 30, "flat")
    recording = scene.touches.recording
    longer = replace(
        scene.touches,
        recording=Recording(np.repeat(recording.readings, 3, axis=0), names=recording.names),
        angles={name: np.repeat(column, 3) for name, column in scene.touches.angles.items()},
    )
    once, thrice = (
        place_by_self_touch(scene.shape, touches, scene.other, exact=True)
        for touches in (scene.touches, longer)
    )
    assert len(thrice.frames) == len(once.frames) == 30
    np.testing.assert_allclose(thrice.map.positions, once.map.positions, atol=1e-4)
