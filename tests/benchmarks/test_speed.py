"""Benchmarks of speed run, measure the stated quantities and detect wrong results."""

import csv
import math
import os
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.__main__ import main
from benchmarks.harness import quietly
from benchmarks.skins.inputs import flat_skin, rubbed_skin
from benchmarks.speed import journeys, measuring, stages
from benchmarks.speed.journeys import MEMBERS, Journey, draw, exponents, travel
from benchmarks.speed.measuring import Comparison, Reference, Row, measure, run, threads
from benchmarks.speed.tables import markdown
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


def journey(member, n_sensors, n_frames, cpu):
    return Journey(member, n_sensors, n_frames, 0.0, 0.0, cpu, 0.0, 0.1, 0.1, 1.0)


def test_the_growth_of_a_power_law_is_its_exponent():
    sizes = [(100, 1000), (1000, 1000), (100, 4000)]
    made = [journey("any", n, t, 3 * n**1.5 * t**0.5) for n, t in sizes]
    assert exponents(made)["any"] == pytest.approx((1.5, 0.5))
    assert all(math.isnan(value) for value in exponents(made[:1])["any"])


def test_only_missed_goals_are_marked():
    made = [journey(name, 100, 1000, 0.5) for name in "abc"]
    assert "| 5.00 | " in journeys.markdown(made, [], 0)
    assert "**" not in journeys.markdown(made, [], 0)
    slow = journeys.markdown([*made, journey("d", 100, 1000, 5.0)], [], 0)
    assert slow.count("**") == 2
    assert "| **10.0** | d |" in slow


@pytest.mark.parametrize("member", MEMBERS)
def test_members_are_drawn_from_seeds(member):
    first, again, other = (draw(member, 30, 200, seed).readings for seed in (1, 1, 2))
    assert first.shape == (200, 30)
    assert np.isfinite(first).all()
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("member", ["8 bits, exact rest", "pure noise"])
def test_all_parts_of_a_journey_are_timed(member):
    with quietly():
        parts = travel(draw(member, 30, 600, 0))
    assert len(parts) == 4
    assert all(part > 0 for part in parts)


def test_neighbours_end_with_the_block():
    with journeys.busy_neighbours(2) as processes:
        assert [process.poll() for process in processes] == [None, None]
    assert all(process.returncode is not None for process in processes)


@pytest.mark.slow
def test_all_journeys_of_small_skins(tmp_path, monkeypatch):
    monkeypatch.setattr(journeys, "RUNS", 1)
    commands = {"anisomap --help": ["-m", "anisomap", "--help"]}
    monkeypatch.setattr(journeys, "shell_commands", lambda *_: commands)
    members = [*MEMBERS][::7]
    sizes = ["--sizes", "20x400", "30x400", "30x800", "--seed", "3", "--members", *members]
    assert journeys.main([*sizes, "-o", str(tmp_path)]) == 0
    rows = rows_of(tmp_path / "journeys.csv")
    assert {row["member"] for row in rows} == set(members)
    assert all(float(row["map"]) > 0 for row in rows)
    table = (tmp_path / "journeys-table.md").read_text(encoding="utf-8")
    assert "anisomap --help" in table
    assert "exponent of N" in table
