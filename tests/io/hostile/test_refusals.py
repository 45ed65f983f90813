"""Text that is damaged or lacks something is refused, with its place and what is wrong."""

import gzip
import json
from functools import partial

import pytest

from anisomap import io
from anisomap.errors import FileError


def log(line: str) -> str:
    """Return a log of YARP with changed lines 20 and 21; its other lines have 8 fields."""
    lines = [f"{i} {1_379_926_523 + i / 64:.6f} 1.0 2.0 3.0 4.0 5.0 6.0" for i in range(40)]
    lines[19:21] = [line.format(lines[19]), line.format(lines[20])]
    return "\n".join(lines)


def cyskin(old: str, new: str) -> str:
    lines = [f"{i} {26.82 + i / 10:f} 2 38135 {i} 38136 {2 * i}\n" for i in range(9)]
    return "1\n2\n" + "".join(lines).replace(f"3 27.120000 2 {old}", f"3 27.120000 2 {new}")


def mat(rows: str = "2", columns: str = "2", third: str = "3,4\n") -> str:
    frames = "".join(f"Frame {i}\n1,2\n{third if i == 3 else '3,4'}\n" for i in range(1, 6))
    return f"ROWS {rows}\nCOLS {columns}\n{frames}"


INSOLE = "file:\twalk\n\nsensors\t99\n\n\nt [s]\tl1\tl2\tr1\tr2\n" + "".join(
    "1\t2\n" if i in (9, 10) else f"{i / 50}\t1\t2\t{i % 7}\t4\n" for i in range(30)
)


def taxel(**changes: object) -> str:
    rows = [{"id": 7, "x": [0, 0, 0]}, {"id": 8, "x": [0, 0, 1], "n": [0, 0, 1], **changes}]
    return json.dumps({"skin": {"taxels": rows}})


NO_CELLS = "3 sensors do not fill a 2 x 3 grid of 6, and names give no cells"
CHOSEN: list[tuple[dict[str, object], str, str, str]] = [
    ({"select": "a/b"}, "x.csv", "1,2\n3,4\n", "single recording; leave out --select a/b"),
    ({"select": "a,b"}, "data.log", log("{}"), "single recording; leave out --select a,b"),
    ({"grid": (4, 4)}, "x.csv", "1,2\n3,4\n", "2 sensors do not fill a 4 x 4 grid of 16"),
    *(
        ({"grid": (2, 3)}, "x.csv", f"{names}\n1,2,3\n4,5,6\n", NO_CELLS)
        for names in ("c1,c4,c6", "c1,c1x,c2", "r0c1,r2c1,r1c2", "a,b,c")
    ),
]
"""What is refused with options of reading."""

RECORDINGS = [
    ("x.csv", "# comment\n\n1 2 3\n4 5 6\n7 8\n7 8\n", "line 5 has 2 instead of 3 fields: line 3"),
    ("x.csv", "1,5;2,5\nx,5;3\ny,5;3\n", "line 2, column 1: 'x,5' is not a number"),
    ("x.csv", "a,b,c\n", "holds only a header"),
    ("x.csv", "time\n1\n2\n3\n", "no sensor"),
    ("x.csv", "a,b\n1,2,3\n", "line 2 has 3 instead of 2 fields: the header names 2"),
    ("x.csv", 'a,"b\n' + "1,2\n" * 10, "unbalanced quotation marks"),
    ("x.csv", "a,b\n1,2\n3,4\n# \u00b5\n".encode("latin-1"), "not UTF-8 text (line 4, byte 0xb5)"),
    ("x.csv", "a,b\n1,2\n".encode("utf-16"), "is UTF-16 text"),
    ("x.csv", gzip.compress(b"1,2\n3,4\n" * 9)[:11], "damaged or cut short"),
    ("data.log", log("19 1379926523.2 1.0"), "line 20 has 3 instead of 8 fields: line 1 has 8"),
    ("data.log", log("19 1379926523.2 1.o 2 3 4 5 6"), "line 20, column 3: '1.o' is not a number"),
    ("data.log", "1 1379926523.5 ()\n2 1379926523.6 ()\n", "stamps, but no values"),
    ("hand.txt", cyskin("38135", "38134"), "line 6 lists other addresses than the first frame"),
    ("walk.asf", mat(third="x3,4\n"), "the frame at line"),
    ("walk.asf", mat(rows="5"), "2 x 2 cells instead of 5 x 2"),
    ("walk.asc", INSOLE, "line 16 has 2 instead of 5 fields: the header names 5"),
    ("h.json", taxel(), "holds no recording"),
]

MAP_HEADER = "name,x,y,component,health\n"


def sensors(*changes: dict[str, object], **properties: object) -> str:
    rows = [{"name": "a", "position": [1.0, 2.0], **change} for change in changes or [{}]]
    return json.dumps({"sensors": rows, **properties})


PLY = "ply\nformat ascii 1.0\nelement vertex 2\n" + "".join(f"property float {a}\n" for a in "xyz")
PLY_END = "end_header\n0 0 0\n1 2 3\n"


def joints(*names: str, parent: str = "a", origin: str = "0 0 0") -> str:
    parents = [parent] if len(set(names)) == 1 else ["a", "b"]
    return '<robot name="r"><link name="a"/>' + "".join(
        f'<joint name="{name}j" type="fixed"><parent link="{parents[i % len(parents)]}"/>'
        f'<child link="{name}"/><origin xyz="{origin}"/></joint>'
        for i, name in enumerate(names)
    ) + "</robot>"  # fmt: skip


TWO_BODIES = "<mujoco><body><site/></body><body name='b'><site/></body></mujoco>"
ICUB = "taxel2Repr ( 0 )\n[calibration]\n"
POINT = "x must be three finite numbers"

MAPS = [
    ("t.csv", "x,y\n1,2\n3,4\n5\n", "line 4 has 1 instead of 2 fields, as line 1 has"),
    ("t.csv", "a,b,c,d\n1,2,3,4\n", "no columns x and y"),
    ("t.csv", MAP_HEADER + "a,1,2,zero,ok\n", "line 2, column 4: 'zero' is not an integer"),
    ("t.csv", MAP_HEADER + "a,1,2,5,ok\n", "components must be numbered"),
    ("m.json", "{}", "without a list of sensors"),
    ("m.json", '{"sensors": [{"name": "a"}]}', "sensor 0: position is 'None'; it must be list"),
    ("m.json", sensors({"position": [1, "2"]}), "sensor 0: position must hold numbers or null"),
    ("m.json", sensors({"name": 3}), "sensor 0: name is '3'; it must be str"),
    ("m.json", sensors({"component": 10**30}), "too large"),
    ("m.json", sensors(stress="low"), "stress, notes, verdict or provenance"),
    ("m.json", '{\n "sensors": [\n  }\n', "m.json, line 3, column 3: not valid JSON"),
    ("h.json", taxel(x=[0, 1, "2"]), f"taxel 1: {POINT}"),
    ("h.json", taxel(id=-3), "taxel 1: id must be a whole number, got '-3'"),
    ("h.json", '{"skin": {"taxels": [{"id": 0, "x": [0, 0, 0]}]}}', "no taxel with an address"),
    ("s.ply", PLY.replace("ascii", "binary_x") + PLY_END, "line 2: the PLY format must be ascii"),
    ("s.ply", PLY + "0 0 0\n1 2 3\n", "line 7: '0 0 0' is not valid in a PLY header"),
    ("s.ply", PLY + "end_header\n0 0\n1 2 3\n", "line 8 has 2 instead of 3 numbers"),
    ("s.ply", PLY, "ends within its PLY header"),
    ("a.urdf", joints(), "holds no fixed frames"),
    ("a.urdf", joints("b", origin="1 2"), "xyz of 'b' must be 3 finite numbers, got '1 2'"),
    ("a.urdf", joints("b", "c"), "one parent link, got 'a' and 'b'"),
    ("a.urdf", "<robot><link", "damaged or cut short"),
    ("a.xml", "<mujoco><worldbody/></mujoco>", "holds no sites"),
    ("a.xml", TWO_BODIES, "one body, got two"),
    ("a.txt", ICUB + "0 0 0 0 0 0\n", "holds no taxel"),
    ("a.txt", ICUB + "1 0 0 0 0 z\n", "line 3, column 6: 'z' is not a number"),
]


PICTURE = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + bytes(range(256))
OF_BOTH = [
    *(
        (name, b"", f"{name} is empty")
        for name in ("x.csv", "x.npz", "x.json", "x.ply", "data.log")
    ),
    *((name, PICTURE, "is binary, not text") for name in ("x.csv", "x.txt", "data.log", "x.tsv")),
    ("skin.xyz", b"\0\1\2\3", "unknown format; 'anisomap list formats' lists"),
]
CASES = [
    *((partial(io.read, options=io.ReadOptions(**given)), *case) for given, *case in CHOSEN),
    *((io.read, *case) for case in (*RECORDINGS, *OF_BOTH)),
    *((io.read_map, *case) for case in (*MAPS, *OF_BOTH)),
]


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@pytest.mark.parametrize(
    ("reader", "name", "content", "message"), CASES, ids=[f"{case[1]}: {case[3]}" for case in CASES]
)
def test_what_is_wrong_is_said_in_a_line(put, reader, name: str, content, message: str) -> None:
    with pytest.raises(FileError) as caught:
        reader(put(name, content))
    said = str(caught.value)
    assert name in said
    assert message in said
    assert len(said) < 400
    assert "\n" not in said
