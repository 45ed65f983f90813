"""Run the command in this process and capture its output."""

from dataclasses import dataclass

import numpy as np
import pytest

import anisomap
from anisomap.cli import console
from anisomap.cli.app import main
from skins import flat_skin


@dataclass
class Outcome:
    code: int
    out: str
    err: str


@pytest.fixture
def run(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("ANISOMAP_DEBUG", "1")  # raise unexpected errors instead of reporting them

    def call(*arguments):
        for shown in (console.console, console.errors):
            monkeypatch.setattr(shown, "width", 200)
        with pytest.raises(SystemExit) as end:
            main([str(argument) for argument in arguments])
        said = capsys.readouterr()
        return Outcome(int(end.value.code or 0), said.out, said.err)

    return call


@pytest.fixture
def run_map(run):
    """Run ``anisomap map`` without a verdict, which takes most of its time."""
    return lambda *arguments: run("map", *arguments, "--no-verdict")


@pytest.fixture(scope="session")
def flat_map():
    """Map the flat skin once, for commands that start from a map."""
    return anisomap.reconstruct(flat_skin(), dimensions=2)


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
    recording = flat_skin()
    rows = [f"{n},{x},{y}" for n, (x, y) in zip(recording.names, recording.positions, strict=True)]
    path.write_text("name,x,y\n" + "\n".join(rows))
    return path
