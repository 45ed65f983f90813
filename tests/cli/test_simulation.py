"""Commands of simulation: recordings, pictures, faults and lists."""

import os
from pathlib import Path

import numpy as np
import pytest

import anisomap
from anisomap.simulation import BODIES, FAULTS, FRAME_FAULTS, SCENARIOS, injected_faults

pytest.importorskip("mujoco", reason="needs the extra 'simulation'")

PNG, GIF = b"\x89PNG", b"GIF8"


def test_a_body_is_simulated_drawn_and_mapped(run, tmp_path):
    outcome = run(
        *("simulate", "sphere", "--frames", "400", "--seed", "3", "-o", "run.npz"),
        *("--picture", "run.png", "-p", "n_balls=60", "-p", "speed=4"),
    )
    assert outcome.code == 0, outcome.err
    recording = anisomap.read(tmp_path / "run.npz")
    assert recording.readings.shape == (400, 60)
    assert recording.metadata["n_balls"] == 60
    assert recording.metadata["speed"] == 4
    assert recording.metadata["seed"] == 3
    assert recording.normals is not None
    assert recording.surface_distances is not None
    again = anisomap.simulate("sphere", n_frames=400, seed=3, n_balls=60, speed=4)
    np.testing.assert_array_equal(recording.readings, again.readings)
    assert (tmp_path / "run.png").read_bytes().startswith(PNG)
    for said in ("energy drift", "run.npz", "run.png", "anisomap map run.npz"):
        assert said in outcome.out
    mapped = run("map", "run.npz", "-o", "map.csv", "--permutations", "100")
    assert mapped.code == 0
    assert "Mantel r" in mapped.out


def test_a_run_is_drawn_as_an_animation(run, tmp_path):
    outcome = run("simulate", "hexagon", "--frames", "8", "-o", "run.npz", "--video", "run.gif")
    assert outcome.code == 0, outcome.err
    assert (tmp_path / "run.gif").read_bytes().startswith(GIF)


def test_without_an_output_the_recording_is_named_after_body_and_scenario(run, tmp_path):
    assert run("simulate", "plane", "--frames", "20", "--sensors", "25").code == 0
    assert anisomap.read(tmp_path / "plane-bombardment.npz").n_sensors == 25


def test_several_runs_have_consecutive_seeds(run, tmp_path):
    outcome = run("simulate", "sphere", "--frames", "30", "--seed", "5", "--runs", "2")
    assert outcome.code == 0, outcome.err
    for seed in (5, 6):
        recording = anisomap.read(tmp_path / f"sphere-bombardment-{seed}.npz")
        expected = anisomap.simulate("sphere", n_frames=30, seed=seed)
        np.testing.assert_array_equal(recording.readings, expected.readings)
        assert dict(recording.metadata) == dict(expected.metadata)


def test_a_robot_part_with_its_sensors_becomes_a_recording(run, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    part = trimesh.creation.icosphere(subdivisions=3, radius=0.2)
    part.export(tmp_path / "part.stl")
    places = part.vertices[::16]
    rows = [f"n{i},{x},{y},{z}" for i, (x, y, z) in enumerate(places)]
    (tmp_path / "sensors.csv").write_text("name,x,y,z\n" + "\n".join(rows))
    for arguments in (
        ("part.stl", "--sensors", "sensors.csv"),
        ("part.stl", "--sensors", "41"),
        ("sensors.csv",),
    ):
        outcome = run("simulate", *arguments, "--frames", "50", "-o", "out.npz")
        assert outcome.code == 0, outcome.err
        recording = anisomap.read(tmp_path / "out.npz")
        assert recording.n_sensors == 41
        if "sensors.csv" in arguments:
            assert recording.names[:2] == ("n0", "n1")
            np.testing.assert_allclose(recording.positions, places, atol=1e-5)


def test_mujoco_renders_or_warns(run, tmp_path):
    arguments = ("simulate", "sphere", "--frames", "3", "-o", "run.npz", "--renderer", "mujoco")
    outcome = run(*arguments, "--picture", "run.png", "--video", "run.gif")
    assert outcome.code == 0, outcome.err
    assert (tmp_path / "run.png").read_bytes().startswith(PNG)
    assert (tmp_path / "run.gif").read_bytes().startswith(GIF)
    assert not outcome.err or "drawn instead" in outcome.err


@pytest.mark.skipif(
    bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")), reason="a window opens"
)
def test_without_a_screen_the_view_warns_and_the_recording_is_written(run, tmp_path):
    outcome = run("simulate", "sphere", "--frames", "3", "-o", "run.npz", "--view")
    assert outcome.code == 0
    assert "needs a display" in outcome.err
    assert (tmp_path / "run.npz").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["teapot"], "there is no body 'teapot', nor a file of that name; choose from sphere"),
        (["sphere", "-s", "rain"], "there is no scenario 'rain'; choose from bombardment"),
        (["hand", "-s", "locomotion"], "the body hand does not roll"),
        (["sphere", "--frames", "0"], "frames"),
        (["sphere", "--seed", "-1"], "seed"),
        (["sphere", "--sensors", "-4"], "n_sensors must be an integer of at least 1, got -4"),
        (["sphere", "--sensors", "where.csv"], "--sensors must be the number of sensors"),
        (["cylinder", "--sensors", "33"], "multiple of 10, the number of columns"),
        (["cylinder", "--placement", "spiral"], "choose from columns, fibonacci, random"),
        (["sphere", "--placement", "random"], "the body sphere has no option placement"),
        (["missing.stl", "--placement", "random"], "--placement is an option of named bodies"),
        (["sphere", "-p", "n_balls"], "write NAME=VALUE"),
        (["sphere", "-p", "n_balls=many"], "'many' is not a number"),
        (["sphere", "-p", "n_bals=3"], "has no parameter 'n_bals'"),
        (["sphere", "-p", "ball_radius=3"], "do not fit"),
        (["sphere", "-p", "timestep=1"], "timestep must be at most"),
        (["sphere", "-o", "run.csv"], "csv"),
        (["sphere", "-o", "nowhere/run.npz"], "nowhere"),
        (["sphere", "--picture", "run.bmp"], "must end in .png, .svg or .pdf"),
        (["sphere", "--video", "run.avi"], "must end in .gif or .mp4"),
        (["sphere", "--runs", "2", "--picture", "run.png"], "leave out --runs"),
        (["missing.stl"], "there is no file missing.stl"),
    ],
)
def test_invalid_arguments_are_refused_without_output(run, tmp_path, arguments, message):
    outcome = run("simulate", *arguments)
    assert outcome.code == 2
    assert message in " ".join(outcome.err.split())
    assert outcome.err.count("error:") == 1
    assert "Traceback" not in outcome.err
    assert list(tmp_path.iterdir()) == []


def test_injected_faults_are_documented_in_the_file(run, tmp_path, skin_npz):
    outcome = run(
        *("spoil", skin_npz, "-o", "bad.npz", "--seed", "4"),
        *("-f", "dead:s1,s2", "-f", "saturating:10%,level=2", "-f", "dropped-frames:share=0.2"),
    )
    assert outcome.code == 0, outcome.err
    whole, spoilt = anisomap.read(skin_npz), anisomap.read(tmp_path / "bad.npz")
    done = injected_faults(spoilt)
    assert [fault.sensor for fault in done if fault.kind == "dead"] == ["s1", "s2"]
    assert sum(fault.kind == "saturating" for fault in done) == round(0.1 * whole.n_sensors)
    assert 0.7 * whole.n_frames < spoilt.n_frames < 0.9 * whole.n_frames
    for said in ("dead", "s1, s2", "dropped-frames", "bad.npz"):
        assert said in outcome.out
    told = run("info", tmp_path / "bad.npz")
    assert "dead" in told.out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-f", "rusty:s1", "-o", "out.npz"], "there is no fault 'rusty'"),
        (["-f", "dead", "-o", "out.npz"], "needs sensors"),
        (["-f", "dead:s999", "-o", "out.npz"], "there is no sensor 's999'"),
        (["-f", "dead:s1", "-o", "skin.npz"], "write the result to another file"),
        (["-f", "dead:s1", "-o", "out.csv"], "csv"),
    ],
)
def test_invalid_faults_are_refused(run, tmp_path, skin_npz, arguments, message):
    before = skin_npz.read_bytes()
    outcome = run("spoil", skin_npz, *arguments)
    assert outcome.code == 2
    assert message in " ".join(outcome.err.split())
    assert skin_npz.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["skin.npz"]


def test_lists_are_complete(run):
    bodies = run("bodies").out
    assert all(name in bodies for name in BODIES)
    scenarios = run("scenarios").out
    assert all(name in scenarios for name in SCENARIOS)
    faults = run("faults").out
    assert all(name in faults for name in (*FAULTS, *FRAME_FAULTS))
    assert run("scenarios", "rain").code == 2


@pytest.mark.parametrize("name", SCENARIOS)
def test_scenario_parameters_are_listed_with_defaults(run, name):
    told = run("scenarios", name)
    assert told.code == 0
    for parameter, default in vars(SCENARIOS[name].options()).items():
        assert f"{parameter} = {default}" in told.out


def test_point_clouds_are_not_meshes(run, tmp_path):
    sensor_map = anisomap.SensorMap(np.random.default_rng(0).normal(size=(20, 3)))
    anisomap.write(sensor_map, tmp_path / "points.ply")
    outcome = run("simulate", Path("points.ply"), "--frames", "20", "-o", "out.npz")
    assert outcome.code == 0, outcome.err
    assert anisomap.read(tmp_path / "out.npz").n_sensors == 20
