"""The scripts in examples/."""

import csv
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

import anisomap
from skins import flat_skin

pytest.importorskip("matplotlib")
pytest.importorskip("PIL")

EXAMPLES = Path(__file__).parents[2] / "examples"


def load(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", ["retina", "cochlea"])
def test_examples_map_their_recording(name, tmp_path, monkeypatch, capsys):
    picture = tmp_path / "map.png"
    monkeypatch.setattr(sys, "argv", [name, "--frames", "400", "--output", str(picture)])
    load(name).main()
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if "Mantel" in line]
    scores = {words[0]: float(words[-1]) for words in lines}
    assert max(scores.values()) > 0.8  # .91 to .98 on four seeds of each
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("name", ["retina", "cochlea"])
def test_neighbours_in_the_examples_are_the_most_similar(name):
    record = getattr(load(name), f"record_{name}")
    recording = record(400, 1)
    r = np.corrcoef(recording.readings.T)
    distances = np.linalg.norm(recording.positions[:, None] - recording.positions, axis=2)
    near = (distances > 0) & (distances < 1.5 * np.min(distances[distances > 0]))
    far = distances > np.median(distances)
    assert 1 - r[near].mean() < (1 - r[far].mean()) / 3
    np.testing.assert_array_equal(record(400, 1).readings, recording.readings)
    assert (record(400, 2).readings != recording.readings).any()


def test_an_experiment_scores_the_maps_of_its_recordings(tmp_path, monkeypatch):
    pytest.importorskip("mujoco", reason="needs the extra 'simulation'")
    example = load("experiment")
    settings = {"n_frames": 200, "hand_size": 0.6}
    for name, value in {"BODY": "plane", "SCENARIO": "rubbing", "DIMENSIONS": 2}.items():
        monkeypatch.setattr(example, name, value)
    monkeypatch.setattr(example, "SETTINGS", settings)
    example.main(str(tmp_path / "scores.csv"), seeds=[5])
    with (tmp_path / "scores.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["method"] for row in rows] == list(example.METHODS)
    recording = anisomap.simulate("plane", "rubbing", seed=5, **settings)
    made = anisomap.reconstruct(recording, example.METHODS[-1], 2)
    found = anisomap.score(made, recording.positions[:, :2], permutations=0)
    assert float(rows[-1]["mantel_r"]) == pytest.approx(found.mantel.r)
    assert float(rows[-1]["error_in_spacings"]) == pytest.approx(found.rms_in_spacings)


def test_methods_are_compared_on_a_recording_with_known_positions(tmp_path, monkeypatch, capsys):
    path = tmp_path / "skin.npz"
    anisomap.write(flat_skin(), path)
    monkeypatch.setattr(sys, "argv", ["compare", str(path)])
    load("compare").main()
    scores = {
        line.split()[0]: float(line.split()[3].strip(","))
        for line in capsys.readouterr().out.splitlines()
    }
    assert scores.keys() == {*anisomap.METHODS, "isomap-on-r"}
    assert scores["covariogram"] > 0.9
