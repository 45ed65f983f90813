"""The benchmarks run, measure the stated quantities and detect wrong results."""

import csv
import os
from dataclasses import replace

import numpy as np
import pytest
from benchmarks import (
    comparison,
    measuring,
    paths,
    placement,
    scalings,
    self_touch,
    similarities,
    updating,
    whole_maps,
)
from benchmarks.__main__ import main
from benchmarks.comparison import Comparison, Reference, Row, run
from benchmarks.inputs import flat_skin, round_skin, rubbed_skin, tiled_torso
from benchmarks.measuring import measure, threads
from benchmarks.stages import STAGES
from benchmarks.tables import growth_exponent, markdown
from threadpoolctl import threadpool_info

from anisomap.numerics.compiled import parallel


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
    monkeypatch.setattr(comparison, "n_cores", lambda: 1)
    monkeypatch.setattr(similarities, "N_PAIRS", 20)
    monkeypatch.setattr(scalings, "MAX_STEPS", 50)


def rows_of(path):
    with path.open(encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


@pytest.mark.slow
def test_all_stages_on_small_skins(tmp_path, recordings, small_shares, capsys):
    folder = tmp_path / "out"
    sizes = ["30", "40"]
    given = ["--recordings", str(recordings), "--sensors", *sizes, "--frames", "400"]
    assert main([*given, "--output", str(folder)]) == 0
    assert {path.name for path in folder.iterdir()} == {
        "bench-table.md",
        "bench.csv",
        "bench.png",
    }
    rows = rows_of(folder / "bench.csv")
    assert {row["family"] for row in rows} == {family for family, _ in STAGES.values()}
    assert {row["n_sensors"] for row in rows} == set(sizes)
    assert all(float(row["cpu"]) > 0 and float(row["clock_all_cores"]) > 0 for row in rows)
    verdicts = [row["same"] for row in rows if row["reference"]]
    assert set(verdicts) - {"True"} == {v for v in verdicts if v.startswith("another map")}
    assert verdicts.count("True") > 40
    table = (folder / "bench-table.md").read_text(encoding="utf-8")
    assert "NO" not in table
    assert "| N | stage |" in table
    assert "exponent of N" in table
    assert (folder / "bench.png").read_bytes().startswith(b"\x89PNG")
    assert "torso, tiled" in capsys.readouterr().out


@pytest.mark.slow
def test_slow_references_do_a_share_of_the_work(tmp_path, small_shares, monkeypatch):
    for module in (similarities, paths, scalings, whole_maps):
        monkeypatch.setattr(module, "MAX_REFERENCE_SENSORS", 30)
    for module in (similarities, whole_maps):
        monkeypatch.setattr(module, "MAX_ONE_HOT", 100)
    given = ["--sensors", "61", "--frames", "600", "--output", str(tmp_path)]
    assert main(given) == 0
    rows = [row for row in rows_of(tmp_path / "bench.csv") if row["reference"]]
    assert {row["estimated"] for row in rows} == {"True"}
    assert {row["same"] for row in rows if row["stage"] != "whole map from dissimilarities"} == {
        "True"
    }
    by_stage = {row["stage"]: row["details"] for row in rows}
    assert by_stage["metricising"] == "30 sensors x 8.41"
    assert by_stage["Torgerson"] == "30 sensors x 8.41"
    assert by_stage["SMACOF, 30 iterations"] == "30 sensors x 4.13"


def test_a_wrong_result_is_reported_and_fails(tmp_path, small_shares, monkeypatch, capsys):
    monkeypatch.setattr(
        similarities, "pearson", lambda readings: 0.5 * similarities.correlation(readings)
    )
    given = ["--sensors", "40", "--frames", "300", "--stages", "pearson"]
    assert main([*given, "--output", str(tmp_path)]) == 1
    assert "**NO**" in (tmp_path / "bench-table.md").read_text(encoding="utf-8")
    assert "WRONG: Pearson r" in capsys.readouterr().err


def test_figures_of_the_documentation_go_to_its_static_folder(tmp_path, small_shares):
    (tmp_path / "_static").mkdir()
    given = ["--sensors", "40", "--frames", "300", "--stages", "torgerson"]
    assert main([*given, "--output", str(tmp_path)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["_static", "bench-table.md"]
    assert sorted(path.name for path in (tmp_path / "_static").iterdir()) == [
        "bench.csv",
        "bench.png",
    ]


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.4, 3.0])
def test_the_exponent_of_a_power_law(exponent):
    sizes = np.array([256, 1000, 4000])
    assert growth_exponent(sizes, 3e-7 * sizes**exponent) == pytest.approx(exponent)


def row(**known):
    usual = Row(4000, "family", "stage", "input", 1.0, 1.0, 1.0, 0.5, 10.0)
    return replace(usual, reference="library", reference_cpu=40.0, same=True, **known)


def test_only_a_missed_goal_is_marked():
    assert "| **40.0** | 50 (missed) | yes |" in markdown([row(goal=50)], 100)
    assert "| 40.0 | 30 | yes |" in markdown([row(goal=30)], 100)


def test_growth_is_reported_as_an_exponent():
    rows = [row(), replace(row(), n_sensors=8000, cpu=4.0, reference_cpu=320.0)]
    assert "| 4,000 | 8,000 | 2.0 | library | 3.0 |" in markdown(rows, 100)


@pytest.mark.skipif(
    not os.access("/proc/self/clear_refs", os.W_OK),
    reason="only Linux reports and resets the peak of memory",
)
def test_the_memory_of_fifty_megabytes():
    cost, _ = measure(lambda: np.ones(50_000_000, np.uint8).sum())
    assert cost.memory == pytest.approx(50, abs=5)
    cost, _ = measure(lambda: None)
    assert cost.memory == pytest.approx(0, abs=5)


def test_one_thread_is_one_thread():
    with threads(1):
        assert parallel.thread_count() == 1
        assert {found["num_threads"] for found in threadpool_info()} <= {1}


def test_a_comparison_is_checked_once_and_gives_a_row_per_reference():
    checked = []

    def same(result):
        checked.append(result)
        return result == 3

    cost = measuring.Cost(2.0, 2.0)
    references = (Reference("one", cost, same, goal=7), Reference("two", cost, lambda _: "other"))
    small, large = (
        list(run(Comparison("s", "i", lambda: 3, references), "f", n)) for n in (10, 4000)
    )
    assert checked == [3, 3]
    assert [found.same for found in small] == [True, "other"]
    assert [found.goal for found in small + large] == [None, None, 7, None]


def test_slightly_longer_paths_are_rejected():
    lengths = flat_skin(60)
    right = paths.metricise(lengths)
    assert paths.are_shortest_paths(right, lengths)
    assert not paths.are_shortest_paths(lengths, lengths)
    assert not paths.are_shortest_paths(right * (1 + 1e-9), lengths)


def test_eigenvectors_are_recognised():
    metric = paths.metricise(flat_skin(80))
    assert paths.are_eigenvectors(paths.torgerson(metric, 3), metric)
    assert not paths.are_eigenvectors(paths.torgerson(metric, 3) * 1.01, metric)
    assert not paths.are_eigenvectors(np.random.default_rng(0).normal(size=(80, 3)), metric)


@pytest.mark.parametrize("make", [flat_skin, round_skin])
def test_skins_are_connected_semi_metrics(make):
    lengths = make(50)
    np.testing.assert_array_equal(lengths, lengths.T)
    assert np.isfinite(lengths).all()
    assert (lengths[~np.eye(50, dtype=bool)] > 0).all()


def test_tiles_are_connected_and_shifted_in_time(recordings):
    path = recordings / "icub_torso.npz"
    tiled = tiled_torso(path, 100, 300)
    assert tiled.shape == (300, 100)
    n_sensors = tiled_torso(path, 40, 300).shape[1]
    alike = np.corrcoef(tiled.T)
    assert alike[:n_sensors, n_sensors : 2 * n_sensors].max() > 0.5  # across the joint
    assert np.abs(alike[:10, 2 * n_sensors :]).max() < 0.5  # far apart


@pytest.mark.slow
def test_placed_maps_are_measured(tmp_path):
    output = tmp_path / "placement.csv"
    placement.main(["--bodies", "sphere", "--draws", "6", "-o", str(output)])
    found = {row["measure"]: row for row in rows_of(output)}
    error = found["mesh and 3 anchors: median error (spacings)"]
    assert 0 < float(error["median"]) < 1
    assert float(found["mesh and 3 anchors: share of the right hand where placed"]["median"]) == 1


@pytest.mark.slow
def test_the_accuracy_of_self_touch_is_measured(tmp_path):
    output = tmp_path / "self-touch.csv"
    self_touch.main(["--seeds", "1", "--contacts", "30", "-o", str(output)])
    with output.open(encoding="utf-8") as file:
        found = list(csv.DictReader(file))
    assert [row["taxel positions"] for row in found] == ["known", "from a map"] * 2
    assert all(0 < float(row["in spacings"]) < 0.6 for row in found)


@pytest.mark.slow
def test_the_accuracy_of_updates_is_measured(tmp_path):
    output = tmp_path / "updating.csv"
    updating.main(["--only", "plane", "--draws", "1", "-o", str(output)])
    found = {row["measure"]: float(row["median"]) for row in rows_of(output)}
    assert 0 < found["new sensors: RMS error in the update (spacings)"] < 0.6
    assert found["2 sensors 3 spacings apart or more exchanged: share named"] == 1
    assert found["share of unchanged sensors accused"] == 0
