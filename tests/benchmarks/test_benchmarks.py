"""The benchmarks run, measure the stated quantities and detect wrong results."""

import csv
import os
import sys
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.__main__ import main
from benchmarks.accuracy import contacts, dimension, limits, quality, steps
from benchmarks.placing import placement, self_touch, updating
from benchmarks.skins.inputs import flat_skin, rubbed_skin
from benchmarks.speed import measuring, stages
from benchmarks.speed.measuring import Comparison, Reference, Row, measure, run, threads
from benchmarks.speed.tables import markdown
from benchmarks.verdicts import trust
from threadpoolctl import threadpool_info

import anisomap
from anisomap.numerics.compiled import parallel
from skins import flat_skin as flat_touched_skin


@pytest.fixture
def recordings(tmp_path):
    """Give a folder with a binary recording of a field of triangles, shaped as the real one."""
    folder = tmp_path / "recordings"
    folder.mkdir()
    readings, places = rubbed_skin(40, 1000)
    np.savez(folder / "icub_torso.npz", readings=(readings > 0) * 1.0, positions=places)
    return folder


@pytest.fixture
def small_shares(monkeypatch):
    monkeypatch.setattr(measuring, "MIN_SECONDS", 0)
    monkeypatch.setattr(measuring, "n_cores", lambda: 1)
    for name, value in {"N_PAIRS": 20, "MAX_REFERENCE_SENSORS": 30, "MAX_ONE_HOT": 100}.items():
        monkeypatch.setattr(stages, name, value)


def rows_of(path):
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.slow
def test_all_stages_on_small_skins(tmp_path, recordings, small_shares, capsys):
    """Of 61 sensors, the slow references do a share of the work."""
    folder = tmp_path / "out"
    given = ["--recordings", str(recordings), "--sensors", "30", "61", "--frames", "400"]
    assert main([*given, "--output", str(folder)]) == 0
    names = {path.name for path in folder.iterdir()}
    assert names == {"bench-table.md", "bench.csv", "bench.png"}
    rows = rows_of(folder / "bench.csv")
    assert {row["family"] for row in rows} == {family for family, _ in stages.STAGES.values()}
    assert all(float(row["cpu"]) >= 0 and float(row["clock_all_cores"]) >= 0 for row in rows)
    assert {row["same"] for row in rows} == {"True"}
    shares = {row["stage"]: row["details"] for row in rows if row["n_sensors"] == "61"}
    assert shares["metricising"] == "30 sensors x 8.41"
    assert shares["Torgerson"] == "30 sensors x 8.41"
    assert shares["Spearman rho"].startswith("30 sensors x ")
    assert not shares["SMACOF"]
    table = (folder / "bench-table.md").read_text(encoding="utf-8")
    assert "NO" not in table
    assert "exponent of N" in table
    assert (folder / "bench.png").read_bytes().startswith(b"\x89PNG")
    assert "torso, tiled" in capsys.readouterr().out


def test_a_wrong_result_is_reported_and_fails(tmp_path, small_shares, monkeypatch, capsys):
    monkeypatch.setattr(stages, "pearson", lambda readings: 0.5 * np.corrcoef(readings.T))
    (tmp_path / "_static").mkdir()  # as in the documentation: figures go there
    given = ["--sensors", "40", "--frames", "300", "--stages", "pearson", "torgerson"]
    assert main([*given, "--output", str(tmp_path)]) == 1
    table = (tmp_path / "bench-table.md").read_text(encoding="utf-8")
    wrong = [line.split("|")[2].strip() for line in table.splitlines() if "**NO**" in line]
    assert set(wrong) == {"Pearson r"}
    assert "WRONG: Pearson r" in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {"_static", "bench-table.md"}
    assert {path.name for path in (tmp_path / "_static").iterdir()} == {"bench.csv", "bench.png"}


def row(**known):
    times = (1.0, 1.0, 1.0, 0.5, 10.0)
    usual = Row(4000, "family", "stage", "input", *times, "library", "", 40.0, 1.0, None, same=True)
    return replace(usual, **known)


def test_only_a_missed_goal_is_marked_and_growth_is_an_exponent():
    assert "| **40.0** | 50 (missed) | yes |" in markdown([row(goal=50)], 100)
    assert "| 40.0 | 30 | yes |" in markdown([row(goal=30)], 100)
    rows = [row(), replace(row(), n_sensors=8000, cpu=4.0, reference_cpu=320.0)]
    assert "| 4,000 | 8,000 | 2.0 | library | 3.0 |" in markdown(rows, 100)


@pytest.mark.skipif(
    not os.access("/proc/self/clear_refs", os.W_OK),
    reason="only Linux reports and resets the peak of memory",
)
def test_memory_is_that_of_the_largest_array():
    cost, _ = measure(lambda: np.ones(200_000_000, np.uint8).sum())
    nothing, _ = measure(lambda: None)
    assert 100 < cost.memory < 400
    assert abs(nothing.memory) < 50


def test_one_thread_is_one_thread():
    with threads(1):
        assert parallel.thread_count() == 1
        assert {found["num_threads"] for found in threadpool_info()} <= {1}


def test_a_comparison_gives_a_row_per_reference():
    references = (
        Reference("one", lambda: 3, lambda result, expected: result == expected, goal=7),
        Reference("two", lambda: 4, lambda result, expected: result == expected),
        Reference("three", lambda: 3, lambda *_: True, share="part", factor=4),
    )
    small, large = (
        list(run(Comparison("s", "i", lambda: 3, references), "f", n)) for n in (10, 4000)
    )
    assert [found.same for found in small] == [True, False, True]
    assert [found.details for found in small] == ["", "", "part x 4"]
    assert [found.goal for found in small + large] == [None] * 3 + [7, None, None]


def test_slightly_wrong_paths_and_eigenvectors_are_rejected():
    lengths = flat_skin(60)
    right = stages.metricise(lengths)
    assert stages.are_shortest_paths(right, lengths)
    assert not stages.are_shortest_paths(lengths, lengths)
    assert not stages.are_shortest_paths(right * (1 + 1e-9), lengths)
    vectors = stages.torgerson(right, 3)
    assert stages.are_eigenvectors(vectors, right)
    assert not stages.are_eigenvectors(vectors * 1.01, right)
    assert not stages.are_eigenvectors(np.random.default_rng(0).normal(size=(60, 3)), right)


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
    anisomap.write(flat_touched_skin(n_frames=1200), recordings / "retina_skin.npz")
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


@pytest.mark.slow
def test_the_accuracy_of_self_touch_is_measured(tmp_path):
    known = ["--seeds", "1", "--contacts", "30"]
    found = measured(self_touch, tmp_path, "taxel positions", *known)
    assert set(found) == {"known", "from a map"}
    assert all(0 < float(row["in spacings"]) < 1 for row in found.values())


@pytest.mark.slow
def test_the_accuracy_of_updates_is_measured(tmp_path):
    found = measured(updating, tmp_path, "measure", "--only", "sphere", "--draws", "1")
    medians = {measure: float(row["median"]) for measure, row in found.items()}
    assert 0 < medians["new sensors: RMS error in the update (spacings)"] < 1
    named = medians["2 sensors 3 spacings apart or more exchanged: share named"]
    assert named > medians["share of unchanged sensors accused"]
