"""Journeys of `anisomap place`: a map in the frame of the robot."""

import numpy as np
import pytest

import anisomap
from anisomap import io
from command_line import write_layout
from skins import flat_skin, lattice, rubbed, triangles

SPACING = 6.0  # mm, of the lattice of flat_skin in the frame of the robot
TRUTH = SPACING * np.asarray(flat_skin().positions) @ [[0, 1], [-1, 0]] + [100, 40]
ANCHORS = [0, 6, 38, 21]


@pytest.fixture
def skin_map(made, tmp_path):
    """A map, and a file of anchors in the frame of a robot, in mm."""
    sensor_map = anisomap.read_map(made / "map.npz")
    anisomap.write(sensor_map, tmp_path / "map.csv")
    names = [f"s{i}" for i in ANCHORS]
    write_layout(tmp_path / "anchors.csv", TRUTH[ANCHORS], names, "name,x [mm],y [mm]")
    return tmp_path / "map.csv"


@pytest.mark.usefixtures("skin_map")
def test_a_map_is_placed_by_four_anchors_in_every_format(run, tmp_path):
    formats = ("csv", "json", "npz", "urdf", "mjcf", "icub.txt", "ply")
    outputs = [word for suffix in formats for word in ("-o", f"placed.{suffix}")]
    command = "place map.csv --anchors anchors.csv --frame l_forearm --picture placed.png --json"
    found = run(command, *outputs).values
    assert (found["anchored"], found["handed"], found["units"]) == (True, True, "m")
    assert [anchor["sensor"] for anchor in found["anchors"]] == [f"s{i}" for i in ANCHORS]
    for suffix in formats:
        placed = io.read_map(tmp_path / f"placed.{suffix}")
        names = [f"s{i}" if suffix != "icub.txt" else f"taxel{i}" for i in range(len(TRUTH))]
        rows = [placed.names.index(name) for name in names]
        off = np.linalg.norm(placed.positions[rows, :2] - TRUTH / 1000, axis=1)
        assert np.median(off) < 0.4 * SPACING / 1000
    for suffix in ("urdf", "mjcf"):
        assert "error of s1:" in (tmp_path / f"placed.{suffix}").read_text()
    assert "frame: l_forearm" in (tmp_path / "placed.csv").read_text()
    assert (tmp_path / "placed.png").stat().st_size > 10_000


def test_long_tables_say_how_many_rows_they_leave_out(run, tmp_path):
    places = lattice(6, 9)
    anisomap.write(anisomap.SensorMap(places), tmp_path / "map.csv")
    anisomap.write(anisomap.SensorMap(places, units="mm"), tmp_path / "anchors.csv")
    command = "place map.csv --anchors anchors.csv -o placed.csv"
    assert "... and 4 more" in run(command).out
    assert len(run(command, "--json").values["anchors"]) == 54


def test_anchors_on_the_command_line_and_the_default_output(run, skin_map, tmp_path):
    words = []
    for i in ANCHORS:
        words += ["--anchor", f"s{i}={TRUTH[i, 0] / 1000},{TRUTH[i, 1] / 1000}"]
    done = run("place", skin_map, *words)
    assert "residual (mm)" in done.out
    assert io.read_map(tmp_path / "map.placed.csv").anchored


def test_modules_give_millimetres_and_the_hand_without_anchors(run, run_map, tmp_path):
    """Six triangles of ten pads."""
    truth = triangles(columns=3, rows=1)
    names = tuple(f"taxel{i}" for i in range(60))
    anisomap.write(anisomap.Recording(rubbed(truth), names=names), tmp_path / "patch.npz")
    run_map("patch.npz", "-o", "map.csv")
    write_layout(
        tmp_path / "triangle.csv", truth[:10], [f"P{i}" for i in range(10)], "name,x [mm],y [mm]"
    )
    numbers = np.column_stack([np.arange(60) // 10, np.arange(60) % 10])
    write_layout(tmp_path / "modules.csv", numbers, names, "sensor,module,pad")
    modules = "--module-layout triangle.csv"
    run(f"place map.csv {modules} --module-table modules.csv -o placed.csv")
    run(f"place map.csv {modules} --module-size 10 -o by-numbers.csv")
    placed, same = (io.read_map(tmp_path / f"{name}.csv") for name in ("placed", "by-numbers"))
    np.testing.assert_array_equal(same.positions, placed.positions)
    assert placed.handed
    assert not placed.anchored
    free = anisomap.align(io.read_map(tmp_path / "map.csv").positions, truth / 1000)
    rigid = anisomap.align(placed.positions, truth / 1000)
    assert not rigid.reflected
    assert rigid.scale == pytest.approx(1, abs=0.2)
    assert np.median(rigid.errors) < np.median(free.errors)


def test_a_map_lies_on_the_mesh_of_its_part(run, tmp_path):
    """A noisy map of a ball of 60 mm, and its mesh in mm."""
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(2, 60.0)
    ball.export(tmp_path / "part.stl")
    places = np.asarray(ball.triangles_center)[::4] / 1000
    rng = np.random.default_rng(1)
    turned = 40 * (places + rng.normal(0, 0.002, places.shape)) @ [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    anisomap.write(anisomap.SensorMap(turned * [-1, 1, 1]), tmp_path / "map.csv")
    anchors = anisomap.SensorMap(
        places[[3, 20, 41, 70]], names=("s3", "s20", "s41", "s70"), units="m"
    )
    anisomap.write(anchors, tmp_path / "anchors.csv")
    command = "place map.csv --anchors anchors.csv --mesh part.stl"
    done = run(f"{command} --mesh-units mm -o placed.json --picture placed.png")
    assert "on the mesh" in done.out
    placed = io.read_map(tmp_path / "placed.json")
    np.testing.assert_allclose(np.linalg.norm(placed.positions, axis=1), 0.06, rtol=0.04)
    assert np.median(np.linalg.norm(placed.positions - places, axis=1)) < 0.004
    assert "check the unit and frame of the mesh" in run(command, "-o", "far.csv", code=2).err


def test_sensors_worth_measuring_are_suggested(run, skin_map):
    names = run("place", skin_map, "--suggest", 4, "--json").values["suggested"]
    assert len(set(names)) == 4
    chosen = TRUTH[[int(name[1:]) for name in names]]
    assert np.ptp(chosen, axis=0).max() > np.ptp(TRUTH, axis=0).max() / 3
    assert not {"s0", "s6", "s35", "s41"} & set(names)  # the corners
