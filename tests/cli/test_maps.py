"""Journeys from a map to another one: `anisomap convert`, `diff`, `update` and `check`."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

import anisomap
from anisomap import Recording, SensorMap, io
from anisomap.placement import median_spacing
from command_line import call
from skins import flat_skin, rubbed, triangles

NEW = (3, 25, 40)
TRUTH = triangles(columns=3, rows=1)
NAMES = tuple(f"taxel{i}" for i in range(len(TRUTH)))
SWAPPED = (4, 51)


def test_two_days_are_compared(run, run_map, tmp_path):
    """Tuesday's recording has two wires swapped and a dead sensor."""
    monday, again = (flat_skin(seed=seed).readings for seed in (1, 2))
    tuesday = again.copy()
    tuesday[:, [8, 33]] = again[:, [33, 8]]
    tuesday[:, 20] = 0
    for day, readings in (("monday", monday), ("again", again), ("tuesday", tuesday)):
        anisomap.write(anisomap.Recording(readings), f"{day}.npz")
        run_map(f"{day}.npz", "-o", f"{day}.csv")
    same = run("diff", "monday.csv", "again.csv", "--json")
    assert same.values["different"] is False
    words = ("diff", "monday.csv", "tuesday.csv")
    values = run(*words, "--picture", "diff.png", "--json", code=1).values
    assert {moved["sensor"] for moved in values["moved"]} == {"s8", "s33"}
    assert values["lost"] == ["s20"]
    assert (tmp_path / "diff.png").stat().st_size > 10_000
    text = run(*words, code=1).out
    assert "s33" in text
    assert "lost: s20" in text
    assert "distance (units of the first map)" in text


def test_maps_are_converted_to_robot_formats_in_metres(run, made, tmp_path):
    outcome = run(f"convert {made}/map.csv skin.urdf --spacing 6.5mm --frame l_forearm")
    assert "6.5 mm" in outcome.out
    assert 'name="l_forearm"' in (tmp_path / "skin.urdf").read_text()
    found, before = anisomap.read_map("skin.urdf"), anisomap.read_map(made / "map.csv")
    assert median_spacing(found) == pytest.approx(0.0065)
    assert anisomap.mantel(found, before.positions, permutations=0).r == pytest.approx(1)


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


@pytest.fixture
def files(tmp_path):
    """Write a recording, its layout in metres, and one with two sensors swapped."""
    anisomap.write(Recording(rubbed(TRUTH, 1200, seed=410), names=NAMES), tmp_path / "skin.npz")
    flat = np.column_stack([TRUTH / 1000, np.zeros(len(TRUTH))])
    right = SensorMap(flat, names=NAMES, units="m")
    wrong = flat.copy()
    wrong[list(SWAPPED)] = flat[list(SWAPPED[::-1])]
    anisomap.write(right, tmp_path / "right.icub.txt")
    anisomap.write(replace(right, positions=wrong), tmp_path / "wrong.icub.txt")
    return tmp_path


def test_from_a_wrong_layout_to_a_corrected_one(run, files):
    pytest.importorskip("matplotlib", reason="needs the extra 'report'")
    outputs = "-o fixed.icub.txt --picture check.png"
    found = run(f"check wrong.icub.txt skin.npz {outputs}", code=1)
    for expected in ("not consistent", "swapped", "taxel4", "taxel51", "check.png", "60 of 60"):
        assert expected in found.out
    assert (files / "check.png").read_bytes().startswith(b"\x89PNG")
    fixed, right = (anisomap.read_map(f"{name}.icub.txt") for name in ("fixed", "right"))
    np.testing.assert_allclose(fixed.positions, right.positions, atol=1e-12)


def test_a_right_layout_is_consistent(run, files):
    rows = [f"{name},{i // 10}" for i, name in enumerate(NAMES)]
    (files / "modules.csv").write_text("sensor,module\n" + "\n".join(rows))
    for modules in (("--module-size", 10), ("--module-table", "modules.csv")):
        values = run("check", "right.icub.txt", "skin.npz", "--json", *modules).values
        assert (values["outcome"], values["findings"]) == ("consistent", [])
        assert (values["tested"], values["modules"], values["units"]) == (60, 6, "m")
        assert set(values["status"].values()) == {"ok"}
