"""``anisomap map`` chooses the number of dimensions, or takes a given one."""

import json

import pytest

import anisomap

LOOKS_FLAT = "this looks flat"


def test_the_command_says_what_it_chose(run_map, skin_npz, tmp_path):
    made = run_map(skin_npz, "-o", "m.json", "--permutations", 0)
    assert made.code == 0
    assert "2, chosen: a third dimension explains no more than chance" in made.out
    assert anisomap.read_map(tmp_path / "m.json").dimensions == 2
    printed = json.loads(run_map(skin_npz, "-o", "n.json", "--permutations", 0, "--json").out)
    assert printed["map"]["provenance"]["chosen_dimensions"] == 2


def test_the_command_notes_a_flat_skin_in_3_dimensions(run_map, skin_npz, tmp_path):
    made = run_map(skin_npz, "-d", 3, "-o", "m.csv", "--permutations", 0)
    assert made.code == 0
    assert LOOKS_FLAT in made.err
    assert anisomap.read_map(tmp_path / "m.csv").dimensions == 3


@pytest.mark.parametrize("dimensions", ["0", "1.5", "flat", "100"])
def test_the_command_refuses_other_numbers(run_map, skin_npz, tmp_path, dimensions):
    made = run_map(skin_npz, "-d", dimensions, "-o", "m.csv")
    assert made.code == 2
    assert dimensions in made.err
    assert not (tmp_path / "m.csv").exists()
