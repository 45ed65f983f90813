"""Recordings read in blocks from the command line: equality with whole recordings."""

import re
from contextlib import suppress
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import anisomap
from anisomap import route
from anisomap.large import chunks
from skins import flat_skin


@pytest.fixture
def parts(tmp_path):
    """A skin in three files, sensors in another order in each, with their positions."""
    recording = flat_skin(n_frames=2400)
    order = np.random.default_rng(0)
    paths = []
    for i, readings in enumerate(np.split(recording.readings, 3)):
        sensors = order.permutation(42) if i else np.arange(42)
        part = anisomap.Recording(
            np.round(readings * 50),
            names=[f"pad {n}" for n in range(42)],
            positions=recording.positions,
            units="mm",
        )
        paths.append(tmp_path / f"part{i}.npz")
        anisomap.write(part.select(sensors), paths[-1])
    return paths


@pytest.fixture
def all_is_large(monkeypatch):
    monkeypatch.setattr(route, "LARGE_BYTES", 0)
    monkeypatch.setattr(route, "PROBED_BYTES", 0)
    monkeypatch.setattr(chunks, "CHUNK_READINGS", 42 * 170)
    monkeypatch.setattr(chunks, "CHUNK_FRAMES", 1)
    monkeypatch.setattr(anisomap.io, "read", None)  # nothing is read as a whole any more


def positions(path: str) -> np.ndarray:
    return anisomap.read_map(path).positions


def test_large_recordings_make_the_same_map(run_map, parts, request):
    """By r-anisomap; the other tests of blocks are by i-anisomap."""
    arguments = [*parts, "--permutations", 9]
    whole = run_map(*arguments, "-o", "whole.csv")
    request.getfixturevalue("all_is_large")
    made = run_map(*arguments, "-o", "parts.csv", "--report", "report.html")
    np.testing.assert_allclose(positions("parts.csv"), positions("whole.csv"), atol=1e-8)
    assert said_of_both(made) == said_of_both(whole)
    assert made.err == whole.err


def said_of_both(run):
    """Return the lines on a map, except for its touches, which need all readings."""
    lines = "\n".join(line.rstrip() for line in run.out.split("Written to")[0].splitlines())
    return re.sub(r"^Touches\n( .*\n)+", "", lines, flags=re.MULTILINE)


def test_workers_and_checkpoints(run_map, parts):
    run_map(*parts, "-m", "r-anisomap", "-o", "whole.csv")
    options = ["-m", "r-anisomap", "-d", 2, "--checkpoint", "counts.npz"]
    run_map(*parts, *options, "--workers", 2, "-o", "first.csv")
    assert Path("counts.npz").exists()
    run_map(*parts, *options, "-o", "again.csv")
    for name in ("first.csv", "again.csv"):
        np.testing.assert_allclose(positions(name), positions("whole.csv"), atol=1e-8)
    other = run_map(parts[0], *options, code=2)
    assert "checkpoint of another computation" in other.err


@pytest.fixture
def robots(tmp_path):
    """Two recordings of an iCub's port: thermal pads, an absent triangle, and gaps of all kinds."""
    whole = np.zeros((2400, 48), dtype=np.float32)
    pads = [i for i in range(48) if i % 12 not in (6, 10) and i // 12 != 2]
    whole[:, pads] = np.round(flat_skin(n_frames=2400).readings * 50)[:, : len(pads)]
    whole[:, 6] = np.arange(2400) % 90
    paths = []
    for i, readings in enumerate(np.split(whole, [1300])):
        readings[40:44, 3] = np.nan
        readings[:200, 5] = readings[-9:, 8] = np.nan
        readings[300:900, 11] = np.inf
        readings[50, 6] = np.nan  # a thermal pad, not a sensor
        readings[:, 30] = np.nan  # in an absent triangle
        paths.append(tmp_path / f"robot{i}.npz")
        anisomap.write(anisomap.Recording(readings), paths[-1])
    return paths


@pytest.mark.parametrize("nan", ["interpolate", "drop-frames"])
@pytest.mark.parametrize("case", [(1, "icub"), (2, "icub"), (2, "")])
def test_gaps_and_robots_are_treated_as_in_whole_recordings(run_map, robots, nan, case, request):
    n_files, preset = case
    arguments = [*robots[:n_files], "-d", 2, "-m", "i-anisomap", "--missing", nan]
    arguments += ["--preset", preset] if preset else []
    whole = run_map(*arguments, "-o", "whole.json")
    request.getfixturevalue("all_is_large")
    made = run_map(*arguments, "-o", "blocks.json")
    expected, found = (anisomap.read_map(f"{name}.json") for name in ("whole", "blocks"))
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-8)
    assert found.names == expected.names
    assert found.health == expected.health
    assert said_of_both(made) == said_of_both(whole)
    if preset:
        assert found.names[-1] == "b0.t3.k11"
        assert found.n_sensors == 30


@pytest.mark.slow
@pytest.mark.usefixtures("all_is_large")
def test_unsupported_options_of_large_recordings_are_refused(run, parts, robots, monkeypatch):
    monkeypatch.setenv("DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT", "1s")
    with suppress(ImportError):
        import_module("dask").config.refresh()
    told = run("map", *parts, "--dask", "tcp://127.0.0.1:1", code=2).err
    assert "cluster" in told or "no Dask scheduler" in told
    assert "sensor 5 in frame 0 is NaN or infinite" in run("map", *robots, code=2).err
    assert "multiple of 12" in run("map", *parts, "--preset", "icub", code=2).err


@pytest.mark.usefixtures("all_is_large")
def test_large_recordings_must_have_the_same_sensors(run, parts):
    few = anisomap.io.registry.read(parts[1]).select(np.arange(30))
    anisomap.write(few, "few.npz")
    assert "have different sensors" in run("map", parts[0], "few.npz", code=2).err


@pytest.mark.slow
def test_approximate_maps_are_labelled_in_every_output(run_map, parts):
    outputs = [f"map.{suffix}" for suffix in ("csv", "json", "npz")]
    written = [word for name in outputs for word in ("-o", name)]
    words = (*parts, "--approximate", "--seed", 3, "--drop", "pad 5,7")
    made = run_map(*words, *written, "--report", "map.html")
    run_map(*words, "-o", "again.csv")
    assert Path("again.csv").read_bytes() == Path("map.csv").read_bytes()
    assert np.isnan(positions("map.csv")[[5, 7]]).all()
    assert "Map by r-anisomap, approximate" in made.out
    assert "this map is approximate" in made.err
    for name in outputs:
        written_map = anisomap.read_map(name)
        assert written_map.approximate
        assert any("this map is approximate" in note for note in written_map.notes)
    page = Path("map.html").read_text(encoding="utf-8")
    assert "This map is approximate" in page
    assert "approximate_n_landmarks" in page
    run_map(*parts, "-m", "r-anisomap", "-o", "exact.csv")
    maps = (np.delete(positions(name), [5, 7], axis=0) for name in ("map.csv", "exact.csv"))
    assert anisomap.mantel(*maps, permutations=0).r > 0.99
