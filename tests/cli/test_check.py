"""Journeys of ``anisomap check``: from a wrong position file to a corrected one."""

import json
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
    found = run(
        "check", "wrong.icub.txt", "skin.npz", "-o", "fixed.icub.txt", "--picture", "check.png"
    )  # fmt: skip
    assert found.code == 1
    for expected in ("not consistent", "swapped", "taxel4", "taxel51", "check.png", "60 of 60"):
        assert expected in found.out
    assert (files / "check.png").read_bytes().startswith(b"\x89PNG")
    fixed = anisomap.read_map("fixed.icub.txt")
    np.testing.assert_allclose(
        fixed.positions, anisomap.read_map("right.icub.txt").positions, atol=1e-12
    )

    checked = run("check", "fixed.icub.txt", "skin.npz", "--json", "--module-size", 10)
    assert checked.code == 0
    values = json.loads(checked.out)
    assert values["consistent"]
    assert values["findings"] == []
    assert values["tested"] == 60


def test_findings_as_json(run, files):
    values = json.loads(run("check", "wrong.icub.txt", "skin.npz", "--json").out)
    (finding,) = values["findings"]
    assert finding["kind"] == "swapped"
    assert [sensor["sensor"] for sensor in finding["sensors"]] == ["taxel4", "taxel51"]
    assert finding["sensors"][0]["proposed"] == pytest.approx([*(TRUTH[4] / 1000), 0])
    assert finding["agreement_proposed"] > finding["agreement_stated"] + finding["chance"]
    assert values["status"]["taxel5"] == "ok"
    assert values["units"] == "m"


def test_modules_from_a_table(run, files):
    rows = [f"{name},{i // 10}" for i, name in enumerate(NAMES)]
    (files / "modules.csv").write_text("sensor,module\n" + "\n".join(rows))
    found = run("check", "right.icub.txt", "skin.npz", "--modules", "modules.csv", "-q")
    assert (found.code, found.out) == (0, "")
    both = run(
        "check", "right.icub.txt", "skin.npz", "--modules", "modules.csv", "--module-size", 10
    )
    assert both.code == 2
    assert "not by both" in both.err


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["missing.csv", "skin.npz"], "missing.csv"),
        (["right.icub.txt", "missing.npz"], "missing.npz"),
        (["skin.npz", "right.icub.txt"], "no positions"),
        (["right.icub.txt", "short.npz"], "at least 40 frames"),
        (["other.csv", "skin.npz"], "cannot be matched"),
        (["right.icub.txt", "skin.npz", "-o", "right.icub.txt"], "also an input"),
        (["right.icub.txt", "skin.npz", "-o", "skin.npz"], "also an input"),
        (["right.icub.txt", "skin.npz", "-o", "fixed.xyz"], "unknown suffix"),
        (["plain.csv", "skin.npz", "-o", "fixed.urdf"], "metres"),
        (["right.icub.txt", "skin.npz", "--picture", "p.bmp"], "p.bmp"),
        (["right.icub.txt", "skin.npz", "--module-size", "50"], "size of modules"),
    ],
)
def test_bad_input_is_one_sentence_and_writes_nothing(run, files, arguments, expected):
    anisomap.write(Recording(rubbed(TRUTH, 20), names=NAMES), files / "short.npz")
    (files / "other.csv").write_text("name,x,y\na,0,0\nb,1,0\nc,0,1\n")
    lines = [f"{name},{x},{y}" for name, (x, y) in zip(NAMES, TRUTH, strict=True)]
    (files / "plain.csv").write_text("name,x,y\n" + "\n".join(lines))
    before = {path.name: path.read_bytes() for path in files.iterdir()}
    found = run("check", *arguments)
    assert found.code == 2
    assert expected in found.err
    assert found.err.count("\n") == 1
    assert len(found.err) < 320
    assert {path.name: path.read_bytes() for path in files.iterdir()} == before
