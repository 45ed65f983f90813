"""Displays of an iCub's skin: read and written as layouts, and checked against logs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import anisomap
from anisomap import SensorMap
from anisomap.base.channels import PADS, TACTILE
from anisomap.errors import AnisomapWarning, FileError, InputError
from anisomap.io.maps.skin_displays import read_display, write_display
from skins import rubbed


@pytest.mark.filterwarnings("ignore:.*triangles lie on each other")
@given(data=st.data())
def test_what_is_written_is_read_back(data, tmp_path_factory):
    numbers = data.draw(st.lists(st.integers(0, 63), min_size=1, max_size=6, unique=True))
    positions, names = [], []
    for n in sorted(numbers):
        angle = np.deg2rad(data.draw(st.integers(-360, 360)))
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        side = data.draw(st.sampled_from([1, -1]))
        place = data.draw(st.tuples(*2 * [st.floats(-300, 300)]))
        positions.append(PADS[[*TACTILE]] * [side, 1] @ turn + place)
        names += [f"b{n // 16}.t{n % 16}.k{pad}" for pad in TACTILE]
    layout = SensorMap(np.vstack(positions), names=names, units="mm", frame="torso")
    path = tmp_path_factory.mktemp("display") / "torso.ini"
    anisomap.write(layout, path)
    found = anisomap.read_map(path)
    assert (found.names, found.units, found.frame) == (layout.names, "mm", "torso")
    np.testing.assert_allclose(found.positions, layout.positions, atol=2e-3)


def test_triangles_on_each_other_are_told(tmp_path):
    rows = ["triangle_10pad 3 0 0 0", "triangle_10pad 5 9 0 60", "triangle_10pad 7 40 0 0"]
    path = tmp_path / "part.ini"
    path.write_text("\n".join(["[SENSORS]", *rows]))
    with pytest.warns(AnisomapWarning, match="3 and 5, 9 mm apart; triangles side by side are 18"):
        read_display(path)


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ("fingertip3R 1 2 3 4", "line 2: 'fingertip3R' is not triangle_10pad"),
        ("triangle_10pad 1 2 3", "line 2 must be .* got 4 fields"),
        ("triangle_10pad 1 2 nan 4", "must have finite numbers"),
        ("triangle_10pad 1 2 3 4\ntriangle_10pad 1 9 3 4", "line 3: triangle 1 is placed twice"),
    ],
)
def test_damaged_displays_are_refused(lines, expected, tmp_path):
    path = tmp_path / "torso.ini"
    path.write_text(f"[SENSORS]\n{lines}\n")
    with pytest.raises(FileError, match=expected):
        read_display(path)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"names": [f"left {i}a" for i in range(10)]}, "needs names of pads"),
        ({"units": "spacings"}, "needs a map of 2 dimensions"),
        ({"positions": 1.3 * PADS[[*TACTILE]]}, "not placed as pads of a triangle"),
    ],
)
def test_other_maps_are_not_written(change, expected, tmp_path):
    names = [f"b0.t2.k{pad}" for pad in TACTILE]
    layout = SensorMap(PADS[[*TACTILE]], names=names, units="mm")
    with pytest.raises(InputError, match=expected):
        write_display(replace(layout, **change), tmp_path / "torso.ini")


def test_a_display_is_checked_against_a_log(run, tmp_path):
    """Six triangles around a point, of which the display states one turned."""
    rows = []
    for k in range(6):
        angle = np.deg2rad(60 * k)
        x, y = 15 * np.array([np.cos(angle), np.sin(angle)])
        rows.append((k, x, y, 60 * k + 90))

    def display(path, turned):
        lines = [
            f"triangle_10pad {k} {x} {y} {angle + 120 * (k == turned)} 4 0"
            for k, x, y, angle in rows
        ]
        path.write_text("\n".join(["robotPart left_forearm", "[SENSORS]", *lines, ""]))

    display(tmp_path / "right.ini", -1)
    display(tmp_path / "wrong.ini", 4)
    right = read_display(tmp_path / "right.ini")
    readings = rubbed(right.positions / 6.533, 2500, seed=440)
    values = np.zeros((len(readings), 192), int)
    indices = [12 * k + pad for k in range(6) for pad in TACTILE]
    values[:, indices] = np.round(100 * readings / readings.max())
    (tmp_path / "run").mkdir()
    with (tmp_path / "run" / "data.log").open("w") as log:
        for i, frame in enumerate(values):
            print(i, f"{1.7e9 + i / 20:.6f}", *frame, file=log)
    (tmp_path / "run" / "info.log").write_text("Type: Bottle;\n")
    pads = [f"P{i},{x},{y}" for i, (x, y) in enumerate(PADS.tolist())]
    (tmp_path / "triangle.csv").write_text("\n".join(["name,x [mm],y [mm]", *pads]))
    modules = "--module-layout triangle.csv --module-size 12"
    for preset in ("--preset icub", ""):
        found = run(f"check wrong.ini run {preset} {modules} -o fixed.ini", code=1)
        assert "module b0.t4.k0 to b0.t4.k11 is turned by 120 degrees" in found.out
        fixed = anisomap.read_map(tmp_path / "fixed.ini")
        np.testing.assert_allclose(fixed.positions, right.positions, atol=2e-2)
        run(f"check fixed.ini run {preset} {modules}")
        (tmp_path / "fixed.ini").unlink()
    run("check wrong.ini run --preset icub --module-layout triangle.csv", code=2)
