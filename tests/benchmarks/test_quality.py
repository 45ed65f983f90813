"""The measurement of accuracy: tables of simulated skins, and of recordings in files."""

import csv
import math
import sys

import numpy as np
from benchmarks.accuracy import quality
from benchmarks.accuracy.quality import FRAMES, SCENARIOS, Result

import anisomap
from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.comparison import COMPARED
from skins import flat_skin


def result(method, r, *, seed=1, recording="sphere, bombardment", n_frames=2000):
    return Result(recording, n_frames, seed, method, r, 0.5, 1.0, 1.0)


RESULTS = [
    result(DEFAULT_METHOD, 0.9),
    result(DEFAULT_METHOD, 0.8, seed=2),
    result("r-anisomap", 0.8),
    result("r-anisomap", 0.9, seed=2),
    result("isomap-on-r", 0.9),
    result("isomap-on-r", math.nan, seed=2),
    result("pca-on-r", 0.7),
    result("pca-on-r", 0.9, seed=2),
]


def test_a_row_holds_means_and_worst_scores_and_counts_missing_maps_as_zero():
    text = quality.tables(RESULTS)
    line = next(line for line in text.splitlines() if line.startswith("| sphere"))
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[1] == "2"
    assert cells[2] == "**0.850 (0.800)**"
    assert cells[4] == "0.450 (0.000)"
    assert cells[5] == "**0.800 (0.700)**"
    assert cells[6] == "1.25"  # mean of (1 - .9) / (1 - .8) and (1 - .8) / (1 - .9)
    assert f"a stock method is better than {DEFAULT_METHOD} on 0 of 1 rows." in text
    assert "worse than those by r-anisomap by more than 0.003: 1 of 2, by at most 0.100." in text


def test_losses_are_named_with_both_scores():
    worse = [result("pca-on-r", 0.95, seed=seed) for seed in (1, 2)]
    text = quality.tables([q for q in RESULTS if q.method != "pca-on-r"] + worse)
    assert (
        f"a stock method is better than {DEFAULT_METHOD} on 1 of 1 rows: sphere, bombardment, "
        "2,000 frames (0.850 against 0.950 of pca-on-r)." in text
    )


def test_recordings_are_compared_and_written_with_the_simulated_ones(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "umap", None)  # compiling it takes some 10 s
    skin = flat_skin(n_frames=120)
    anisomap.write(skin, tmp_path / "skin.npz")
    [(comparison, results)] = quality.score_file(tmp_path / "skin.npz")
    assert [q.method for q in results] == list(COMPARED)
    anisomap.write(anisomap.Recording(skin.readings), tmp_path / "unknown.npz")
    assert quality.score_file(tmp_path / "unknown.npz") == []
    simulated = [
        result(method, r - 10 / n, recording=f"{body}, {scenario}", n_frames=n)
        for body, scenario in SCENARIOS
        for n in FRAMES
        for method, r in ((DEFAULT_METHOD, 0.9), ("r-anisomap", 0.8), ("pca-on-r", 0.7))
    ]
    (tmp_path / "out").mkdir()
    quality.write(tmp_path / "out", [comparison], results, simulated)
    table = (tmp_path / "out" / "recordings-table.md").read_text()
    assert f"| skin | 42 x 120 | 2D | {len(comparison.sensors)} |" in table
    assert "pip install 'anisomap[umap]'" in table
    assert "0 of 18 rows." in (tmp_path / "out" / "quality-table.md").read_text()
    assert (tmp_path / "out" / "quality.png").read_bytes().startswith(b"\x89PNG")
    rows = list(csv.DictReader((tmp_path / "out" / "quality.csv").read_text().splitlines()))
    assert len(rows) == len(results) + len(simulated)
    values = {row["method"]: float(row["mantel_r"]) for row in rows if row["recording"] == "skin"}
    scores = {s.method: s.mantel_r for s in comparison.scores}
    assert all(np.isclose(values[m], scores[m], equal_nan=True) for m in scores)
