"""Journeys of `anisomap place`: a map in the frame of the robot."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from benchmarks import self_touch

import anisomap
from anisomap import io
from skins import flat_skin

SPACING = 6.0  # mm, of the lattice of flat_skin in the frame of the robot


@pytest.fixture
def skin_map(flat_map, tmp_path):
    """A map, and a file with the true positions in the frame of a robot, in mm."""
    recording = flat_skin()
    anisomap.write(recording, tmp_path / "skin.npz")
    anisomap.write(flat_map, tmp_path / "map.csv")
    truth = SPACING * np.asarray(recording.positions) @ [[0, 1], [-1, 0]] + [100, 40]
    rows = [f"{n},{x},{y}" for n, (x, y) in zip(recording.names, truth, strict=True)]
    (tmp_path / "truth.csv").write_text("name,x [mm],y [mm]\n" + "\n".join(rows) + "\n")
    chosen = [rows[i] for i in (0, 6, 38, 21)]
    (tmp_path / "anchors.csv").write_text("name,x [mm],y [mm]\n" + "\n".join(chosen) + "\n")
    return tmp_path / "map.csv"


def test_a_map_is_placed_by_four_anchors_in_every_format(run, skin_map, tmp_path):
    formats = ("csv", "json", "npz", "urdf", "mjcf", "icub.txt", "ply", "pcd", "launch.xml")
    outputs = [word for suffix in formats for word in ("-o", f"placed.{suffix}")]
    done = run("place", skin_map, "--anchors", "anchors.csv", "--frame", "l_forearm",
               "--picture", "placed.png", "--json", *outputs)  # fmt: skip
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert (found["anchored"], found["handed"], found["units"]) == (True, True, "m")
    assert [anchor["sensor"] for anchor in found["anchors"]] == ["s0", "s6", "s38", "s21"]
    truth = io.read_map(tmp_path / "truth.csv").positions / 1000
    for suffix in formats[:-1]:
        placed = io.read_map(tmp_path / f"placed.{suffix}")
        names = [f"s{i}" if suffix != "icub.txt" else f"taxel{i}" for i in range(len(truth))]
        rows = [placed.names.index(name) for name in names]
        off = np.linalg.norm(placed.positions[rows, :2] - truth, axis=1)
        assert np.median(off) < 0.4 * SPACING / 1000
    errors = io.read_map(tmp_path / "placed.npz").errors
    assert np.mean(off <= errors) > 0.8
    for suffix in ("urdf", "mjcf", "launch.xml"):
        assert "error of s1:" in (tmp_path / f"placed.{suffix}").read_text()
    assert "frame: l_forearm" in (tmp_path / "placed.csv").read_text()
    assert (tmp_path / "placed.png").stat().st_size > 10_000


def test_long_tables_say_how_many_rows_they_leave_out(run, tmp_path):
    places = np.stack(np.meshgrid(range(8), range(8)), -1).reshape(-1, 2).astype(float)
    anisomap.write(anisomap.SensorMap(places), tmp_path / "map.csv")
    anisomap.write(anisomap.SensorMap(places, units="mm"), tmp_path / "anchors.csv")
    placing = ["place", "map.csv", "--anchors", "anchors.csv", "-o", "placed.csv"]
    assert "... and 14 more" in run(*placing).out
    assert len(json.loads(run(*placing, "--json").out)["anchors"]) == 64


def test_a_mesh_needs_an_extra(run, skin_map, tmp_path, monkeypatch):
    (tmp_path / "part.stl").write_bytes(b"solid part")
    monkeypatch.setitem(sys.modules, "trimesh", None)
    done = run("place", skin_map, "--anchors", "anchors.csv", "--mesh", "part.stl", "-o", "p.csv")
    assert done.code == 2
    assert "reading a mesh needs an extra: pip install 'anisomap[simulation]'" in done.err
    assert not (tmp_path / "p.csv").exists()


def test_anchors_on_the_command_line_and_the_default_output(run, skin_map, tmp_path):
    rows = (tmp_path / "anchors.csv").read_text().splitlines()[1:]
    words = []
    for row in rows:
        name, x, y = row.split(",")
        words += ["--anchor", f"{name}={float(x) / 1000},{float(y) / 1000}"]
    done = run("place", skin_map, *words)
    assert done.code == 0, done.err
    assert "residual (mm)" in done.out
    other = run("place", skin_map, "--anchor", "nobody=0.1,0.2", "-o", "other.csv")
    assert (other.code, "nobody is no sensor of the map" in other.err) == (2, True)
    placed = io.read_map(tmp_path / "map.placed.csv")
    assert placed.anchored
    again = run("place", "map.placed.csv", *words, "-o", "again.csv")
    assert again.code == 2
    assert "in the frame of the robot already" in again.err
    assert run("convert", "map.placed.csv", "other.csv", "--mirror").code == 2
    assert run("convert", "map.placed.csv", "other.csv", "--spacing", "6mm").code == 2
    assert not (tmp_path / "other.csv").exists()


def test_modules_give_millimetres_and_the_hand_without_anchors(run, run_map, tmp_path):
    """The hexagonal patch of the paper: six triangles of ten pads."""
    recording = anisomap.simulate("hexagon", "rubbing", n_frames=1500, seed=310)
    anisomap.write(recording, tmp_path / "patch.npz")
    assert run_map("patch.npz", "-d", 2, "-o", "map.csv").code == 0
    truth = np.asarray(recording.positions)[:, :2]
    rows = "".join(f"P{i},{1000 * x},{1000 * y}\n" for i, (x, y) in enumerate(truth[:10]))
    (tmp_path / "triangle.csv").write_text("name,x [mm],y [mm]\n" + rows)
    listed = "".join(f"{name},{i // 10},{i % 10}\n" for i, name in enumerate(recording.names))
    (tmp_path / "modules.csv").write_text("sensor,module,pad\n" + listed)
    words = ("--module", "triangle.csv", "--modules", "modules.csv")
    done = run("place", "map.csv", *words, "-o", "placed.csv", "--json")
    assert done.code == 0, done.err
    placed = io.read_map(tmp_path / "placed.csv")
    assert placed.handed
    assert not placed.anchored
    free = anisomap.align(io.read_map(tmp_path / "map.csv").positions, truth)
    rigid = anisomap.align(placed.positions, truth)
    assert not rigid.reflected
    assert rigid.scale == pytest.approx(1, abs=0.1)
    assert np.median(rigid.errors) < np.median(free.errors)


def test_three_anchors_with_normals_tell_the_hand(run, tmp_path):
    """A mirrored map of half a ball, and anchors from a layout that states normals."""
    rng = np.random.default_rng(2)
    outward = rng.normal(size=(60, 3))
    outward[:, 2] = np.abs(outward[:, 2])
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    anisomap.write(anisomap.SensorMap(7 * outward * [-1, 1, 1]), tmp_path / "map.csv")
    rows = np.linspace(0, 59, 3).astype(int)
    names = tuple(f"s{i}" for i in rows)
    for file, normals in (("bare.npz", None), ("anchors.npz", outward[rows])):
        layout = anisomap.SensorMap(
            0.05 * outward[rows], names=names, units="m", anchored=True, normals=normals
        )
        anisomap.write(layout, tmp_path / file)
    refused = run("place", "map.csv", "--anchors", "bare.npz", "-o", "placed.csv")
    assert (refused.code, "normals of the anchors" in refused.err) == (2, True)
    assert not (tmp_path / "placed.csv").exists()
    done = run("place", "map.csv", "--anchors", "anchors.npz", "-o", "placed.csv")
    assert done.code == 0, done.err
    placed = io.read_map(tmp_path / "placed.csv").positions
    np.testing.assert_allclose(placed, 0.05 * outward, atol=1e-6)


def test_a_map_lies_on_the_mesh_of_its_part(run, tmp_path):
    """A noisy map of a ball of 60 mm, and its mesh in mm."""
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(2, 60.0)
    ball.export(tmp_path / "part.stl")
    places = np.asarray(ball.triangles_center)[::4] / 1000
    rng = np.random.default_rng(1)
    turned = 40 * (places + rng.normal(0, 0.002, places.shape)) @ [[0, 0, 1], [1, 0, 0], [0, 1, 0]]
    sensor_map = anisomap.SensorMap(turned * [-1, 1, 1])
    anisomap.write(sensor_map, tmp_path / "map.csv")
    anchors = anisomap.SensorMap(
        places[[3, 20, 41, 70]], names=("s3", "s20", "s41", "s70"), units="m"
    )
    anisomap.write(anchors, tmp_path / "anchors.csv")
    done = run("place", "map.csv", "--anchors", "anchors.csv", "--mesh", "part.stl",
               "--mesh-units", "mm", "-o", "placed.json", "--picture", "placed.png")  # fmt: skip
    assert done.code == 0, done.err
    assert "on the mesh" in done.out
    placed = io.read_map(tmp_path / "placed.json")
    np.testing.assert_allclose(np.linalg.norm(placed.positions, axis=1), 0.06, rtol=0.04)
    outward = places / np.linalg.norm(places, axis=1, keepdims=True)
    assert np.median(np.einsum("nd,nd->n", placed.normals, outward)) > 0.95
    assert np.median(np.linalg.norm(placed.positions - places, axis=1)) < 0.004
    far = run("place", "map.csv", "--anchors", "anchors.csv", "--mesh", "part.stl", "-o", "far.csv")
    assert far.code == 2
    assert "check the unit and frame of the mesh" in far.err
    odd = run("place", "map.csv", "--anchors", "anchors.csv", "--mesh", "map.csv", "-o", "far.csv")
    assert odd.code == 2


def test_sensors_worth_measuring_are_suggested(run, skin_map):
    done = run("place", skin_map, "--suggest", 4, "--json")
    names = json.loads(done.out)["suggested"]
    assert len(set(names)) == 4
    truth = io.read_map(skin_map.parent / "truth.csv")
    edge = np.ptp(truth.positions, axis=0).max()
    chosen = truth.positions[truth.indices(names)]
    assert np.ptp(chosen, axis=0).max() > edge / 3
    assert not {"s0", "s6", "s35", "s41"} & set(names)  # the corners


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "nothing places the map"),
        (["--anchor", "s1=1"], "is not an anchor"),
        (["--anchor", "s1=0,0", "--anchor", "s2=0,0,0"], "all anchors must have two coordinates"),
        (["--anchor", "sx=0,0", "--anchor", "s2=0,1"], "anchor sx is no sensor of the map"),
        (["--anchors", "missing.csv"], "missing.csv"),
        (["--anchors", "anchors.csv", "-o", "anchors.csv"], "anchors.csv"),
        (["--anchors", "anchors.csv", "-o", "x.unknown"], "unknown suffix"),
        (["--anchors", "anchors.csv", "--module", "anchors.csv"], "either --modules"),
        (["--module-size", "5"], "modules need the positions of their pads"),
        (["--module", "anchors.csv", "--module-size", "40", "--module-first", "0"], "no such pad"),
        (["--spacing", "6"], "is not a length"),
    ],
)
def test_what_cannot_be_placed_is_one_message(run, skin_map, tmp_path, arguments, message):
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    done = run("place", skin_map, *arguments)
    assert done.code == 2
    assert message in done.err
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.fixture
def two_arms(tmp_path):
    """Files of a robot that touches one patch with another, and the truth."""
    pytest.importorskip("defusedxml")
    (tmp_path / "robot.urdf").write_text(self_touch.URDF)
    scene = self_touch.simulate(io.read_robot(tmp_path / "robot.urdf"), 561, 40, "flat")
    anisomap.write(scene.touches.recording, tmp_path / "touches.npz")
    anisomap.write(scene.rubbing, tmp_path / "patch.npz")
    anisomap.write(scene.shape, tmp_path / "shape.csv")
    anisomap.write(scene.other, tmp_path / "other.csv")
    angles = np.column_stack(list(scene.touches.angles.values()))
    header = ",".join(scene.touches.angles)
    np.savetxt(tmp_path / "joints.csv", angles, delimiter=",", header=header, comments="")
    turned = angles * np.where(np.arange(6) < 5, 180 / np.pi, 1)  # the last joint slides
    np.savetxt(tmp_path / "degrees.csv", turned, delimiter=",", header=header, comments="")
    return scene


TOUCHING = {
    "--self-touch": "touches.npz",
    "--urdf": "robot.urdf",
    "--joints": "joints.csv",
    "--link": "left",
    "--other": "other.csv",
    "--other-link": "right",
}


def touching(**changes):
    given = TOUCHING | {f"--{key.replace('_', '-')}": value for key, value in changes.items()}
    return [word for pair in given.items() if pair[1] for word in pair]


def test_a_map_is_placed_by_self_touch(run, run_map, two_arms, tmp_path):
    assert run_map("patch.npz", "-d", 2, "-o", "map.csv").code == 0
    done = run("place", "map.csv", *touching(), "-o", "placed.urdf", "-o", "placed.npz",
               "--picture", "placed.png", "--json")  # fmt: skip
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert (found["anchored"], found["units"]) == (True, "m")
    assert 30 < sum(contact["used"] for contact in found["contacts"]) <= 40
    placed = io.read_map(tmp_path / "placed.npz")
    off = np.linalg.norm(placed.positions - two_arms.truth, axis=1)
    assert np.median(off) < 0.4 * self_touch.SPACING
    assert placed.frame == "left"
    assert (tmp_path / "placed.png").stat().st_size > 10_000
    exact = run("place", "shape.csv", *touching(joints="degrees.csv"), "--degrees", "--exact",
                "-o", "exact.npz")  # fmt: skip
    assert exact.code == 0, exact.err
    assert "agree" in exact.out
    off = np.linalg.norm(io.read_map(tmp_path / "exact.npz").positions - two_arms.truth, axis=1)
    assert off.max() < 0.4 * self_touch.SPACING


WRONG_TOUCHING = {
    "an option is missing": ({"joints": ""}, "give --joints as well"),
    "no file": ({"urdf": "none.urdf"}, "none.urdf"),
    "another file": ({"urdf": "shape.csv"}, "shape.csv is no URDF"),
    "another link": ({"link": "nose"}, "no link 'nose'"),
    "other frames": ({"joints": "short.csv"}, "each of 80 frames"),
    "other joints": ({"joints": "strange.csv"}, "angles of joint 'a1' are missing"),
    "other sensors": ({"other": "strangers.csv"}, "sensors of the other patch"),
    "other units": ({"joints": "degrees.csv"}, "no better than chance"),
    "both": ({"anchor": "a0=1,2,3"}, "by self-touch alone"),
}


@pytest.mark.parametrize("what", WRONG_TOUCHING)
def test_bad_input_of_self_touch(run, two_arms, tmp_path, what):
    lines = (tmp_path / "joints.csv").read_text().splitlines(keepends=True)
    (tmp_path / "short.csv").write_text("".join(lines[:20]))
    (tmp_path / "strange.csv").write_text(lines[0].replace("a1", "x1") + "".join(lines[1:]))
    strangers = replace(two_arms.other, names=tuple(f"c{i}" for i in range(60)))
    anisomap.write(strangers, tmp_path / "strangers.csv")
    changes, message = WRONG_TOUCHING[what]
    done = run("place", "shape.csv", "--exact", *touching(**changes), "-o", "placed.csv")
    assert done.code == 2
    assert message in done.err
    assert len(done.err.splitlines()) == 1
    assert not (tmp_path / "placed.csv").exists()
