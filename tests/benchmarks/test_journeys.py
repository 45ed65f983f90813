"""The journeys of users are timed in parts, with their growth, on recordings of a family."""

import csv
import math

import numpy as np
import pytest
from benchmarks.harness import quietly
from benchmarks.speed import journeys
from benchmarks.speed.journeys import MEMBERS, Journey, draw, exponents, main, markdown, travel


def journey(member, n_sensors, n_frames, cpu):
    return Journey(member, n_sensors, n_frames, 0.0, 0.0, cpu, 0.0, 0.1, 0.1, 1.0)


def test_the_growth_of_a_power_law_is_its_exponent():
    sizes = [(100, 1000), (1000, 1000), (100, 4000)]
    made = [journey("any", n, t, 3 * n**1.5 * t**0.5) for n, t in sizes]
    assert exponents(made)["any"] == pytest.approx((1.5, 0.5))
    assert all(math.isnan(value) for value in exponents(made[:1])["any"])


def test_only_missed_goals_are_marked():
    made = [journey(name, 100, 1000, 0.5) for name in "abc"]
    assert "| 5.00 | " in markdown(made, [], 0)
    assert "**" not in markdown(made, [], 0)
    slow = markdown([*made, journey("d", 100, 1000, 5.0)], [], 0)
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
    assert main([*sizes, "-o", str(tmp_path)]) == 0
    with (tmp_path / "journeys.csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert {row["member"] for row in rows} == set(members)
    assert all(float(row["map"]) > 0 for row in rows)
    table = (tmp_path / "journeys-table.md").read_text(encoding="utf-8")
    assert "anisomap --help" in table
    assert "exponent of N" in table
