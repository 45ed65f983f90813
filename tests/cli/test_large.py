"""Recordings that are gone through in blocks from the command line: the same map."""

from pathlib import Path

import numpy as np
import pytest

import anisomap
from anisomap.cli import streams
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
    monkeypatch.setattr(streams, "LARGE_BYTES", 0)
    monkeypatch.setattr(streams, "PROBED_BYTES", 0)
    monkeypatch.setattr(streams, "CHUNK_READINGS", 42 * 170)


def positions(path: str) -> np.ndarray:
    return anisomap.read_map(path).positions


@pytest.mark.parametrize("method", ["r-anisomap", "i-anisomap"])
def test_large_recordings_make_the_same_map(run, parts, method, request, monkeypatch):
    arguments = ["-d", 2, "-m", method, "--permutations", 9]
    whole = run("map", *parts, *arguments, "-o", "whole.csv")
    request.getfixturevalue("all_is_large")
    monkeypatch.setattr(anisomap.formats, "read", None)  # nothing is read as a whole any more
    made = run("map", *parts, *arguments, "-o", "parts.csv", "--report", "report.html")
    assert made.code == whole.code == 0
    np.testing.assert_allclose(positions("parts.csv"), positions("whole.csv"), atol=1e-8)
    assert made.out.split("Files")[0] == whole.out.split("Files")[0]
    assert made.err == whole.err


def test_workers_and_checkpoints(run, parts):
    assert run("map", *parts, "-m", "r-anisomap", "-d", 2, "-o", "whole.csv").code == 0
    options = ["-m", "r-anisomap", "-d", 2, "--checkpoint", "counts.npz"]
    assert run("map", *parts, *options, "--workers", 2, "-o", "first.csv").code == 0
    assert Path("counts.npz").exists()
    assert run("map", *parts, *options, "-o", "again.csv").code == 0
    for name in ("first.csv", "again.csv"):
        np.testing.assert_allclose(positions(name), positions("whole.csv"), atol=1e-8)
    other = run("map", parts[0], *options)
    assert other.code != 0
    assert "checkpoint of something else" in other.err


@pytest.mark.usefixtures("all_is_large")
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--nan", "interpolate"], "needs a recording that is read as a whole"),
        (["--dask", "tcp://127.0.0.1:1"], "cluster|no Dask scheduler"),
    ],
)
def test_what_blocks_do_not_allow_is_refused(run, parts, arguments, message):
    made = run("map", *parts, *arguments)
    assert made.code != 0
    assert any(part in made.err for part in message.split("|"))


@pytest.mark.usefixtures("all_is_large")
def test_large_recordings_must_have_the_same_sensors(run, parts):
    few = anisomap.read(parts[1]).select(np.arange(30))
    anisomap.write(few, "few.npz")
    made = run("map", parts[0], "few.npz")
    assert made.code != 0
    assert "few.npz is not of the same sensors" in made.err
