"""Commands of simulation: recordings, pictures, faults, coverage and lists."""

import sys

import numpy as np
import pytest

import anisomap
from anisomap.simulation import injected_faults
from command_line import write_layout

pytest.importorskip("mujoco", reason="needs the extra 'simulation'")

PNG, GIF = b"\x89PNG", b"GIF8"


def test_a_body_is_simulated_and_drawn(run, tmp_path):
    setting = "--frames 60 --seed 3 -p n_balls=60 -p speed=4"
    outcome = run(f"simulate sphere {setting} -o run.npz --picture run.png")
    recording = anisomap.read("run.npz")
    assert recording.readings.shape == (60, 60)
    stated = {"n_balls": 60, "speed": 4, "seed": 3}
    assert stated.items() <= dict(recording.metadata).items()
    assert recording.normals is not None
    assert recording.surface_distances is not None
    again = anisomap.simulate("sphere", n_frames=60, seed=3, n_balls=60, speed=4)
    np.testing.assert_array_equal(recording.readings, again.readings)
    assert (tmp_path / "run.png").read_bytes().startswith(PNG)
    for said in ("energy drift", "run.npz", "run.png", "anisomap map run.npz"):
        assert said in outcome.out


@pytest.mark.parametrize("renderer", ["drawing", pytest.param("mujoco", marks=pytest.mark.slow)])
def test_a_run_is_drawn_as_an_animation(run, tmp_path, renderer):
    pictures = f"--picture run.png --video run.gif --renderer {renderer}"
    outcome = run(f"simulate plane -s rubbing --frames 3 {pictures}")
    assert (tmp_path / "run.png").read_bytes().startswith(PNG)
    assert (tmp_path / "run.gif").read_bytes().startswith(GIF)
    assert not outcome.err or "drawing instead" in outcome.err


@pytest.mark.slow
def test_several_runs_have_consecutive_seeds(run):
    run("simulate plane -s rubbing --sensors 25 --frames 30 --seed 5 --runs 2")
    for seed in (5, 6):
        recording = anisomap.read(f"plane-rubbing-{seed}.npz")
        expected = anisomap.simulate("plane", "rubbing", n_sensors=25, n_frames=30, seed=seed)
        np.testing.assert_array_equal(recording.readings, expected.readings)
        assert dict(recording.metadata) == dict(expected.metadata)


@pytest.mark.slow
def test_a_robot_part_with_its_sensors_becomes_a_recording(run, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    part = trimesh.creation.icosphere(subdivisions=2, radius=0.2)
    part.export(tmp_path / "part.stl")
    places = np.asarray(part.vertices[::4])
    names = [f"n{i}" for i in range(len(places))]
    write_layout(tmp_path / "sensors.csv", places, names, "name,x,y,z")
    anisomap.write(anisomap.SensorMap(places), tmp_path / "points.ply")  # and no mesh
    for body in (
        "part.stl --sensors sensors.csv",
        "part.stl --sensors 41",
        "sensors.csv",
        "points.ply",
    ):
        run(f"simulate {body} --frames 3 -o out.npz")
        recording = anisomap.read("out.npz")
        assert recording.n_sensors == 41
        if "sensors.csv" in body:
            assert list(recording.names) == names
            np.testing.assert_allclose(recording.positions, places, atol=1e-5)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems always have a screen")
def test_without_a_screen_the_view_warns_and_the_recording_is_written(run, tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    outcome = run("simulate", "sphere", "--frames", "3", "--view")
    assert "needs a display" in outcome.err
    assert (tmp_path / "sphere-bombardment.npz").exists()


def test_injected_faults_are_documented_in_the_file(run, skin_npz):
    faults = "-f dead:s1,s2 -f saturating:10%,level=2 -f dropped-frames:share=0.2"
    outcome = run(f"spoil skin.npz -o bad.npz --seed 4 {faults}")
    whole, spoilt = anisomap.read(skin_npz), anisomap.read("bad.npz")
    done = injected_faults(spoilt)
    assert [fault.sensor for fault in done if fault.kind == "dead"] == ["s1", "s2"]
    assert sum(fault.kind == "saturating" for fault in done) == round(0.1 * whole.n_sensors)
    assert 0.7 * whole.n_frames < spoilt.n_frames < 0.9 * whole.n_frames
    for said in ("dead", "s1, s2", "dropped-frames", "bad.npz"):
        assert said in outcome.out
    assert "dead" in run("info", "bad.npz").out


@pytest.mark.slow
def test_a_coverage_curve_is_printed_written_and_drawn(run, tmp_path):
    setting = "--sensors 20 --runs 2 -m r-anisomap --frames 50 --frames 800"
    outcome = run(f"coverage sphere {setting} -o curve.csv --picture curve.png")
    rows = (tmp_path / "curve.csv").read_text().splitlines()
    assert rows[0].startswith("frames,seconds,sensors touched")
    assert [row.split(",")[0] for row in rows[1:]] == ["50", "800"]
    touched = [float(row.split(",")[2].rstrip("%")) for row in rows[1:]]
    assert 0 < touched[0] <= touched[1] <= 100
    assert np.isfinite(float(rows[2].split(",")[4]))
    assert (tmp_path / "curve.png").read_bytes().startswith(PNG)
    assert "neighbours touched together" in outcome.out
