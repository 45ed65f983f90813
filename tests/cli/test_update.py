"""Journeys of `anisomap update`: a map that is kept up to date."""

import shutil

import numpy as np
import pytest

import anisomap
from anisomap import io
from command_line import call
from skins import flat_skin

NEW = (3, 25, 40)


@pytest.fixture(scope="module")
def first_days(tmp_path_factory):
    """Make a map with statistics of a recording that lacks three sensors."""
    folder = tmp_path_factory.mktemp("days")
    monday, tuesday = flat_skin(seed=1), flat_skin(seed=2)
    kept = [i for i in range(42) if i not in NEW]
    anisomap.write(monday.select(kept), folder / "monday.npz")
    anisomap.write(tuesday, folder / "tuesday.npz")
    made = "map monday.npz -d 2 -o map.csv --spacing 6mm --keep-statistics"
    call(folder, made, "--no-verdict", "--permutations", 0)
    return folder


@pytest.fixture
def days(first_days, tmp_path):
    """The map, and the next recording."""
    shutil.copytree(first_days, tmp_path, dirs_exist_ok=True)
    return tmp_path


def test_a_map_is_updated_and_the_new_sensors_are_placed(run, days):
    files = "-o new.npz -o new.urdf --picture new.png"
    found = run(f"update map.csv tuesday.npz {files} --json").values
    assert found["added"] == [f"s{i}" for i in NEW]
    assert (found["moved"], found["not_recorded"], found["not_placed"]) == ([], [], [])
    assert (found["recordings"], found["units"]) == (2, "mm")
    assert found["similarity_agreement"] > 0.9
    updated = io.read_map(days / "new.npz")
    assert updated.units == "mm"
    rows = [updated.names.index(f"s{i}") for i in range(42)]
    result = anisomap.score(updated.select(rows), flat_skin().positions, permutations=0)
    assert result.rms_in_spacings < 0.5
    old = io.read_map(days / "map.csv")
    rows = [updated.names.index(name) for name in old.names]
    moved = np.linalg.norm(updated.positions[rows] - old.positions, axis=1)
    assert np.median(moved) < 3  # mm: the frame is that of the old map
    assert (days / "new.png").stat().st_size > 10_000
    assert len(io.read_map(days / "new.urdf").names) == 42
    again = run("update", "new.npz", "tuesday.npz", "-o", "third.csv", code=2)
    assert "part of the evidence already" in again.err
    assert not (days / "third.csv").exists()


def test_a_map_that_was_placed_since_is_updated_with_its_statistics(run, days):
    run("convert", "map.csv", "other.json", "--mirror")
    done = run("update", "other.json", "tuesday.npz", "--statistics", "map.statistics.npz")
    assert "added: s3, s25, s40" in done.out
    old, new = io.read_map(days / "other.json"), io.read_map(days / "other.updated.csv")
    assert np.nanmedian(np.linalg.norm(new.positions[:39] - old.positions, axis=1)) < 3
    assert (days / "other.updated.statistics.npz").exists()


def test_rewired_and_missing_sensors_are_named(run, days):
    readings = np.array(flat_skin(seed=2).readings)
    readings[:, [8, 33]] = readings[:, [33, 8]]
    readings[:, 20] = 0
    anisomap.write(anisomap.Recording(readings), days / "rewired.npz")
    found = run("update map.csv rewired.npz -o new.csv --json").values
    assert {moved["sensor"] for moved in found["moved"]} == {"s8", "s33"}
    assert found["not_recorded"] == ["s20"]
    assert any("2 sensors moved" in note for note in found["notes"])
