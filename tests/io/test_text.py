"""Delimited text: dialects, roles of columns, and the location of errors."""

import gzip
import logging
import math
from collections.abc import Callable
from pathlib import Path

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

Put = Callable[[str, str | bytes], Path]

READINGS = np.where(np.random.default_rng(4).random((30, 4)) < 0.5, 0, 12.25)
READINGS[:3] = [[0.5, 0, 1, 0], [0, 2.75, 0, 0], [0, 0, 0, 3]]


def table(values: np.ndarray, delimiter: str = ",", end: str = "\n", decimal: str = ".") -> str:
    rows = [delimiter.join(f"{value:g}" for value in row) for row in values]
    return "".join(row.replace(".", decimal) + end for row in rows)


UNNAMED = ("s0", "s1", "s2", "s3")
HEADERS = ("", "a{0}b{0}c{0}d", '"a"{0}"b"{0}"c"{0}"d"')
ENDS = ("\n", "\r\n", "\r")
ENCODINGS = ("utf-8", "utf-8-sig", "gzip")


@pytest.mark.parametrize("header", range(3))
@pytest.mark.parametrize("end", range(3))
@pytest.mark.parametrize("dialect", [",.", ", .", ";.", ";,", "\t.", "\t,", " .", "  ."])
def test_dialects(put: Put, dialect: str, end: int, header: int) -> None:
    delimiter, decimal = dialect[:-1], dialect[-1]
    # Every pair of a header, a line end and an encoding, in a Latin square.
    line, encoding = ENDS[end], ENCODINGS[(end + header) % 3]
    head = f"# made by hand{line}{line}"
    head += HEADERS[header].format(delimiter) + line if header else ""
    text = head + table(READINGS, delimiter, line, decimal)
    content = gzip.compress(text.encode()) if encoding == "gzip" else text.encode(encoding)
    found = io.read(put("skin.csv", content))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == (("a", "b", "c", "d") if header else UNNAMED)
    assert found.times is None
    assert found.source == "skin.csv"


@pytest.mark.parametrize("suffix", ["csv", "tsv", "txt", "dat", "log", "CSV", "unknown", ""])
def test_text_is_read_with_any_suffix(put: Put, suffix: str) -> None:
    found = io.read(put(f"skin.{suffix}", table(READINGS)))
    np.testing.assert_array_equal(found.readings, READINGS)


@pytest.mark.parametrize("tail", [",", ",,,", " , "])
@pytest.mark.parametrize(
    ("header", "header_tail"), [("", False), ("a,b,c,d", False), ("a,b,c,d", True)]
)
def test_trailing_delimiters(put: Put, header: str, header_tail: bool, tail: str) -> None:
    first = header + tail * header_tail + "\n" if header else ""
    found = io.read(put("skin.csv", first + table(READINGS, end=f"{tail}\n")))
    np.testing.assert_array_equal(found.readings, READINGS)


PLAIN = [
    (
        "# one\n\na,b\n# two\n1,2\n\n   \n3,4 # three\n# 5,6\n7,8",
        ("a", "b"),
        [[1, 2], [3, 4], [7, 8]],
    ),
    ("5\n6\n", ("s0",), [[5], [6]]),
    ("5,6", ("s0", "s1"), [[5, 6]]),
    ("force\n5\n", ("force",), [[5]]),
    ("5", ("s0",), [[5]]),
    (
        '"a, b", "say ""hi""","two\nlines",#4\n1,2,3,4\n5,6,7,8\n',
        ("a, b", 'say "hi"', "two\nlines", "#4"),
        [[1, 2, 3, 4], [5, 6, 7, 8]],
    ),
    ('"pad 1" "pad 2"\n1 2\n3 4\n', ("pad 1", "pad 2"), [[1, 2], [3, 4]]),
    ("0,1,2,3\n" + table(READINGS), ("0", "1", "2", "3"), READINGS),
    ("0,1,2,3\n4,5,6,7\n8,9,10,11\n", UNNAMED, np.arange(12).reshape(3, 4)),
]
"""Tables with their names and readings: comments, single cells, quoted names, default labels."""


@pytest.mark.parametrize(("text", "names", "readings"), PLAIN)
def test_names_and_readings(put: Put, text: str, names: tuple[str, ...], readings) -> None:
    found = io.read(put("skin.csv", text))
    assert found.names == names
    np.testing.assert_array_equal(found.readings, readings)


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("missing", ["", "  ", "nan", "NaN", "NAN", "-nan"])
def test_missing_readings(put: Put, delimiter: str, missing: str) -> None:
    rows = [["1", missing, "3"], ["4", "5", "6"], [missing] * 3, ["inf", "-inf", "1e3"]]
    text = "".join(delimiter.join(row) + "\n" for row in [["a", "b", "c"], *rows])
    found = io.read(put("skin.csv", text)).readings
    nan, inf = math.nan, math.inf
    expected = [[1, nan, 3], [4, 5, 6], [nan, nan, nan], [inf, -inf, 1000]]
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("name", "per_second"),
    [
        *(("time", 1), ("t", 1), ("Time [s]", 1), ("TIME_S", 1), ("timestamp", 1), ("stamp", 1)),
        *(("seconds", 1), ("time_stamp", 1), ("t [ms]", 1e3), ("time (ms)", 1e3), ("time_ms", 1e3)),
        *(("ms", 1e3), ("millis", 1e3), ("stamp_us", 1e6), ("time [\u00b5s]", 1e6), ("t_ns", 1e9)),
        *(
            ("Zeit", 1),
            ("zeit_ms", 1e3),
            ("Zeitstempel [ms]", 1e3),
            ("temps", 1),
            ("\u65f6\u95f4", 1),
        ),
    ],
)
def test_time_column_by_name(put: Put, name: str, per_second: float, caplog) -> None:
    times = np.arange(30) * 0.02
    text = f"a,{name},b\n" + table(
        np.column_stack([READINGS[:, 0], times * per_second, READINGS[:, 1]])
    )
    with caplog.at_level(logging.INFO, logger="anisomap"):
        found = io.read(put("skin.csv", text))
    assert found.names == ("a", "b")
    np.testing.assert_allclose(found.times, times, atol=1e-12)
    assert found.rate_hz == pytest.approx(50)
    assert found.metadata["time_column"] == f"column 2 ({name})"
    assert "column 2" in caplog.text


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6, 1e9])
def test_the_unit_of_seconds_since_1970_follows_from_magnitude(put: Put, unit: float) -> None:
    stamps = (1_700_000_000 + np.arange(30) * 0.25) * unit
    text = "timestamp,a\n" + "".join(f"{stamp:.3f},{i % 3}\n" for i, stamp in enumerate(stamps))
    assert io.read(put("skin.csv", text)).rate_hz == pytest.approx(4)


@pytest.mark.parametrize("name", ["frame", "Frame", "index", "seq", "frame_id", "", "Unnamed: 0"])
def test_counter_column_by_name(put: Put, name: str) -> None:
    counted = np.column_stack([np.arange(30), READINGS])
    found = io.read(put("skin.csv", f"{name},a,b,c,d\n" + table(counted)))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.metadata["counter_column"] == f"column 1 ({name})"
    assert found.times is None


@pytest.mark.parametrize(
    ("header", "role"),
    [
        ("host_time,a,b,c,d", "time"),
        ("a,ros time ms,b,c,d", "time"),
        ("clock,s0,s1,s2,s3", "time"),
        ("Messung,s0,s1,s2,s3", "a frame counter"),
        ("nr,clock,s0,s1,s2,s3", "time"),
    ],
)
def test_steady_columns_with_other_names_are_taken_with_a_warning(
    put: Put, header: str, role: str
) -> None:
    names = header.split(",")
    count, clock = np.arange(3, 33), np.arange(30) * 0.02
    columns = dict(zip([n for n in names if n in "abcd" or n[0] == "s"], READINGS.T, strict=True))
    columns |= {"Messung": count, "nr": count}
    rows = np.column_stack([columns.get(name, clock) for name in names])
    with pytest.warns(AnisomapWarning, match=rf"increases steadily and is taken as {role}"):
        found = io.read(put("skin.csv", header + "\n" + table(rows)))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert (found.times is not None) == (role == "time")


@pytest.mark.parametrize("header", ["", "label{0}a{0}b{0}c{0}d{0}note\n"])
@pytest.mark.parametrize("dialect", [(",", "."), (";", ","), ("\t", "."), (" ", ".")])
def test_columns_of_text_are_skipped(put: Put, header: str, dialect: tuple[str, str]) -> None:
    delimiter, decimal = dialect
    lines = table(READINGS, delimiter, "\n", decimal).splitlines()
    rows = "".join(f"rest{delimiter}{line}{delimiter}x1\n" for line in lines)
    with pytest.warns(AnisomapWarning, match=r"skipped text.* in column 1 .*, column 6 "):
        found = io.read(put("skin.csv", header.format(delimiter) + rows))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == (("a", "b", "c", "d") if header else UNNAMED)
    assert "column 6" in found.metadata["text_columns"]


def test_times_as_text_and_missing_labels(put: Put) -> None:
    rows = [f"2024-05-01T12:00:{i:02d},{i % 3},{'' if i else 'wet'}" for i in range(30)]
    rows[7] += "dry"
    with pytest.warns(AnisomapWarning, match=r"column 1 \(time\), column 3 \(label\)"):
        found = io.read(put("skin.csv", "time,a,label\n" + "\n".join(rows) + "\n"))
    assert found.names == ("a",)
    assert found.times is None


def test_single_cells_of_text_are_rejected(put: Put) -> None:
    rows = ["1,2,x"] * 20
    rows[9] = "1,oops,x"
    with pytest.warns(AnisomapWarning, match="skipped text"):
        message = read_error(put("skin.csv", "a,b,c\n" + "\n".join(rows)))
    assert "line 11, column 2 (b): 'oops' is not a number" in message
    rows[9:] = ["1,2,x"] * 2000
    rows[1500] = "1,2,7"
    with pytest.warns(AnisomapWarning, match="skipped text"):
        message = read_error(put("skin.csv", "a,b,c\n" + "\n".join(rows)))
    assert "line 1502, column 3 (c): '7' is a number in a column of text" in message


def test_the_index_of_a_data_frame_is_a_counter(put: Put) -> None:
    rows = "".join(f"{i},{line}\n" for i, line in enumerate(table(READINGS).splitlines()))
    found = io.read(put("x.csv", ",0,1,2,3\n" + rows))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.metadata["counter_column"] == "column 1 ()"


def test_counter_and_time_together(put: Put) -> None:
    both = np.column_stack([np.arange(30), np.arange(30) * 0.125, READINGS])
    for header in ("seq,time,a,b,c,d\n", ""):
        found = io.read(put("skin.csv", header + table(both)))
        np.testing.assert_array_equal(found.readings, READINGS)
        np.testing.assert_array_equal(found.times, both[:, 1])


def test_time_without_header(put: Put, caplog) -> None:
    jitter = np.random.default_rng(1).uniform(-0.002, 0.002, 30)
    timed = np.column_stack([np.arange(30) * 0.02 + jitter.round(4), READINGS])
    with caplog.at_level(logging.INFO, logger="anisomap"):
        found = io.read(put("skin.csv", table(timed)))
    np.testing.assert_allclose(found.times, timed[:, 0], rtol=1e-5)
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.metadata["time_column"] == "column 1 (no header)"
    assert "column 1" in caplog.text


def test_a_counter_without_header_is_not_time(put: Put) -> None:
    found = io.read(put("skin.csv", table(np.column_stack([np.arange(5, 35), READINGS]))))
    assert found.times is None
    np.testing.assert_array_equal(found.readings, READINGS)


def beside(first: object) -> np.ndarray:
    return np.column_stack([first, READINGS])


COUNT = np.arange(30.0)
SENSORS = [
    *((f"{name},b,c,d,e", beside(COUNT)) for name in ("t1", "s", "us", "tip", "sensor", "mst")),
    *((f"{name},b,c,d,e", beside(COUNT)) for name in ("timer", "thumb", "ts0")),
    *((header, beside(COUNT * 0.02)) for header in ("s0,s1,s2,s3,s4", "left,a,b,c,d")),
    ("thumb,index1,ring2,palm3,palm4", beside(COUNT * 0.02)),
    ("index,thumb,middle,ring", READINGS),
    ("", beside(COUNT**2)),  # rises, but not steadily
    ("", beside(np.minimum(COUNT, 20))),  # saturates
    ("", beside(np.where(COUNT % 10 == 9, 0, COUNT))),  # falls back
    ("", beside(np.where(COUNT == 0, np.nan, COUNT))),
    ("", np.arange(120.0).reshape(30, 4)),
    ("", beside(COUNT / 10)[:5]),
]
"""Tables without times or counters, although columns rise or have similar names."""


@pytest.mark.parametrize(("header", "values"), SENSORS)
def test_columns_that_may_be_sensors_are(put: Put, header: str, values: np.ndarray) -> None:
    found = io.read(put("skin.csv", (header and f"{header}\n") + table(values)))
    np.testing.assert_array_equal(found.readings, values)
    assert found.times is None
    assert not header or found.names == tuple(header.split(","))


@given(hnp.arrays(np.float64, (20, 3), elements=st.sampled_from([0.0, 1.0, 2.5])))
def test_readings_at_rest_are_not_time(tmp_path_factory, values: np.ndarray) -> None:
    path = tmp_path_factory.getbasetemp() / "resting.csv"
    path.write_text(table(values))
    found = io.read(path)
    np.testing.assert_array_equal(found.readings, values)
    assert found.times is None


@pytest.mark.parametrize(("bad", "line"), [("0.04", 8), ("", 8), ("0.01", 8), ("inf", 8)])
def test_times_that_do_not_increase_are_ignored(put: Put, bad: str, line: int) -> None:
    stamps = [f"{i / 50:g}" for i in range(30)]
    stamps[3] = bad
    rows = "".join(f"{stamp},{i % 2}\n" for i, stamp in enumerate(stamps))
    rows = rows.replace("\n", "\n# a comment\n\n", 1)
    with pytest.warns(AnisomapWarning, match=rf"skin\.csv.*frame 3 \(line {line - 1}\)"):
        found = io.read(put("skin.csv", "time,a\n" + rows))
    assert found.times is None
    assert found.rate_hz is None
    assert found.readings[:, 0].tolist() == [i % 2 for i in range(30)]


def read_error(path: Path) -> str:
    with pytest.raises(FileError) as caught:
        io.read(path)
    return str(caught.value)


@pytest.mark.parametrize("far", [2, 511, 512, 513, 1700])
def test_lines_of_wrong_width_are_located(put: Put, far: int) -> None:
    lines = ["a,b,c", *["1,2,3"] * 2000]
    for wrong, count in (("1,2", 2), ("1,2,3,4", 4), ("7", 1), ("1,2,3,", 4)):
        lines[far - 1] = wrong
        message = read_error(put("skin.csv", "\n".join(lines)))
        assert f"skin.csv, line {far} has {count} field" in message
        assert "the header names 3" in message


@pytest.mark.parametrize("far", [2, 512, 513, 1700])
@pytest.mark.parametrize("word", ["abc", "1.2.3", "0x1F", "1_000", "12:30", "--", "\u0661", "1 2"])
def test_text_instead_of_a_number_is_located(put: Put, far: int, word: str) -> None:
    lines = ["a,b,c", *["1,2,3"] * 2000]
    lines[far - 1] = f"1,{word},3"
    message = read_error(put("skin.csv", "\r\n".join(lines)))
    assert f"skin.csv, line {far}, column 2 (b): '{word}' is not a number" in message


def test_duplicate_names_are_made_distinct(put: Put) -> None:
    path = put("x.csv", "a,b,a,a_2,a\n1,2,3,4,5\n6,7,8,9,10\n")
    with pytest.warns(AnisomapWarning, match=r"x\.csv: several sensors have the name a; they"):
        found = io.read(path)
    assert found.names == ("a", "b", "a_3", "a_2", "a_4")
    np.testing.assert_array_equal(found.readings[0], [1, 2, 3, 4, 5])


def test_truncated_gzip_files(put: Put) -> None:
    values = np.random.default_rng(0).integers(0, 256, (9000, 5))
    packed = gzip.compress(table(values).encode())
    for end in (len(packed) - 9, len(packed) // 2, 4000):
        with pytest.warns(AnisomapWarning, match=r"x\.csv.*damaged or cut short.* frames before"):
            found = io.read(put("x.csv", packed[:end]))
        np.testing.assert_array_equal(found.readings, values[: found.n_frames])
        assert found.n_frames > 0.9 * len(values) * end / len(packed) - 700


def test_a_truncated_last_line(put: Put) -> None:
    with pytest.warns(AnisomapWarning, match=r"truncated .* \(line 4 has 2 fields"):
        found = io.read(put("x.csv", "a,b,c\n1,2,3\n4,5,6\n7,8"))
    assert found.readings.tolist() == [[1, 2, 3], [4, 5, 6]]
    with pytest.warns(AnisomapWarning, match=r"truncated .* \(line 3, column 3"):
        assert io.read(put("x.csv", "1,2,3\n4,5,6\n7,8,-")).n_frames == 2


@given(st.text(max_size=6))
def test_parsing_agrees_with_numpy(text: str) -> None:
    """Lines that numpy rejects are parsed again, so both parsers must agree."""
    try:
        by_numpy = np.loadtxt([text], np.float64, comments=None, delimiter=",", ndmin=2)
    except (ValueError, UserWarning):
        return
    np.testing.assert_array_equal(by_numpy, [[parse_number(text)]])


def test_wide_and_long_files(put: Put) -> None:
    wide = np.random.default_rng(5).integers(0, 256, (60, 3000))
    np.testing.assert_array_equal(io.read(put("wide.csv", table(wide))).readings, wide)
    long = np.random.default_rng(6).integers(0, 256, (20_000, 2))
    np.testing.assert_array_equal(io.read(put("long.csv", table(long))).readings, long)


def test_exact_float32_readings_are_stored_as_float32(put: Put) -> None:
    assert io.read(put("x.csv", "0,0.5\n1,0\n")).readings.dtype == np.float32
    assert io.read(put("x.csv", "0,0.1\n1,0\n")).readings.dtype == np.float64
    assert io.read(put("x.csv", "0,1e300\n1,0\n")).readings.dtype == np.float64


def test_commas_that_may_separate_thousands_give_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "forces.tsv"
    path.write_text("a\tb\n1,234\t5\n2,345\t6\n")
    with pytest.warns(AnisomapWarning, match=r"decimal commas \(1,234 as 1\.234\)"):
        io.read(path)
    path.write_text("a\tb\n1,234\t5\n0,5\t6\n")
    assert io.read(path).readings[0, 0] == 1.234


def test_a_header_longer_than_the_sample_does_not_hide_the_numbers(put) -> None:
    names = [f"sensor {i:040d}" for i in range(100_000)]
    row = ",".join(["1"] * 99_999)
    found = io.read(put("wide.csv", ",".join(names) + "\n" + f"{row},2\n{row},3\n"))
    assert found.names == tuple(names)
    np.testing.assert_array_equal(found.readings[:, -1], [2, 3])


def test_names_too_long_for_a_field_are_refused_before_they_are_written(tmp_path) -> None:
    path = tmp_path / "map.csv"
    with pytest.raises(InputError, match="200000 characters is too long"):
        io.write(SensorMap(np.eye(3), names=["a" * 200_000, "b", "c"]), path)
    with pytest.raises(InputError, match="too many line ends"):
        io.write(Recording(np.eye(3), names=["a\n" * 600, "b", "c"]), path)
    assert not path.exists()


def test_lists_in_cells(put: Put) -> None:
    rows = ['12.5,0,"0,1,2,0","[9 8 7]"', '13.0,1,"0,3,4,0","[6 5 4]"']
    path = put("walk.csv", "Timestamp,Frame,left,right\n" + "\n".join(rows) + "\n")
    assert [content.name for content in io.contents(path)] == ["left", "right"]
    with pytest.raises(io.ChoiceError, match="2 possible recordings"):
        io.read(path)
    left = io.read(path, options=io.ReadOptions(select="left", grid=(2, 2)))
    np.testing.assert_array_equal(left.readings, [[0, 1, 2, 0], [0, 3, 4, 0]])
    np.testing.assert_array_equal(left.times, [0, 0.5])
    assert left.names == ("r0c0", "r0c1", "r1c0", "r1c1")
    assert not left.varying()[[0, 3]].any()
    right = io.read(path, options=io.ReadOptions(select="right"))
    np.testing.assert_array_equal(right.readings, [[9, 8, 7], [6, 5, 4]])


def test_a_truncated_list_is_dropped(put: Put) -> None:
    rows = "".join(f'{i},"1,2,3"\n' for i in range(60))
    with pytest.warns(AnisomapWarning, match="last line is truncated"):
        found = io.read(put("walk.csv", f'frame,cells\n{rows}60,"1,2'))
    assert found.n_frames == 60
