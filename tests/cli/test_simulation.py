"""Commands of simulation: recordings, pictures and faults."""

import numpy as np
import pytest

import anisomap
from anisomap.simulation import find_body
from command_line import write_layout

pytest.importorskip("mujoco", reason="needs the extra 'simulation'")

PNG = b"\x89PNG"


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


def test_text_of_a_simulation_is_mapped_and_scored_by_itself(run):
    body = "hexagon -s rubbing --sensors 72 --frames 400"
    run(f"simulate {body} -o run.npz")
    assert "cannot store distances along the surface" in run(f"simulate {body} -o run.txt").err
    binary, text = anisomap.read("run.npz"), anisomap.read("run.txt")
    np.testing.assert_array_equal(text.readings, binary.readings)
    np.testing.assert_array_equal(text.positions, binary.positions)
    np.testing.assert_array_equal(text.normals, binary.normals)
    assert (text.names, text.units) == (binary.names, binary.units)
    run("map run.txt -d 2 -m r-anisomap --no-verdict -o map.csv")
    by_text, by_binary = (run(f"score map.csv {file}").out for file in ("run.txt", "run.npz"))
    assert by_text.splitlines()[1:] == by_binary.splitlines()[1:]
    run("repair run.txt -o mended.txt")
    np.testing.assert_array_equal(anisomap.read("mended.txt").positions, binary.positions)


def test_the_positions_of_a_robot_part_become_a_body(run, tmp_path):
    places = 0.2 * find_body("sphere", 41).positions
    names = [f"n{i}" for i in range(len(places))]
    write_layout(tmp_path / "sensors.csv", places, names, "name,x,y,z")
    anisomap.write(anisomap.SensorMap(places), tmp_path / "points.ply")
    for body in ("sensors.csv", "points.ply"):
        run(f"simulate {body} -s rubbing --frames 3 -o out.npz")
        recording = anisomap.read("out.npz")
        np.testing.assert_allclose(recording.positions, places, atol=1e-5)
        if body == "sensors.csv":
            assert list(recording.names) == names
