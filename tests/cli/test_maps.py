"""Journeys from a map to another one: `anisomap convert`, `diff` and `check`."""

from dataclasses import replace

import numpy as np
import pytest

import anisomap
from anisomap import Recording, SensorMap
from anisomap.placement import median_spacing
from skins import flat_skin, rubbed, triangles

TRUTH = triangles(columns=3, rows=1)
NAMES = tuple(f"taxel{i}" for i in range(len(TRUTH)))
SWAPPED = (4, 51)


def test_two_days_are_compared(run, run_map):
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
    values = run(*words, "--json", code=1).values
    assert {moved["sensor"] for moved in values["moved"]} == {"s8", "s33"}
    assert values["lost"] == ["s20"]
    assert values["smallest_move"] < min(moved["distance"] for moved in values["moved"])
    text = run(*words, code=1).out
    assert "s33" in text
    assert "cannot be told from chance" in text
    assert "lost: s20" in text
    assert "distance (units of the first map)" in text


def test_maps_are_converted_to_robot_formats_in_metres(run, made, tmp_path):
    outcome = run(f"convert {made}/map.csv skin.urdf --spacing 6.5mm --frame l_forearm")
    assert "6.5 mm" in outcome.out
    assert 'name="l_forearm"' in (tmp_path / "skin.urdf").read_text()
    found, before = anisomap.read_map("skin.urdf"), anisomap.read_map(made / "map.csv")
    assert 0.005 < median_spacing(found) < 0.0065  # shortened by errors of positions
    assert anisomap.mantel(found, before.positions, permutations=0).r == pytest.approx(1)


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


@pytest.mark.parametrize("n_frames", [60, 600])
def test_nobody_is_told_to_touch_electrodes(n_frames, run, tmp_path):
    rng = np.random.default_rng(5)
    potentials = rng.normal(size=(n_frames, 14)) @ rng.normal(size=(14, 14)) * 1e-5
    told_by = {"format": "mne", "channels": "eeg"}  # of what Recording(raw) takes
    anisomap.write(Recording(potentials, rate_hz=250.0, metadata=told_by), tmp_path / "run.npz")
    told = run("map", "run.npz")
    assert "the verdict follows" in told.out
    assert "touch" not in told.out + told.err


def test_a_far_electrode_does_not_keep_the_others_from_a_file(run, tmp_path):
    """It is a component of its own, which a format with one frame cannot hold."""
    places = np.random.default_rng(0).normal(size=(12, 3))
    cap = SensorMap(places, names=[f"E{i}" for i in range(12)], component=[0] * 11 + [1], units="m")
    anisomap.write(cap, tmp_path / "cap.csv")
    assert "--drop" in run("convert", "cap.csv", "cap.icub.txt", code=2).err
    run("convert", "cap.csv", "cap.icub.txt", "--drop", "E11")
    assert anisomap.read_map(tmp_path / "cap.icub.txt").n_sensors == 11
    refused = run("convert", "cap.csv", "cap.icub.txt", "--drop", "E0-E11", code=2)
    assert "leaves out all" in refused.err


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
