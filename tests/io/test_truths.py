"""Positions written by other programs: tables, JSON and point clouds."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapWarning

Put = Callable[[str, str | bytes], Path]
POINTS = np.array([[0.5, 1.25, -2], [3, 4, 5], [6, 7.75, 8], [-0.001, 1e-9, 12345]])


def rows(points: np.ndarray, delimiter: str = ",", names: tuple[str, ...] = ()) -> str:
    lines = [delimiter.join(map(str, point)) for point in points.tolist()]
    if names:
        lines = [delimiter.join(pair) for pair in zip(names, lines, strict=True)]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("k", [2, 3])
@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("headed", [False, True])
def test_tables(put: Put, k: int, delimiter: str, named: bool, headed: bool) -> None:
    names = ("pad1", "pad2", "pad3", "pad4") if named else ()
    header = delimiter.join((*(("name",) if named else ()), *"xyz"[:k])) + "\n" if headed else ""
    found = io.read_map(put("truth.csv", header + rows(POINTS[:, :k], delimiter, names)))
    np.testing.assert_array_equal(found.positions, POINTS[:, :k])
    assert found.names == (names or ("s0", "s1", "s2", "s3"))
    assert found.units == ""


@pytest.mark.parametrize(
    ("header", "units"),
    [
        ("x,y,z", ""),
        ("X [mm],Y [mm],Z [mm]", "mm"),
        ("x_m,y_m,z_m", "m"),
        ("x(cm),y(cm),z(cm)", "cm"),
    ],
)
def test_units_in_the_header(put: Put, header: str, units: str) -> None:
    assert io.read_map(put("truth.csv", f"{header}\n{rows(POINTS)}")).units == units


def test_columns_in_any_order_among_others(put: Put) -> None:
    text = "id,nx,z,y,x,note\n7,0.1,3,2,1,left\n8,0.2,6,5,4,\n"
    found = io.read_map(put("truth.csv", text))
    np.testing.assert_array_equal(found.positions, [[1, 2, 3], [4, 5, 6]])
    assert found.names == ("7", "8")


def test_decimal_commas(put: Put) -> None:
    found = io.read_map(put("truth.csv", "name;x;y\na;0,5;1\nb;2;3,25\n"))
    np.testing.assert_array_equal(found.positions, [[0.5, 1], [2, 3.25]])


def test_unknown_positions(put: Put) -> None:
    found = io.read_map(
        put("truth.csv", "# by hand\nname,x,y\na,1,2\nb,,\n# not found\nc,nan,nan\n")
    )
    assert found.placed.tolist() == [True, False, False]
    assert found.names == ("a", "b", "c")


def test_a_column_of_older_maps_is_ignored(put: Put) -> None:
    text = "name,x,y,component,health,excluded\na,1,2,0,ok,1\nb,3,4,0,dead,0\n"
    found = io.read_map(put("map.csv", text))
    np.testing.assert_array_equal(found.positions, [[1, 2], [3, 4]])
    assert found.health == ("ok", "dead")


def test_trailing_delimiters(put: Put) -> None:
    found = io.read_map(put("truth.csv", "x,y,\n1,2,\n3,4,\n"))
    np.testing.assert_array_equal(found.positions, [[1, 2], [3, 4]])


def test_json_needs_only_positions(put: Put) -> None:
    found = io.read_map(put("map.json", json.dumps({"sensors": [{"position": [1, None]}]})))
    assert found.names == ("s0",)
    np.testing.assert_array_equal(found.positions, [[1, np.nan]])


CLOUD = """ply
format ascii 1.0
comment made by a scanner
element vertex 3
property float x
property float y
property float z
property uchar red
element face 1
property list uchar int vertex_indices
end_header
0 0 0 255
1.5 0 0 128
0 2.5 1e-3 0
3 0 1 2
"""


def test_point_clouds_of_other_programs(put: Put) -> None:
    found = io.read_map(put("scan.ply", CLOUD))
    np.testing.assert_array_equal(found.positions, [[0, 0, 0], [1.5, 0, 0], [0, 2.5, 1e-3]])
    assert found.names == ("s0", "s1", "s2")


def test_vertices_need_not_come_first(put: Put) -> None:
    lines = CLOUD.splitlines()
    swapped = [*lines[:3], *lines[8:10], *lines[3:8], lines[10], lines[14], *lines[11:14]]
    found = io.read_map(put("scan.ply", "\r\n".join(swapped)))
    assert found.positions[2].tolist() == [0, 2.5, 1e-3]


def test_duplicate_names_are_made_distinct(put: Put, tmp_path: Path) -> None:
    twice = [{"name": "a", "position": [1, 2]}, {"name": "a", "position": [3, 4]}]
    np.savez(tmp_path / "truth.npz", names=["a", "a"], positions=[[1, 2], [3, 4]])
    for path in (
        put("truth.csv", "name,x,y\na,1,2\na,3,4\n"),
        put("truth.json", json.dumps({"sensors": twice})),
        tmp_path / "truth.npz",
    ):
        with pytest.warns(AnisomapWarning, match=r"truth.*: several sensors have the name a; they"):
            found = io.read_map(path)
        assert found.names == ("a", "a_2")
        np.testing.assert_array_equal(found.positions, [[1, 2], [3, 4]])
