"""Positions written by other programs: tables, JSON and point clouds."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapWarning
from texts import NAN, compare, hold, table

POINTS = np.array([[0.5, 1.25, -2], [3, 4, 5], [6, 7.75, 8], [-0.001, 1e-9, 12345]])
UNNAMED = ("s0", "s1", "s2", "s3")


def positions(k: int, delimiter: str, *, named: bool, headed: bool) -> tuple[str, dict[str, Any]]:
    names = ("pad1", "pad2", "pad3", "pad4") if named else ()
    header = delimiter.join((*(("name",) if named else ()), *"xyz"[:k])) + "\n" if headed else ""
    facts = {"positions": POINTS[:, :k], "names": names or UNNAMED, "units": ""}
    return header + table(POINTS[:, :k], delimiter, names=names), facts


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
SCANNED = {"positions": [[0, 0, 0], [1.5, 0, 0], [0, 2.5, 1e-3]], "names": UNNAMED[:3]}
_LINES = CLOUD.splitlines()
FACES_FIRST = [*_LINES[:3], *_LINES[8:10], *_LINES[3:8], _LINES[10], _LINES[14], *_LINES[11:14]]
TRUTHS = [
    *(
        positions(k, delimiter, named=named, headed=headed)
        for k in (2, 3)
        for delimiter in ",;\t "
        for named in (False, True)
        for headed in (False, True)
    ),
    *(
        hold(f"{header}\n{table(POINTS)}", positions=POINTS, units=units)
        for header, units in (
            *(("x,y,z", ""), ("X [mm],Y [mm],Z [mm]", "mm")),
            *(("x_m,y_m,z_m", "m"), ("x(cm),y(cm),z(cm)", "cm")),
        )
    ),
    hold(
        "id,nx,z,y,x,note\n7,0.1,3,2,1,left\n8,0.2,6,5,4,\n",
        positions=[[1, 2, 3], [4, 5, 6]],
        names=("7", "8"),
    ),
    hold("name;x;y\na;0,5;1\nb;2;3,25\n", positions=[[0.5, 1], [2, 3.25]]),
    hold(
        "# by hand\nname,x,y\na,1,2\nb,,\n# not found\nc,nan,nan\n",
        positions=[[1, 2], [NAN, NAN], [NAN, NAN]],
        names=("a", "b", "c"),
    ),
    hold(
        "name,x,y,component,health,excluded\na,1,2,0,ok,1\nb,3,4,0,dead,0\n",
        positions=[[1, 2], [3, 4]],
        health=("ok", "dead"),
    ),
    hold("x,y,\n1,2,\n3,4,\n", positions=[[1, 2], [3, 4]]),
    hold(json.dumps({"sensors": [{"position": [1, None]}]}), positions=[[1, NAN]], names=("s0",)),
    hold(
        '{"time": 3, "units": "mm",\n "sensors": [{"position": [1, 2]}]}',
        positions=[[1, 2]],
        units="mm",
    ),
    hold(CLOUD, **SCANNED),
    hold("\r\n".join(FACES_FIRST), **SCANNED),
]


@pytest.mark.parametrize(("text", "facts"), TRUTHS, ids=range(len(TRUTHS)))
def test_what_a_file_of_positions_holds(put, text: str, facts: dict[str, Any]) -> None:
    compare(io.read_map(put("truth.txt", text)), facts)


def test_duplicate_names_are_made_distinct(put, tmp_path: Path) -> None:
    twice = [{"name": "a", "position": [1, 2]}, {"name": "a", "position": [3, 4]}]
    np.savez(tmp_path / "truth.npz", names=["a", "a"], positions=[[1, 2], [3, 4]])
    for path in (
        put("truth.csv", "name,x,y\na,1,2\na,3,4\n"),
        put("truth.json", json.dumps({"sensors": twice})),
        tmp_path / "truth.npz",
    ):
        with pytest.warns(AnisomapWarning, match=r"truth.*: names of several sensors: a;"):
            found = io.read_map(path)
        assert found.names == ("a", "a_2")
        np.testing.assert_array_equal(found.positions, [[1, 2], [3, 4]])
