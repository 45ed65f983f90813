"""Experiments of one's own, through the command line."""

import csv

import numpy as np
import pytest

import anisomap
from anisomap.cli.app import run

EXPERIMENT = """
body = "plane"
scenario = "rubbing"
methods = ["r-anisomap", "spearman-anisomap"]
seeds = [3, 5]
scores = ["mantel_r", "error"]
n_frames = 200
dimensions = 2
[settings]
hand_size = 0.6
"""


def test_scores_are_those_of_the_maps_of_the_same_recordings(tmp_path, capsys):
    path = tmp_path / "palm.toml"
    path.write_text(EXPERIMENT)
    assert run(["paper", "--experiment", str(path), "-o", str(tmp_path / "out")]) == 0
    assert "spearman-anisomap" in capsys.readouterr().out
    with (tmp_path / "out" / "palm.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["seed"], row["method"]) for row in rows] == [
        (seed, method) for seed in "35" for method in ("r-anisomap", "spearman-anisomap")
    ]
    recording = anisomap.simulate("plane", "rubbing", n_frames=200, seed=5, hand_size=0.6)
    made = anisomap.reconstruct(recording, "spearman-anisomap", 2)
    found = anisomap.score(made, recording.positions[:, :2], permutations=0)
    expected = [found.mantel.r, found.rms_in_spacings]
    np.testing.assert_allclose([float(rows[-1][k]) for k in ("mantel_r", "error")], expected, 1e-5)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("[settings]", "settings", "cannot be read as TOML"),
        ('body = "plane"', "", "body is missing"),
        ('"plane"', '"plan"', "plane"),
        ('"rubbing"', '"rubbin"', "rubbing"),
        ('"r-anisomap"', '"s-anisomap"', "r-anisomap"),
        ("seeds", "seed", "unknown key 'seed'; choose from body"),
        ("[3, 5]", "3", "seeds must be a list of int"),
        ("[3, 5]", "[]", "seeds must be a list of int"),
        ("200", '"200"', "n_frames must be of type int"),
        ("dimensions = 2", "dimensions = 4", "dimensions must be 2 or 3"),
        ('"error"', '"errors"', "choose from mantel_r, error"),
        ("hand_size", "hand", "rubbing has no parameter 'hand'; choose from"),
        ("0.6", "-1", "hand_size"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, capsys, before, after, message):
    path = tmp_path / "palm.toml"
    assert before in EXPERIMENT
    path.write_text(EXPERIMENT.replace(before, after, 1))
    assert run(["paper", "--experiment", str(path), "-o", str(tmp_path / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
