"""Benchmarks of accuracy: their tables, and the faults that the check of layouts is tried on."""

import csv
import math
import sys

import numpy as np
import pytest
from benchmarks.accuracy import contacts, dimension, limits, quality, steps
from benchmarks.accuracy.check import (
    LAYOUT_FAULTS,
    MIN_SWAPPED,
    MOVED,
    READING_FAULTS,
    Result,
    Skin,
    table,
)
from benchmarks.accuracy.rivals import COMPARED, name_of
from benchmarks.harness import read_rows, write_rows
from benchmarks.placing import placement
from benchmarks.verdicts import trust
from scipy.spatial.distance import cdist

import anisomap
from anisomap.base.defaults import DEFAULT_METHOD
from skins import flat_skin, triangles


def rows_of(path):
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def measured(benchmark, folder, label, *arguments):
    """Run a benchmark; return the rows that it wrote, by the value of a column."""
    benchmark.main([*arguments, "-o", str(folder / "found.csv")])
    return {row[label]: row for row in rows_of(folder / "found.csv")}


RECORDED = {
    "dimension": (dimension, ["--seeds", "0"]),
    "limits": (limits, ["--workers", "1"]),  # also of electrodes
    "quality": (quality, ["--seeds", "0", "--workers", "1"]),
    "steps": (steps, ["--seeds", "0", "--workers", "1"]),
    "trust": (trust, ["--seeds", "0", "--workers", "1", "--cases", "skin part, 3D"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", RECORDED)
def test_tables_of_recordings_are_written(name, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "umap", None)  # compiling it takes some 10 s
    recordings, folder = tmp_path / "recordings", tmp_path / "out"
    recordings.mkdir()
    anisomap.write(flat_skin(n_frames=1200), recordings / "retina_skin.npz")
    benchmark, arguments = RECORDED[name]
    benchmark.main([*arguments, "--recordings", str(recordings), "-o", str(folder)])
    assert (folder / f"{name}.csv").exists()
    assert all(map(rows_of, folder.glob("*.csv")))
    texts = [path.read_text(encoding="utf-8") for path in folder.glob("*-table.md")]
    assert texts
    assert all("| --- |" in text for text in texts)


def test_contacts_are_counted_where_they_begin():
    readings = np.array([[0, 2.0], [3, 2], [3, 0], [0, 0], [4, 0], [0, 1], [0, 0], [0, 0], [0, 0]])
    found = contacts.contacts_by_frame(readings)
    assert found[:, 0].tolist() == [0, 1, 1, 1, 2, 2, 2, 2, 2]
    assert found[:, 1].tolist() == [1, 1, 1, 1, 1, 2, 2, 2, 2]


@pytest.mark.slow
def test_accuracy_by_contacts_is_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(contacts, "SKINS", (("hexagon", "rubbing"),))
    monkeypatch.setattr(contacts, "COMPARED", ("covariogram", "r-anisomap"))
    contacts.main(["--seeds", "1", "--contacts", "3", "5", "--workers", "1", "-o", str(tmp_path)])
    rows = [row for row in rows_of(tmp_path / "contacts.csv") if row["method"] == "covariogram"]
    assert [row["contacts"] for row in rows] == ["3", "5"]
    assert int(rows[0]["n_frames"]) < int(rows[1]["n_frames"])
    assert " of 2 points" in (tmp_path / "contacts-table.md").read_text(encoding="utf-8")


def test_every_variant_leaves_one_step_out():
    whole = steps.VARIANTS["nothing"]
    for name, step in whole.refinements.items():
        if name in steps.VARIANTS:
            others = steps.VARIANTS[name].refinements
            assert {**others, name: step} == whole.refinements


@pytest.mark.slow
def test_placed_maps_are_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(placement, "SEEDS", placement.SEEDS[:1])
    monkeypatch.setattr(placement, "HAND_DRAWS", 5)
    monkeypatch.setattr(placement, "FLAT", ("hexagon",))
    found = measured(placement, tmp_path, "measure", "--bodies", "sphere", "--draws", "6")
    assert 0 < float(found["mesh and 3 anchors: median error (spacings)"]["median"]) < 1
    right = found["mesh and 3 anchors: share of the right hand where placed"]
    assert float(right["median"]) > 0.5


def result(method, r, *, seed=1, recording="sphere, bombardment", n_frames=2000):
    return quality.Result(recording, n_frames, seed, method, r, 0.5, 1.0, 1.0)


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
    assert [q.method for q in results] == [name_of(one) for one in COMPARED]
    anisomap.write(anisomap.Recording(skin.readings), tmp_path / "unknown.npz")
    assert quality.score_file(tmp_path / "unknown.npz") == []
    simulated = [
        result(method, r - 10 / n, recording=f"{body}, {scenario}", n_frames=n)
        for body, scenario in quality.SCENARIOS
        for n in quality.FRAMES
        for method, r in ((DEFAULT_METHOD, 0.9), ("r-anisomap", 0.8), ("pca-on-r", 0.7))
    ]
    (tmp_path / "out").mkdir()
    quality.write(tmp_path / "out", [comparison], results, simulated)
    table = (tmp_path / "out" / "recordings-table.md").read_text()
    assert f"| skin | 42 x 120 | 2D | {len(comparison.sensors)} |" in table
    assert "pip install 'anisomap[umap]'" in table
    assert "0 of 18 rows." in (tmp_path / "out" / "quality-table.md").read_text()
    assert (tmp_path / "out" / "quality.png").read_bytes().startswith(b"\x89PNG")
    rows = rows_of(tmp_path / "out" / "quality.csv")
    assert len(rows) == len(results) + len(simulated)
    values = {row["method"]: float(row["mantel_r"]) for row in rows if row["recording"] == "skin"}
    scores = {s.method: s.mantel_r for s in comparison.scores}
    assert all(np.isclose(values[m], scores[m], equal_nan=True) for m in scores)


TRUTH = triangles()
SKIN = Skin(TRUTH, 1.0, list(np.arange(len(TRUTH)).reshape(-1, 10)))


@pytest.mark.parametrize("kind", LAYOUT_FAULTS)
@pytest.mark.parametrize("share", [0.01, 0.1])
def test_faults_change_only_their_sensors(kind, share):
    stated, groups = LAYOUT_FAULTS[kind](SKIN, share, np.random.default_rng(301))
    changed = (stated != TRUTH).any(axis=1)
    inside = np.zeros(len(TRUTH), dtype=bool)
    inside[np.concatenate(groups)] = True
    assert sum(map(len, groups)) == inside.sum()  # groups do not overlap
    assert changed.sum() >= 0.01 * len(TRUTH)
    assert not changed[~inside].any()
    distance = np.linalg.norm(stated - TRUTH, axis=1)
    if kind == "moved":
        assert MOVED[0] <= distance[inside].min() <= distance[inside].max() <= MOVED[1]
        return
    # All others permute the places of each group, or of all groups.
    taken = cdist(stated, TRUTH).argmin(axis=1)
    assert sorted(taken) == list(range(len(TRUTH)))
    if kind in ("swapped", "cycle"):
        assert distance[inside].min() >= MIN_SWAPPED


@pytest.mark.parametrize("kind", READING_FAULTS)
def test_faults_of_readings_are_in_the_readings(kind):
    recording = flat_skin(n_frames=200)
    spoilt, groups = READING_FAULTS[kind](recording, 0.1, np.random.default_rng(302))
    assert len(groups) == 4
    changed = (spoilt.readings != recording.readings).any(axis=0)
    assert set(np.flatnonzero(changed)) <= {int(group[0]) for group in groups}
    for group in groups:
        column = spoilt.readings[:, group[0]]
        expected = spoilt.readings[:, group[1]] if kind == "doubled" else 0
        np.testing.assert_array_equal(column, expected)


def test_scores_are_kept_and_summarised(tmp_path):
    results = [
        Result("skin", 100, "turned", share, 1001, 2, 2, 1, 20, 80, 1) for share in (0.01, 0.1)
    ]
    write_rows(tmp_path / "check.csv", results)
    assert read_rows(tmp_path / "check.csv", Result) == results
    assert read_rows(tmp_path / "missing.csv", Result) == []
    row = "| skin | 100 | turned | 1% to 10% | 4 | 100.0% | 50.0% | 1.25% |"
    assert table(results)[-1] == row
