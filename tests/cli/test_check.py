"""Journeys of ``anisomap check``: from a wrong position file to a corrected one."""

from dataclasses import replace

import numpy as np
import pytest

import anisomap
from anisomap import Recording, SensorMap
from skins import rubbed, triangles

TRUTH = triangles(columns=3, rows=1)
NAMES = tuple(f"taxel{i}" for i in range(len(TRUTH)))
SWAPPED = (4, 51)


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
