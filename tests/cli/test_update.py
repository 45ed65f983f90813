"""Journeys of `anisomap update`: a map that is kept up to date."""

import json

import numpy as np
import pytest

import anisomap
from anisomap import io
from skins import flat_skin

NEW = (3, 25, 40)


@pytest.fixture
def days(run_map, tmp_path):
    """A map with statistics of a recording that lacks three sensors, and the next recording."""
    monday, tuesday = flat_skin(seed=1), flat_skin(seed=2)
    kept = [i for i in range(42) if i not in NEW]
    anisomap.write(monday.select(kept), tmp_path / "monday.npz")
    anisomap.write(tuesday, tmp_path / "tuesday.npz")
    done = run_map("monday.npz", "-d", 2, "-o", "map.csv", "--spacing", "6mm", "--keep-statistics")
    assert done.code == 0, done.err
    return tmp_path


def test_a_map_is_updated_and_the_new_sensors_are_placed(run, days):
    done = run("update", "map.csv", "tuesday.npz", "-o", "new.npz", "-o", "new.urdf",
               "--picture", "new.png", "--json")  # fmt: skip
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert found["added"] == [f"s{i}" for i in NEW]
    assert (found["moved"], found["not_recorded"], found["not_placed"]) == ([], [], [])
    assert (found["recordings"], found["units"]) == (2, "mm")
    assert found["agreement"] > 0.9
    updated = io.read_map(days / "new.npz")
    assert updated.units == "mm"
    names = [updated.names.index(f"s{i}") for i in range(42)]
    result = anisomap.score(updated.select(names), flat_skin().positions, permutations=0)
    assert result.rms_in_spacings < 0.3
    old = io.read_map(days / "map.csv")
    rows = [updated.names.index(name) for name in old.names]
    moved = np.linalg.norm(updated.positions[rows] - old.positions, axis=1)
    assert moved.max() < 3  # mm: the frame is that of the old map
    assert (days / "new.png").stat().st_size > 10_000
    assert len(io.read_map(days / "new.urdf").names) == 42
    again = run("update", "new.npz", "tuesday.npz", "-o", "third.csv")
    assert again.code == 2
    assert "part of the evidence already" in again.err
    assert not (days / "third.csv").exists()


def test_a_map_that_was_placed_since_is_updated_with_its_statistics(run, days):
    assert run("convert", "map.csv", "other.json", "--mirror").code == 0
    done = run("update", "other.json", "tuesday.npz", "--statistics", "map.statistics.npz")
    assert done.code == 0, done.err
    assert "added: s3, s25, s40" in done.out
    old, new = io.read_map(days / "other.json"), io.read_map(days / "other.updated.csv")
    assert np.nanmedian(np.linalg.norm(new.positions[:39] - old.positions, axis=1)) < 1.5
    assert (days / "other.updated.statistics.npz").exists()


def test_rewired_and_missing_sensors_are_named(run, days):
    tuesday = io.read(days / "tuesday.npz")
    readings = np.array(tuesday.readings)
    readings[:, [8, 33]] = readings[:, [33, 8]]
    readings[:, 20] = 0
    anisomap.write(anisomap.Recording(readings), days / "rewired.csv")
    done = run("update", "map.csv", "rewired.csv", "-o", "new.csv", "--json")
    assert done.code == 0, done.err
    found = json.loads(done.out)
    assert {moved["sensor"] for moved in found["moved"]} == {"s8", "s33"}
    assert found["not_recorded"] == ["s20"]
    assert any("2 sensors moved" in note for note in found["notes"])
    text = run("update", "map.csv", "rewired.csv", "-o", "new.csv").out
    assert "Sensors that moved" in text
    assert "not recorded: s20" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["map.csv", "absent.npz"], "absent.npz"),
        (["map.csv", "tuesday.npz", "-o", "map.csv"], "also an input"),
        (["map.csv", "tuesday.npz", "-o", "map.npz"], "also an input"),  # its statistics are
        (["bare.csv", "tuesday.npz"], "--keep-statistics"),
        (["map.csv", "tuesday.npz", "--statistics", "map.csv"], "map.csv"),
        (["map.csv", "tuesday.npz", "--level", "2"], "level must be between 0 and 1"),
        (["map.csv", "zero.csv"], "no evidence"),
        (["map.csv", "tuesday.npz", "-o", "new.xyz"], "suffix"),
    ],
)
def test_what_cannot_be_updated_is_one_message(run, days, arguments, message):
    (days / "bare.csv").write_bytes((days / "map.csv").read_bytes())
    anisomap.write(anisomap.Recording(np.zeros((20, 42))), days / "zero.csv")
    before = {path: path.read_bytes() for path in days.iterdir()}
    done = run("update", *arguments)
    assert done.code == 2
    assert message in done.err
    assert {path: path.read_bytes() for path in days.iterdir()} == before


def test_statistics_need_a_recording_in_memory(run_map, days):
    done = run_map("monday.npz", "--workers", 2, "--keep-statistics")
    assert done.code == 2
    assert "--keep-statistics" in done.err
