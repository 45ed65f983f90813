"""What cannot be done: one sentence, exit code 2, and no file is written, changed or lost."""

import os
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

import anisomap
from anisomap.cli import app
from anisomap.errors import install_command
from anisomap.files import reader_process
from command_line import call, contents, write_layout
from skins import flat_skin, lattice

LONG = "x" * 9000

REFUSED = f"""
map skin.npz -o map.png                                   | --picture
map skin.npz -o map.html                                  | --report
map skin.npz -o skin.mjcf                                 | --spacing 6.5mm
map skin.npz -m pca                                       | no method 'pca'
map missing.csv -o map.csv                                | there is no file missing.csv
map skin.npz -d 0                                         | -d
score map.csv truth.csv --exclude nobody                  | nobody
score layout.csv layout.csv --units mm                    | states the unit m: leave out --units
map skin.npz --drop {LONG}                                | there is no sensor 'xxx
map skin.csv -o skin.csv                                  | another file
map skin.csv -o a.csv --picture a.csv                     | two outputs
map skin.npz --min-quality usable --no-verdict            | verdict
map turned.csv                                            | transpose it; if not, record the 80
map skin.csv --grid 6x8                                   | 48
map constant.csv -o old.csv                               | got 0 of 3
convert map.csv tf.launch.xml                             | robot_state_publisher publishes a .urdf
map gaps.csv -o old.csv                                   | sensors: s1; frames: 9
score map.csv                                             | REFERENCE_FILE
score map.csv strangers.csv                               | no sensor
convert map.csv a.urdf                                    | in metres, but the map has no scale
convert map.csv a.urdf --spacing 6.5                      | '6.5' is not a length
convert map.csv map.csv                                   | write the result to another file
convert placed.csv a.csv --mirror                         | in the frame of the robot
convert pieces.csv a.urdf --spacing 5mm                   | each map of SensorMap.split()
convert map.csv {"b" * 300}.csv                           | too long
check map.csv skin.npz -o a.urdf                          | scale it first: anisomap convert
check bare.npz layout.csv                                 | swap the arguments: anisomap check
check layout.csv skin.npz --module-size 10 --module-table m    | not by both
place map.csv                                             | --spacing
place map.csv --anchor s1=0,0 --anchor s2=0,0,0           | all anchors must have two coordinates
place map.csv --anchors anchors.csv --mesh map.csv        | map.csv
place map.csv --mesh part.stl --mesh-units feet           | --mesh-units must be one of m, dm
place map.csv --module-size 5                             | modules need --module-layout
live                                                      | give either a source or --simulate BODY
live skin.csv --drop s1-s99 --headless                    | there is no sensor 's1-s99'
live tcp://127.0.0.1                                      | needs a port
live skin.csv --recording old.csv                         | old.csv exists
live skin.csv --recording r.npz                           | must end in .csv
live skin.csv --coached --headless                        | --coached is for a simulated hand
"""
"""Commands, and what the error says."""

NEEDS_PHYSICS = """
live --simulate nobody                             | there is no body
simulate teapot                                    | no body or file 'teapot'; bodies: sphere
simulate sphere --frames 0                         | frames
simulate layout.csv --sensors 5                    | --sensors is for named bodies
simulate part.obj                                  | part.obj is a mesh
simulate sphere -p n_balls                         | write NAME=VALUE
simulate sphere -p n_balls=many                    | 'many' is not a number
list scenarios rain                                | no scenario 'rain'
list bodies sphere                                 | only scenarios have
"""

SCALES = {"tiny.csv": 1e-310, "point.csv": 0}
"""Layouts of finite positions; the squares of their distances are 0."""

WAVE = "\n".join(f"{np.sin(i):.3f},{np.cos(i):.3f},{np.sin(2 * i):.3f}" for i in range(9))
TOO_LITTLE = {
    "gaps.csv": WAVE + "\n1,nan,3\n",
    "infinite.csv": WAVE + "\n1,2,inf\n",
    "two.csv": "a,b\n1,2\n2,1\n3,3\n",
    "constant.csv": "a,b,c\n1,2,3\n1,2,3\n",
}
"""Recordings of which a summary can be given, but no map made."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Write the inputs of all commands."""
    folder = tmp_path_factory.mktemp("inputs")
    skin = flat_skin(n_frames=300)
    flat = np.column_stack([skin.positions, np.zeros(42)])
    anisomap.write(skin, folder / "skin.npz")
    anisomap.write(anisomap.Recording(skin.readings), folder / "bare.npz")
    anisomap.write(anisomap.Recording(skin.readings), folder / "skin.csv")
    anisomap.write(anisomap.Recording(np.zeros((20, 42))), folder / "zero.csv")
    np.savetxt(folder / "turned.csv", skin.readings[:100].T, delimiter=",")
    maps = {
        "map.csv": anisomap.SensorMap(skin.positions),
        "layout.csv": anisomap.SensorMap(flat / 1000, units="m"),
        "placed.csv": anisomap.SensorMap(flat / 1000, units="m", anchored=True),
        "pieces.csv": anisomap.SensorMap(lattice(2, 3), component=[0, 0, 0, 1, 1, 1]),
        **{name: anisomap.SensorMap(flat * scale) for name, scale in SCALES.items()},
    }
    for name, sensor_map in maps.items():
        anisomap.write(sensor_map, folder / name)
    write_layout(folder / "truth.csv", skin.positions, skin.names)
    write_layout(
        folder / "anchors.csv", 6 * skin.positions[:4], skin.names[:4], "name,x [mm],y [mm]"
    )
    texts = {"strangers.csv": "name,x,y\na,0,0\nb,1,0\nc,0,1\n", **TOO_LITTLE, "old.csv": "mine"}
    for name, text in texts.items():
        (folder / name).write_text(text)
    return folder


def refused(folder, *words):
    """Run a command that must be refused; return the sentence that says why."""
    before = contents(folder)
    found = call(folder, *words, code=2)
    assert found.err.startswith("error: ")
    assert found.err.count("\n") == 1
    assert len(found.err) < 310
    assert not found.out
    assert contents(folder) == before
    return found.err


needs_physics = pytest.mark.skipif(
    find_spec("mujoco") is None, reason="needs the extra 'simulation'"
)


def cases(table, *marks):
    """Return the rows of a table of commands as parameters."""
    rows = (tuple(map(str.strip, row.split("|"))) for row in table.strip().splitlines())
    return [pytest.param(*row, id=row[0][:60], marks=marks) for row in rows]


@pytest.mark.parametrize(
    ("command", "reason"), [*cases(REFUSED), *cases(NEEDS_PHYSICS, needs_physics)]
)
def test_commands_that_are_refused(folder, command, reason):
    assert reason in refused(folder, command)


@pytest.mark.parametrize("name", SCALES)
@pytest.mark.parametrize(
    "command",
    [
        "diff layout.csv {}",
        "check {} skin.npz",
        "score {} layout.csv",
        "place {} --spacing 5mm -o o.csv",
        "simulate {} -s rubbing --frames 3 -o o.npz",
    ],
)
def test_layouts_without_distances(folder, name, command):
    refused(folder, command.format(name))


def test_an_unexpected_error_is_reported_as_a_defect(skin_csv, monkeypatch, capsys):
    def broken(*_, **__):
        message = "a bug"
        raise KeyError(message)

    monkeypatch.delenv("ANISOMAP_DEBUG", raising=False)
    monkeypatch.setattr(anisomap.io, "read", broken)
    assert app.run(["map", str(skin_csv)]) == 70
    said = capsys.readouterr().err
    assert "defect in anisomap" in said
    assert "Traceback" not in said


def test_too_many_sensors_are_refused_before_they_are_compared(tmp_path, machine_with):
    """Comparing a million sensors with one another takes hours, and their map terabytes."""
    np.savez_compressed(tmp_path / "many.npz", readings=np.eye(20, 100_000, dtype=np.uint8))
    machine_with(24 << 30)
    for command in ("info", "map"):
        told = refused(tmp_path, command, "many.npz")
        assert "100000 sensors needs about 298.0 GiB of memory" in told


def test_an_extra_that_is_not_installed_is_named(folder, tmp_path, tmp_path_factory, monkeypatch):
    (tmp_path / "part.stl").write_bytes(b"solid part")
    libraries = tmp_path_factory.mktemp("libraries")
    (libraries / "trimesh.py").write_text("raise ImportError")
    monkeypatch.syspath_prepend(libraries)  # also of the process for readers
    mesh = ("--anchors", folder / "anchors.csv", "--mesh", "part.stl")
    reader_process.stop_all()
    try:
        told = refused(tmp_path, "place", folder / "map.csv", *mesh)
    finally:
        reader_process.stop_all()
    assert f"reading a mesh needs an extra: {install_command('mesh')}" in told


@pytest.mark.parametrize("command", ["place {}", "map {}", "convert {} o.csv"])
def test_links_that_lead_nowhere(tmp_path, command):
    (tmp_path / "a.csv").symlink_to("a.csv")
    (tmp_path / "b.csv").symlink_to("none.csv")
    for name in ("a.csv", "b.csv"):
        assert name in refused(tmp_path, command.format(name))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs pipes")
@pytest.mark.parametrize(
    "command",
    [
        "place map.csv --spacing 5mm -o {}.csv",
        "repair skin.npz -o {}.npz",
        "score map.csv map.csv --report {}.html",
    ],
)
def test_pipes_and_devices_are_not_replaced(folder, tmp_path, command):
    for name in ("map.csv", "skin.npz"):
        (tmp_path / name).symlink_to(folder / name)
    pipe = tmp_path / command.format("pipe").split()[-1]
    link = tmp_path / command.format("link").split()[-1]
    os.mkfifo(pipe)
    link.symlink_to(pipe)
    for target in ("pipe", "link"):
        assert "not a regular file" in refused(tmp_path, command.format(target))
    assert pipe.is_fifo()
    assert link.is_symlink()


def test_outputs_with_long_names_and_links(folder, tmp_path):
    (tmp_path / "far").mkdir()
    (tmp_path / "b.csv").symlink_to(tmp_path / "far" / "c.csv")
    for name in ("b" * 250 + ".csv", "b.csv"):
        call(tmp_path, "convert", folder / "map.csv", name)
    assert (tmp_path / "b.csv").is_symlink()
    assert anisomap.read_map(tmp_path / "far" / "c.csv").n_sensors == 42


def test_layouts_of_few_places(run, tmp_path):
    """Several sensors at one place have no spacing; nor has a single one."""
    positions = np.repeat(np.random.default_rng(0).random((9, 3)), 2, axis=0)
    anisomap.write(anisomap.SensorMap(positions), tmp_path / "pairs.csv")
    found = run("diff", "pairs.csv", "pairs.csv")
    assert "spacings" not in found.out
    anisomap.write(anisomap.SensorMap(np.ones((1, 3)), units="m"), tmp_path / "one.csv")
    run("convert", "one.csv", "one.json")
    run("place", "one.csv", "--spacing", "5mm", "-o", "o.csv")
    assert (tmp_path / "o.csv").exists()


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("map skin.npz --spacing 0.0065mm", "spacing of 0.0065mm is unlikely"),
        ("map skin.npz --spacing 6.5mm", ""),
        ("map skin.npz -d 4", "for skins, choose 2"),
        ("map turned.csv", "rows of the file are the sensors, transpose it"),
    ],
)
def test_what_is_probably_a_mistake_is_doubted(tmp_path, command, said):
    skin = flat_skin(n_frames=100)
    anisomap.write(skin, tmp_path / "skin.npz")
    np.savetxt(tmp_path / "turned.csv", skin.readings.T, delimiter=",")
    done = call(tmp_path, f"{command} -m r-anisomap --no-verdict --permutations 0 -o m.csv")
    assert said in done.err
    assert ("unlikely" in done.err) == ("unlikely" in said)


def test_long_names_are_printed_in_one_piece(tmp_path):
    source = "a_recording_with_a_name_that_is_longer_than_a_line/" * 5
    anisomap.write(replace(flat_skin(n_frames=100), source=source), tmp_path / "skin.npz")
    assert source in call(tmp_path, "info", "skin.npz").out
