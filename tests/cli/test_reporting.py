"""Options --quiet and --json of all reporting commands."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import anisomap
from skins import flat_skin

COMMANDS = {
    "info": ["info", "skin.npz"],
    "map": ["map", "skin.npz", "-d", 2, "-o", "m.csv", "--no-verdict", "--permutations", 9],
    "score": ["score", "made.csv", "skin.npz", "--permutations", 9],
    "check": ["check", "skin.npz", "skin.npz"],
    "convert": ["convert", "made.csv", "made.json"],
    "compare": ["compare", "skin.npz", "-m", "r-anisomap", "-d", 2],
    "methods": ["methods"],
    "formats": ["formats"],
    "bodies": ["bodies"],
    "scenarios": ["scenarios"],
    "parameters": ["scenarios", "bombardment"],
    "faults": ["faults"],
    "spoil": ["spoil", "skin.npz", "-f", "dead:s3", "-o", "bad.npz"],
    "simulate": ["simulate", "plane", "-s", "rubbing", "--frames", 40, "-o", "sim.npz"],
    "coverage": ["coverage", "plane", "--frames", 100, "--runs", 1, "-m", "r-anisomap", "-d", 2],
}
EXPECTED = {
    "info": "recording",
    "map": "map",
    "score": "score",
    "check": "findings",
    "convert": "files",
    "compare": "scores",
    "methods": "similarities",
    "parameters": "parameters",
    "spoil": "faults",
    "simulate": "files",
}


@pytest.fixture
def _files(tmp_path):
    anisomap.write(flat_skin(n_frames=600), tmp_path / "skin.npz")
    made = anisomap.SensorMap(flat_skin().positions, units="mm")
    anisomap.write(made, tmp_path / "made.csv")


def _refuse(constant):
    raise ValueError(f"{constant} is not JSON")


def _run(run, name, option):
    if name in ("bodies", "simulate", "coverage"):
        pytest.importorskip("mujoco", reason="needs the extra 'simulation'")
    return run(*COMMANDS[name], option)


@pytest.mark.usefixtures("_files")
@pytest.mark.parametrize("name", COMMANDS)
def test_json_is_one_object_with_the_results(run, name):
    found = _run(run, name, "--json")
    assert found.code == 0
    values = json.loads(found.out, parse_constant=_refuse)
    assert EXPECTED.get(name, name) in values


@pytest.mark.usefixtures("_files")
@pytest.mark.parametrize("name", COMMANDS)
def test_quiet_prints_no_results(run, name):
    found = _run(run, name, "--quiet")
    assert found.code == 0
    assert found.out == ""


@pytest.mark.usefixtures("_files")
def test_warnings_and_errors_remain_when_quiet(run, tmp_path):
    readings = flat_skin().readings.copy()
    readings[:, 3] = 0
    anisomap.write(anisomap.Recording(readings), tmp_path / "dead.npz")
    found = run("info", "dead.npz", "--quiet")
    assert "never vary" in found.err
    refused = run("info", "nothing.npz", "--quiet")
    assert (refused.code, refused.err.startswith("error: ")) == (2, True)


MAP = [sys.executable, "-c", "from anisomap.cli import main; main()", "map", "skin.npz", "-d", "2"]


@pytest.mark.usefixtures("_files")
@pytest.mark.parametrize("option", ["--no-verdict", pytest.param("--json", marks=pytest.mark.slow)])
def test_the_map_is_written_if_the_reader_closes_the_pipe(tmp_path, option):
    started = subprocess.Popen(
        [*MAP, "-o", "piped.csv", "--permutations", "0", option],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    started.stdout.close()
    _, said = started.communicate()
    assert started.returncode == 0, said
    assert anisomap.read_map(tmp_path / "piped.csv").placed.all()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
@pytest.mark.usefixtures("_files")
def test_a_full_standard_output_is_an_error_after_the_map_is_written(tmp_path):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [*MAP, "-o", "full.csv", "--no-verdict", "--permutations", "0"],
            cwd=tmp_path,
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr == "error: cannot write to standard output: No space left on device\n"
    assert anisomap.read_map(tmp_path / "full.csv").placed.all()


COMPARE = ["compare", "skin.npz", "-m", "r-anisomap", "-o", "scores.md"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
@pytest.mark.usefixtures("_files")
def test_a_comparison_is_written_before_it_is_printed(tmp_path):
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*MAP[:3], *COMPARE], cwd=tmp_path, stdout=full, check=False)
    assert done.returncode == 2
    assert "r-anisomap" in (tmp_path / "scores.md").read_text(encoding="utf-8")


@pytest.mark.skipif(sys.platform == "win32", reason="closes streams in a shell of Unix")
@pytest.mark.parametrize(
    ("streams", "command", "code"),
    [
        (">&-", "formats", 0),
        (">&- 2>&-", "info nothing.npz", 2),
        ("2>/dev/full", "info nothing.npz", 2),
    ],
)
def test_standard_streams_that_are_closed_or_full(tmp_path, streams, command, code):
    if "full" in streams and not Path("/dev/full").exists():
        pytest.skip("needs a device that is always full")
    line = f'exec "$0" -m anisomap {command} {streams}'
    done = subprocess.run(
        ["/bin/sh", "-c", line, sys.executable],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (code, "")


def test_commands_say_where_to_touch_next(run, tmp_path):
    places = np.stack(np.meshgrid(range(7), range(7)), -1).reshape(-1, 2)
    touches = np.random.default_rng(0).uniform(0, 6, (800, 1, 2))
    spared = np.linalg.norm(touches[:, 0] - [5, 5], axis=1) < 2.2
    touches = touches[~spared | (np.arange(800) % 8 == 0)]
    depth = np.maximum(0, 1.6 - np.linalg.norm(touches - places, axis=2))
    readings = np.repeat(depth, 2, axis=0) * (np.arange(2 * len(depth)) % 2 == 0)[:, None]
    anisomap.write(anisomap.Recording(readings), tmp_path / "corner.npz")
    corner = {f"s{i}" for i in np.flatnonzero(np.linalg.norm(places - [5, 5], axis=1) < 2.5)}
    told = run("info", "corner.npz").out
    first = re.search(r"touch next +around ([^;\n]*)", told).group(1).replace(" and", ",")
    assert {name.strip() for name in first.split(",")} <= corner
    assert re.search(r"contacts +median \d+", told)
    made = run(
        "map", "corner.npz", "-d", 2, "--no-verdict", "-o", "m.csv", "--report", "m.html", "--json"
    )
    found = json.loads(made.out)["touches"]
    assert set(found["next"][0]["sensors"]) <= corner
    assert found["contacts"].keys() == {f"s{i}" for i in range(49)}
    assert "How the skin was touched" in (tmp_path / "m.html").read_text()
