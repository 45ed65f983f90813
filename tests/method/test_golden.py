"""Maps of fixed recordings are those of the record, and a difference from it is found."""

import json
import shutil

import numpy as np
import pytest
from tests.golden.__main__ import main
from tests.golden.cases import CASES, FOLDER, REAL
from tests.golden.results import SIMILAR, differences, read_record, result_of

FAST = (
    *("copies", "inverted", "sphere-potentials", "plane-walking", "torus-rubbed, halves"),
    *("sphere-rolling, r-anisomap", "hexagon-rubbed, isomap"),
)


@pytest.mark.parametrize("name", FAST)
def test_maps_are_those_of_the_record(name):
    assert not differences(read_record()[name], result_of(CASES[name]), SIMILAR)


def test_all_rows_are_recorded_and_nothing_of_real_recordings_but_numbers():
    record = read_record()
    assert set(record) == {*CASES, *REAL}
    for name in REAL:
        assert not record[name].positions.size
        assert all(isinstance(fact, str | float) for fact in record[name].facts.values())


def test_a_difference_is_reported_and_can_be_accepted(tmp_path, capsys):
    for name in ("record.json", "positions.npz"):
        shutil.copy(FOLDER / name, tmp_path)
    arguments = ["--rows", "copies", "--workers", "1", "--folder", str(tmp_path)]
    assert main(arguments) == 0
    path = tmp_path / "record.json"
    rows = json.loads(path.read_text())
    level, rows["copies"]["level"] = rows["copies"]["level"], "another"
    path.write_text(json.dumps(rows))
    positions = dict(np.load(tmp_path / "positions.npz"))
    positions["copies/positions"] *= [-1, 1, 1]  # a mirror image is the same map
    np.savez(tmp_path / "positions.npz", **positions)
    assert main(arguments) == 1
    printed = capsys.readouterr().out
    assert f"level: another became {level}" in printed
    assert "moved:" not in printed
    assert main([*arguments, "--accept"]) == 0
    assert main(arguments) == 0
