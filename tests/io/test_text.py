"""What is read from text: tables, and exports of mats."""

import gzip
import logging
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError, InputError
from anisomap.io.parsing.tables import parse_number
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from texts import COUNT, NAN, READINGS, check, hold, table


def beside(*first: Any) -> np.ndarray:
    return np.column_stack([*first, READINGS])


UNNAMED = ("s0", "s1", "s2", "s3")
NAMED = ("a", "b", "c", "d")
AS_NUMBERS = ("0", "1", "2", "3")
ROWS = '"pad 1" "pad 2"\n1 2\n3 4\n'
TABLES = [
    hold(
        "# one\n\na,b\n# two\n1,2\n\n   \n3,4 # three\n# 5,6\n7,8",
        names=("a", "b"),
        readings=[[1, 2], [3, 4], [7, 8]],
    ),
    hold("5\n6\n", names=("s0",), readings=[[5], [6]]),
    hold("5,6", names=("s0", "s1"), readings=[[5, 6]]),
    hold("force\n5\n", names=("force",), readings=[[5]]),
    hold("5", names=("s0",), readings=[[5]]),
    hold(
        '"a, b", "say ""hi""","two\nlines",#4\n1,2,3,4\n5,6,7,8\n',
        names=("a, b", 'say "hi"', "two\nlines", "#4"),
        readings=[[1, 2, 3, 4], [5, 6, 7, 8]],
    ),
    hold(ROWS, names=("pad 1", "pad 2"), readings=[[1, 2], [3, 4]]),
    hold("0,1,2,3\n" + table(READINGS), names=AS_NUMBERS, readings=READINGS),
    hold("0,1,2,3\n4,5,6,7\n8,9,10,11\n", names=UNNAMED, readings=np.arange(12).reshape(3, 4)),
    *(
        hold(header + table(READINGS, end=f"{tail}\n"), readings=READINGS)
        for tail in (",", ",,,", " , ")
        for header in ("", "a,b,c,d\n", f"a,b,c,d{tail}\n")
    ),
    *(
        hold(
            table([[1, 2, 3]], mark)
            + "".join(f"{mark.join(row)}\n" for row in (["1", no, "3"], [no] * 3, ["inf", "2", no]))
            + table([[4, 5, 6]], mark),
            readings=[[1, 2, 3], [1, NAN, 3], [NAN] * 3, [math.inf, 2, NAN], [4, 5, 6]],
        )
        for mark in ",;\t"
        for no in ("", "-nan")
    ),
    *(
        hold(
            f"{name},a,b,c,d\n" + table(beside(COUNT)),
            readings=READINGS,
            metadata={"counter_column": f"column 1 ({name})" if name else "column 1"},
            times=None,
        )
        for name in ("Frame", "seq", "", "Unnamed: 0")
    ),
    hold(",0,1,2,3\n" + table(beside(COUNT)), readings=READINGS, times=None),
    *(
        hold(header + table(beside(COUNT, COUNT / 8)), readings=READINGS, times=COUNT / 8)
        for header in ("seq,time,a,b,c,d\n", "")
    ),
    hold(
        table(beside(COUNT / 50 + COUNT % 3 / 1000)),
        readings=READINGS,
        times=COUNT / 50 + COUNT % 3 / 1000,
        metadata={"time_column": "column 1 (no header)"},
    ),
    hold(table(beside(COUNT + 5)), readings=READINGS, times=None),
    *(
        hold(
            "timestamp,a\n" + "".join(f"{(1.7e9 + i / 4) * unit:.3f},{i % 3}\n" for i in range(30)),
            rate_hz=4,
        )
        for unit in (1.0, 1e3, 1e6, 1e9)
    ),
    *(
        hold(f"{name},b,c,d,e\n" + table(beside(COUNT)), readings=beside(COUNT), times=None)
        for name in ("t1", "s", "timer", "ts0")
    ),
    *(
        hold(header + table(beside(COUNT / 50)), readings=beside(COUNT / 50), times=None)
        for header in ("s0,s1,s2,s3,s4\n", "left,a,b,c,d\n", "thumb,index1,ring2,palm3,palm4\n")
    ),
    hold("index,thumb,middle,ring\n" + table(READINGS), readings=READINGS, times=None),
    *(
        hold(table(values), readings=values, times=None)
        for values in (
            beside(COUNT**2),  # rises, but not steadily
            beside(np.minimum(COUNT, 20)),  # saturates
            beside(np.where(COUNT % 10 == 9, 0, COUNT)),  # falls back
            np.arange(120.0).reshape(30, 4),
            beside(COUNT / 10)[:5],
        )
    ),
    hold(
        "a,b,a,a_2,a\n1,2,3,4,5\n6,7,8,9,10\n",
        names=("a", "b", "a_3", "a_2", "a_4"),
        readings=[[1, 2, 3, 4, 5], [6, 7, 8, 9, 10]],
        warns="x\\.csv: names of several sensors: a; numbered",
    ),
    hold(
        "a,b,c\n1,2,3\n4,5,6\n7,8",
        readings=[[1, 2, 3], [4, 5, 6]],
        warns="truncated .*\\(line 4 has 2 instead of 3 fields",
    ),
    hold(
        "1,2,3\n4,5,6\n7,8,+",
        readings=[[1, 2, 3], [4, 5, 6]],
        warns="truncated .*\\(line 3, column 3",
    ),
    hold(
        "time,a,label\n"
        + "".join(f"12:00:{i:02d},{i % 3},{('' if i % 7 else 'wet')}\n" for i in range(30)),
        names=("a",),
        times=np.arange(30),
        warns="text in column 3 \\(label\\)",
    ),
    hold("a\tb\n1,234\t5\n0,5\t6\n", readings=[[1.234, 5], [0.5, 6]]),
    hold(
        "a\tb\n1,234\t5\n2,345\t6\n",
        readings=[[1.234, 5], [2.345, 6]],
        warns="decimal commas \\(1,234 as 1\\.234\\)",
    ),
    hold("frame,a,b\n0,1,2\n1,3,4\n", names=("a", "b")),
    hold(
        "mat\n1,2\n".replace("mat", "a,b") + "3,\n,4\n",
        grid=(1, 2),
        readings=[[1, 2], [3, NAN], [NAN, 4]],
    ),
    hold(
        "a,b,c,d\n1,,3,\n4,,6,\n7,nan,8,1\n",
        grid=(2, 2),
        readings=[[1, 0, 3, NAN], [4, 0, 6, NAN], [7, 0, 8, 1]],
        warns="1 of 4 cells of the grid have no reading",
    ),
    hold(
        "1,2,3,4,5,6\n7,8,9,1,2,3\n",
        grid=(2, 3),
        names=("r0c0", "r0c1", "r0c2", "r1c0", "r1c1", "r1c2"),
        positions=[[0, 0], [1, 0], [2, 0], [0, 1], [1, 1], [2, 1]],
    ),
    *(
        hold(
            f"{names}\n1,2,3\n4,5,6\n",
            grid=(2, 3),
            names=tuple(names.split(",")),
            positions=[[1, 0], [1, 1], [2, 1]],
        )
        for names in ("c1,c4,c5", "r0c1,r1c1,r1c2")
    ),
]
"""Tables, and what they hold."""

FRAMES = np.random.default_rng(5).integers(0, 255, (30, 4, 3))
CELLS = FRAMES.reshape(30, 12)
MOVIE = """DATA_TYPE MOVIE
SENSOR_TYPE 5250
ROWS 4
COLS 3
ROW_SPACING 1.27 mm
COL_SPACING 2.5 mm
SECONDS_PER_FRAME 0.01
UNITS kPa
ASCII_DATA @@

"""


def movie(between: str = ",", header: str = MOVIE, outside: bool = False) -> str:
    text = header
    for number, frame in enumerate(FRAMES.astype(object), start=1):
        if outside:
            frame[0, 0] = frame[3, 2] = "B"
        rows = "".join(between.join(map(str, row)) + "\n" for row in frame.tolist())
        text += f"Frame {number}\n{rows}\n"
    return text


def quoted_movie() -> str:
    """The export of a mat program with a German or Dutch locale, over midnight."""
    text = 'File:,"walk"\nSensor:,"PX100"\n'
    for i, frame in enumerate(FRAMES.tolist()):
        rows = "".join(",".join(f'"{v},5"' for v in row) + "\n" for row in frame)
        second = f"23:59:{59 + i / 25:06.3f}" if i < 25 else f"00:00:{i / 25 - 1:06.3f}"
        text += f'Frame:,"{i + 1}"\nTime:,"{second}"\nRows:,4\nColumns:,3\n{rows}\n'
    return text


def insole(between: str) -> str:
    """Metadata, then a table with names."""
    above = f"file name:{between}walk01\ndate/time 03.04.25 12:00\n\nsensors{between}99\n\n"
    names = between.join(["time[secs]", "left 1", "left 2", "right 1", "right 2"])
    rows = np.column_stack([COUNT / 50, FRAMES[:, 0, [0, 1, 2, 0]]])
    return f"{above}{names}\n{table(rows, between)}"


MATS = [
    hold(movie() + "@@\n", readings=CELLS, units="mm", rate_hz=100),
    *(hold(movie(mark, ""), readings=CELLS, units="spacings") for mark in ",;\t "),
    hold(movie(outside=True), readings=CELLS[:, 1:-1], n_sensors=10),
    hold(quoted_movie(), readings=CELLS + 0.5, units="spacings", times=COUNT / 25),
    hold(
        movie()[: movie().rindex("\n", 0, -2) + 1],
        n_frames=29,
        warns="truncated in row 3 of 4.*: 29",
    ),
    *(
        hold(
            insole(mark),
            names=("left 1", "left 2", "right 1", "right 2"),
            readings=FRAMES[:, 0, [0, 1, 2, 0]],
            rate_hz=50,
        )
        for mark in "\t;,"
    ),
]
"""Exports of pressure mats and insoles."""

CASES = [*TABLES, *MATS]


@pytest.mark.parametrize(("text", "facts"), CASES, ids=range(len(CASES)))
def test_what_a_text_holds(put, text: str, facts: dict[str, Any]) -> None:
    check(put("x.csv", text), facts)


HEADERS = ("", "a{0}b{0}c{0}d", '"a"{0}"b"{0}"c"{0}"d"')
DIALECTS = (",.", ", .", ";.", ";,", "\t.", "\t,", " .", "  .")
ENDS = ("\n", "\r\n", "\r")
ENCODINGS = ("utf-8", "utf-8-sig", "gzip")


@pytest.mark.parametrize("header", range(3))
@pytest.mark.parametrize("dialect", range(8))
def test_dialects(put, dialect: int, header: int) -> None:
    delimiter, decimal = DIALECTS[dialect][:-1], DIALECTS[dialect][-1]
    # Every pair of a header, a line end and an encoding, over the dialects.
    end = dialect % 3
    line, encoding = ENDS[end], ENCODINGS[(end + header) % 3]
    head = f"# made by hand{line}{line}"
    head += HEADERS[header].format(delimiter) + line if header else ""
    text = head + table(READINGS, delimiter, line, decimal)
    content = gzip.compress(text.encode()) if encoding == "gzip" else text.encode(encoding)
    found = io.read(put("skin.unknown", content))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == (NAMED if header else UNNAMED)
    assert found.times is None
    assert found.source == "skin.unknown"


@pytest.mark.parametrize(
    ("name", "per_second"),
    [
        *((name, 1) for name in ("t", "Time [s]", "TIME_S", "seconds", "Zeit", "\u65f6\u95f4")),
        *((name, 1e3) for name in ("t [ms]", "time (ms)", "millis", "zeit_ms")),
        *(("stamp_us", 1e6), ("time [\u00b5s]", 1e6), ("t_ns", 1e9)),
    ],
)
def test_time_column_by_name(put, name: str, per_second: float, caplog) -> None:
    rows = np.column_stack([READINGS[:, 0], COUNT / 50 * per_second, READINGS[:, 1]])
    with caplog.at_level(logging.INFO, logger="anisomap"):
        found = io.read(put("skin.csv", f"a,{name},b\n" + table(rows)))
    assert found.names == ("a", "b")
    np.testing.assert_allclose(found.times, COUNT / 50, atol=1e-12)
    assert found.rate_hz == pytest.approx(50)
    assert found.metadata["time_column"] == f"column 2 ({name})"
    assert "column 2" in caplog.text


@pytest.mark.parametrize(
    ("header", "role"),
    [
        *(("host_time,a,b,c,d", "time"), ("a,ros time ms,b,c,d", "time")),
        *(("clock,s0,s1,s2,s3", "time"), ("nr,clock,s0,s1,s2,s3", "time")),
        ("Messung,s0,s1,s2,s3", "a frame counter"),
    ],
)
def test_steady_columns_with_other_names_are_taken_with_a_warning(put, header, role) -> None:
    names = header.split(",")
    columns = dict(zip([n for n in names if n in "abcd" or n[0] == "s"], READINGS.T, strict=True))
    columns |= {"Messung": COUNT + 3, "nr": COUNT + 3}
    rows = np.column_stack([columns.get(name, COUNT / 50) for name in names])
    with pytest.warns(AnisomapWarning, match=rf"increases steadily and is taken as {role}"):
        found = io.read(put("skin.csv", header + "\n" + table(rows)))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert (found.times is not None) == (role == "time")


@pytest.mark.parametrize("header", ["", "label{0}a{0}b{0}c{0}d{0}note\n"])
@pytest.mark.parametrize("dialect", [(",", "."), (";", ","), ("\t", "."), (" ", ".")])
def test_columns_of_text_are_skipped(put, header: str, dialect: tuple[str, str]) -> None:
    delimiter, decimal = dialect
    lines = table(READINGS, delimiter, "\n", decimal).splitlines()
    rows = "".join(f"rest{delimiter}{line}{delimiter}x1\n" for line in lines)
    with pytest.warns(AnisomapWarning, match=r"skipped text.* in column 1 .*, column 6 "):
        found = io.read(put("skin.csv", header.format(delimiter) + rows))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == (NAMED if header else UNNAMED)
    assert "column 6" in found.metadata["text_columns"]


@given(hnp.arrays(np.float64, (20, 3), elements=st.sampled_from([0.0, 1.0, 2.5])))
def test_readings_at_rest_are_not_time(tmp_path_factory, values: np.ndarray) -> None:
    path = tmp_path_factory.getbasetemp() / "resting.csv"
    path.write_text(table(values))
    found = io.read(path)
    np.testing.assert_array_equal(found.readings, values)
    assert found.times is None


@pytest.mark.parametrize("bad", ["0.04", "", "0.01", "inf"])
def test_times_that_do_not_increase_are_ignored(put, bad: str) -> None:
    stamps = [bad if i == 3 else f"{i / 50:g}" for i in range(30)]
    rows = "".join(f"{stamp},{i % 2}\n" for i, stamp in enumerate(stamps))
    rows = rows.replace("\n", "\n# a comment\n\n", 1)
    with pytest.warns(AnisomapWarning, match=r"skin\.csv.*frame 3 \(line 7\)"):
        found = io.read(put("skin.csv", "time,a\n" + rows))
    assert (found.times, found.rate_hz) == (None, None)
    assert found.readings[:, 0].tolist() == [i % 2 for i in range(30)]


@pytest.mark.filterwarnings("ignore:.*skipped text")
@pytest.mark.parametrize("far", [2, 511, 512, 513, 1700])
def test_wrong_lines_are_located(put, far: int) -> None:
    words = ("abc", "1.2.3", "0x1F", "1_000", "12:30", "+-", "\u0661", "1 2")
    words = words if far == 513 else words[:1]
    for wrong, said in (
        *(("1,2", " has 2 instead"), ("1,2,3,4", " has 4 instead"), ("7", " has 1 instead")),
        *((f"1,{word},3", f", column 2 (b): '{word}' is not a number") for word in words),
    ):
        lines = ["a,b,c", *["1,2,3"] * 2000]
        lines[far - 1] = wrong
        with pytest.warns(AnisomapWarning, match="left out lines: 1 of 2000") as caught:
            io.read(put("skin.csv", "\r\n".join(lines)))
        assert f": line {far}{said}" in str(caught[-1].message)
    lines = ["a,b,c", *["1,2,x"] * 2000]
    lines[far - 1] = "1,2,7" if far > 1000 else "1,oops,x"
    said = rf"line {far}, column [23] .*('oops' is not a|'7' is a) num"
    with pytest.warns(AnisomapWarning, match=said):
        io.read(put("skin.csv", "\n".join(lines)))


def test_truncated_gzip_files(put) -> None:
    values = np.random.default_rng(0).integers(0, 256, (9000, 5))
    packed = gzip.compress(table(values).encode())
    for end in (len(packed) - 9, len(packed) // 2, 4000):
        with pytest.warns(AnisomapWarning, match=r"x\.csv.*damaged or cut short.* frames before"):
            found = io.read(put("x.csv", packed[:end]))
        np.testing.assert_array_equal(found.readings, values[: found.n_frames])
        assert found.n_frames > 0.9 * len(values) * end / len(packed) - 700


@given(st.text(max_size=6))
def test_parsing_agrees_with_numpy(text: str) -> None:
    """Lines that numpy rejects are parsed again, so both parsers must agree."""
    try:
        by_numpy = np.loadtxt([text], np.float64, comments=None, delimiter=",", ndmin=2)
    except (ValueError, UserWarning):
        return
    np.testing.assert_array_equal(by_numpy, [[parse_number(text)]])


def test_wide_files(put) -> None:
    names = [f"sensor {i:0200d}" for i in range(11_000)]  # more than is looked at for the layout
    row = ",".join(["1"] * 10_999)
    found = io.read(put("wide.csv", ",".join(names) + "\n" + f"{row},2\n{row},3\n"))
    assert found.names == tuple(names)
    np.testing.assert_array_equal(found.readings[:, -1], [2, 3])


def test_exact_float32_readings_are_stored_as_float32(put) -> None:
    for text, kind in (("0,0.5", np.float32), ("0,0.1", np.float64), ("0,1e300", np.float64)):
        assert io.read(put("x.csv", f"{text}\n1,0\n")).readings.dtype == kind


def test_names_too_long_for_a_field_are_refused_before_they_are_written(tmp_path) -> None:
    path = tmp_path / "map.csv"
    with pytest.raises(InputError, match="200000 characters is too long"):
        io.write(SensorMap(np.eye(3), names=["a" * 200_000, "b", "c"]), path)
    with pytest.raises(InputError, match="too many line ends"):
        io.write(Recording(np.eye(3), names=["a\n" * 600, "b", "c"]), path)
    assert not path.exists()


@pytest.mark.parametrize("cell", ["{},{},{}", "[{} {} {}]"])
def test_lists_in_cells_are_refused_with_the_line_that_reads_them(put, cell: str) -> None:
    pandas = pytest.importorskip("pandas")
    rows = (f'{i},"{cell}"\n'.format(i, 2, 3) for i in range(9))
    path = put("walk.csv", "t,left\n" + "".join(rows))
    with pytest.raises(FileError, match="column 2 holds lists of readings; in Python") as refused:
        io.read(path)
    line = str(refused.value).partition("it is anisomap.")[2].partition(", which")[0]
    found = eval(line, {"Recording": Recording, "pandas": pandas, "path": path})  # noqa: S307
    np.testing.assert_array_equal(found.readings, [[i, 2, 3] for i in range(9)])


def test_true_positions_match_by_name_or_number(put) -> None:
    truth = put("truth.csv", "name,x,y\ntaxel2,2,0\ntaxel0,0,0\ntaxel5,5,0\n")
    found = io.read(put("x.csv", "1,2,3\n4,5,6\n"), options=io.ReadOptions(positions=truth))
    np.testing.assert_array_equal(found.positions, [[0, 0], [NAN, NAN], [2, 0]])
    other = put("other.csv", "name,x,y\nleft,2,0\nright,0,0\n")
    with pytest.raises(FileError, match=r"other\.csv has no position for any sensor of .*x\.csv"):
        io.read(put("x.csv", "1,2,3\n4,5,6\n"), options=io.ReadOptions(positions=other))
