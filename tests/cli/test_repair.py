"""A spoilt recording is recognised, repaired and mapped on the command line."""

import json

import pytest

import anisomap


@pytest.fixture
def leaking(run, skin_npz, tmp_path):
    assert run("spoil", skin_npz, "-f", "inverted:20%", "-o", "bad.npz").code == 0
    return tmp_path / "bad.npz"


def test_info_names_a_fault_and_repair_mends_it(run, leaking, tmp_path, skin_npz):
    told = run("info", leaking)
    assert "inverted: contact has the opposite sign in 8 of 42 sensors" in told.out
    assert "can be mended: anisomap map --repair" in told.out
    repaired = run("repair", leaking, "-o", "good.npz")
    assert repaired.code == 0
    assert "mended: these sensors were mirrored" in repaired.out
    assert (tmp_path / "good.npz").is_file()
    again = json.loads(run("info", "good.npz", "--json").out)
    assert again["findings"] == []
    sound = run("repair", skin_npz, "-o", "same.npz")
    assert "No faults were found" in sound.out
    same = anisomap.read(tmp_path / "same.npz")
    assert (same.readings == anisomap.read(skin_npz).readings).all()


def test_a_map_is_made_from_the_repaired_recording(run_map, leaking, tmp_path):
    plain = run_map(leaking, "-d", 2, "-o", "plain.csv")
    assert "opposite sign" in plain.err
    mended = run_map(leaking, "-d", 2, "-o", "mended.json", "--repair", "--permutations", 0)
    assert mended.code == 0
    assert "opposite sign" not in mended.err
    assert "mended: these sensors were mirrored" in mended.out
    made = anisomap.read_map(tmp_path / "mended.json")
    assert made.provenance["repaired"] == "inverted"


@pytest.mark.parametrize("output", ["bad.npz", "out.csv"])
def test_a_repair_overwrites_nothing(run, leaking, output):
    before = leaking.read_bytes()
    refused = run("repair", leaking, "-o", output)
    assert refused.code == 2
    assert leaking.read_bytes() == before


def test_large_recordings_are_not_repaired(run, leaking):
    refused = run("map", leaking, "--repair", "--approximate", "-o", "m.csv")
    assert refused.code == 2
    assert "--repair requires a recording in memory" in refused.err
    assert len(refused.err) < 300
