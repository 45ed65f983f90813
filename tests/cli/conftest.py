"""Run the command in this process and capture its output."""

from functools import partial

import numpy as np
import pytest

import anisomap
from command_line import call, write_layout
from skins import flat_skin

QUICK = {"-m": "r-anisomap", "-d": 2, "--permutations": 0}


@pytest.fixture
def run(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    return partial(call, tmp_path)


@pytest.fixture
def run_map(run):
    """Run ``anisomap map`` in 2D by the quickest method, without a verdict and permutations."""

    def mapped(*arguments, code=0):
        quick = [word for pair in QUICK.items() if pair[0] not in arguments for word in pair]
        return run("map", *arguments, *quick, "--no-verdict", code=code)

    return mapped


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """Map a flat skin once, by the default method, into files of all kinds; give their folder."""
    folder = tmp_path_factory.mktemp("made")
    anisomap.write(flat_skin(), folder / "skin.npz")
    files = "-o map.csv -o map.json -o map.npz -o map.ply --picture map.png --report map.html"
    command = "map skin.npz -d 2 --min-quality usable --permutations 99 --json"
    (folder / "said.json").write_text(call(folder, f"{command} {files}").out)
    return folder


@pytest.fixture
def skin_csv(tmp_path):
    """A healthy flat skin as CSV."""
    path = tmp_path / "skin.csv"
    recording = flat_skin()
    np.savetxt(path, recording.readings, "%.4g", ",", header=",".join(recording.names), comments="")
    return path


@pytest.fixture
def skin_npz(tmp_path):
    """The same skin as NPZ, with its true positions."""
    path = tmp_path / "skin.npz"
    anisomap.write(flat_skin(), path)
    return path


@pytest.fixture
def truth_csv(tmp_path):
    path = tmp_path / "truth.csv"
    write_layout(path, flat_skin().positions, flat_skin().names)
    return path
