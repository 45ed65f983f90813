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
    assert found.names == (("a", "b", "c", "d") if header else ("s0", "s1", "s2", "s3"))
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


def test_comments_and_blank_lines_are_skipped(put: Put) -> None:
    text = "# one\n\na,b\n# two\n1,2\n\n   \n3,4 # three\n# 5,6\n7,8"
    found = io.read(put("skin.csv", text))
    assert found.names == ("a", "b")
    np.testing.assert_array_equal(found.readings, [[1, 2], [3, 4], [7, 8]])


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
@pytest.mark.parametrize("missing", ["", "  ", "nan", "NaN", "NAN", "-nan"])
def test_missing_readings(put: Put, delimiter: str, missing: str) -> None:
    rows = [["1", missing, "3"], ["4", "5", "6"], [missing] * 3, ["inf", "-inf", "1e3"]]
    text = "".join(delimiter.join(row) + "\n" for row in [["a", "b", "c"], *rows])
    found = io.read(put("skin.csv", text)).readings
    nan, inf = math.nan, math.inf
    expected = [[1, nan, 3], [4, 5, 6], [nan, nan, nan], [inf, -inf, 1000]]
    np.testing.assert_array_equal(found, expected)


def test_one_sensor_and_one_frame(put: Put) -> None:
    assert io.read(put("x.csv", "5\n6\n")).readings.tolist() == [[5], [6]]
    assert io.read(put("x.csv", "5,6")).readings.tolist() == [[5, 6]]
    assert io.read(put("x.csv", "force\n5\n")).names == ("force",)
    assert io.read(put("x.txt", "5")).readings.tolist() == [[5]]


def test_quoted_names(put: Put) -> None:
    found = io.read(put("x.csv", '"a, b", "say ""hi""","two\nlines",#4\n1,2,3,4\n5,6,7,8\n'))
    assert found.names == ("a, b", 'say "hi"', "two\nlines", "#4")
    found = io.read(put("x.txt", '"pad 1" "pad 2"\n1 2\n3 4\n'))
    assert found.names == ("pad 1", "pad 2")


def test_default_labels_of_a_data_frame_are_a_header(put: Put) -> None:
    labels = "0,1,2,3\n"
    found = io.read(put("x.csv", labels + table(READINGS)))
    assert found.n_frames == len(READINGS)
    rows = "".join(f"{i},{line}\n" for i, line in enumerate(table(READINGS).splitlines()))
    with_index = io.read(put("x.csv", "," + labels + rows))
    np.testing.assert_array_equal(with_index.readings, READINGS)
    assert with_index.metadata["counter_column"] == "column 1 ()"
    counting_on = io.read(put("x.csv", labels + "4,5,6,7\n8,9,10,11\n"))
    assert counting_on.n_frames == 3


@pytest.mark.parametrize(
    ("name", "per_second"),
    [
        *(("time", 1), ("t", 1), ("Time [s]", 1), ("TIME_S", 1), ("timestamp", 1), ("stamp", 1)),
        *(("seconds", 1), ("time_stamp", 1), ("t [ms]", 1e3), ("time (ms)", 1e3), ("time_ms", 1e3)),
        *(("ms", 1e3), ("millis", 1e3), ("stamp_us", 1e6), ("time [\u00b5s]", 1e6), ("t_ns", 1e9)),
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


@pytest.mark.parametrize("name", ["t1", "s", "us", "tip", "sensor", "mst", "timer", "thumb", "ts0"])
def test_sensors_with_names_similar_to_time(put: Put, name: str) -> None:
    rising = np.column_stack([np.arange(30.0), READINGS[:, 0]])
    found = io.read(put("skin.csv", f"{name},b\n" + table(rising)))
    assert found.names == (name, "b")
    assert found.times is None


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


@pytest.mark.parametrize("name", ["Zeit", "zeit_ms", "Zeitstempel [ms]", "temps", "\u65f6\u95f4"])
def test_time_columns_in_other_languages(put: Put, name: str) -> None:
    times = np.arange(30) * 0.02
    scale = 1e3 if "ms" in name else 1
    rows = np.column_stack([times * scale, READINGS])
    found = io.read(put("skin.csv", f"{name},a,b,c,d\n" + table(rows)))
    assert found.names == ("a", "b", "c", "d")
    np.testing.assert_allclose(found.times, times, atol=1e-12)


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


def test_steady_sensors_named_like_the_others_stay(put: Put) -> None:
    ramp = np.column_stack([np.arange(30) * 0.02, READINGS])
    for header in ("s0,s1,s2,s3,s4", "left,a,b,c,d", "thumb,index1,ring2,palm3,palm4"):
        found = io.read(put("skin.csv", header + "\n" + table(ramp)))
        np.testing.assert_array_equal(found.readings, ramp)


@pytest.mark.parametrize("header", ["", "label{0}a{0}b{0}c{0}d{0}note\n"])
@pytest.mark.parametrize("dialect", [(",", "."), (";", ","), ("\t", "."), (" ", ".")])
def test_columns_of_text_are_skipped(put: Put, header: str, dialect: tuple[str, str]) -> None:
    delimiter, decimal = dialect
    lines = table(READINGS, delimiter, "\n", decimal).splitlines()
    rows = "".join(f"rest{delimiter}{line}{delimiter}x1\n" for line in lines)
    with pytest.warns(AnisomapWarning, match=r"skipped text.* in column 1 .*, column 6 "):
        found = io.read(put("skin.csv", header.format(delimiter) + rows))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == (("a", "b", "c", "d") if header else ("s0", "s1", "s2", "s3"))
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
    assert "is not a number" in read_error(put("skin.csv", "a,b\nx,y\nz,w\n"))


def test_a_finger_named_index_is_a_sensor(put: Put) -> None:
    found = io.read(put("hand.csv", "index,thumb,middle,ring\n" + table(READINGS)))
    assert found.names == ("index", "thumb", "middle", "ring")


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


@pytest.mark.parametrize(
    "first",
    [
        np.arange(30.0) ** 2,  # rises, but not steadily
        np.minimum(np.arange(30.0), 20),  # saturates
        np.where(np.arange(30) % 10 == 9, 0, np.arange(30.0)),  # falls back
        np.where(np.arange(30) == 0, np.nan, np.arange(30.0)),
    ],
)
def test_an_unsteady_first_column_is_a_sensor(put: Put, first: np.ndarray) -> None:
    values = np.column_stack([first, READINGS])
    found = io.read(put("skin.csv", table(values)))
    np.testing.assert_array_equal(found.readings, values)


def test_ramps_are_not_time(put: Put) -> None:
    ramps = np.arange(120.0).reshape(30, 4)
    np.testing.assert_array_equal(io.read(put("x.csv", table(ramps))).readings, ramps)
    short = np.column_stack([np.arange(5) / 10, READINGS[:5]])
    np.testing.assert_array_equal(io.read(put("x.csv", table(short))).readings, short)


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


def test_lines_of_wrong_width_are_located_without_header(put: Put) -> None:
    message = read_error(put("skin.csv", "# comment\n\n1 2 3\n4 5 6\n7 8\n"))
    assert "line 5 has 2 fields, but line 3 has 3" in message


def test_a_permanent_change_of_width_is_located(put: Put) -> None:
    message = read_error(put("skin.csv", "1,2,3\n" * 600 + "1,2\n" * 600))
    assert "line 601 has 2 fields, but line 1 has 3" in message


@pytest.mark.parametrize("far", [2, 512, 513, 1700])
@pytest.mark.parametrize("word", ["abc", "1.2.3", "0x1F", "1_000", "12:30", "--", "\u0661", "1 2"])
def test_text_instead_of_a_number_is_located(put: Put, far: int, word: str) -> None:
    lines = ["a,b,c", *["1,2,3"] * 2000]
    lines[far - 1] = f"1,{word},3"
    message = read_error(put("skin.csv", "\r\n".join(lines)))
    assert f"skin.csv, line {far}, column 2 (b): '{word}' is not a number" in message


def test_text_is_located_in_other_dialects(put: Put) -> None:
    assert "line 2, column 1: 'x,5' is not" in read_error(put("x.csv", "1,5;2,5\nx,5;3\n"))
    assert "line 3, column 2: 'four' is not" in read_error(put("x.txt", "1 2\n\n3 four\n5 6\n"))
    assert "line 2, column 2: 'x' is not" in read_error(put("x.csv", '"1","2"\n"3","x"\n'))


def test_long_text_is_shortened_in_messages(put: Put) -> None:
    message = read_error(put("x.csv", "a,b\n1," + "x" * 10_000 + "\n"))
    assert "xxx..." in message
    assert len(message) < 400


def test_a_file_with_only_a_header_is_rejected(put: Put) -> None:
    assert "holds only a header" in read_error(put("x.csv", "a,b,c\n"))
    assert "no line of numbers" in read_error(put("x.csv", "# a comment\n\n"))


def test_a_file_with_only_times_is_rejected(put: Put) -> None:
    assert "no sensor" in read_error(put("x.csv", "time\n1\n2\n3\n"))


def test_a_header_of_another_width_is_rejected(put: Put) -> None:
    assert "line 2 has 3 fields, but the header names 2" in read_error(put("x.csv", "a,b\n1,2,3\n"))
    assert "line 2 has 2 fields, but the header names 3" in read_error(put("x.csv", "a,b,c\n1,2\n"))


def test_duplicate_names_are_made_distinct(put: Put) -> None:
    path = put("x.csv", "a,b,a,a_2,a\n1,2,3,4,5\n6,7,8,9,10\n")
    with pytest.warns(AnisomapWarning, match=r"x\.csv: several sensors have the name a; they"):
        found = io.read(path)
    assert found.names == ("a", "b", "a_3", "a_2", "a_4")
    np.testing.assert_array_equal(found.readings[0], [1, 2, 3, 4, 5])


def test_encodings_other_than_utf_8_are_rejected(put: Put) -> None:
    message = read_error(put("x.csv", "a,b\n1,2\n3,4\n# \u00b5\n".encode("latin-1")))
    assert "x.csv is not UTF-8 text (line 4, byte 0xb5)" in message
    assert "is UTF-16 text" in read_error(put("x.csv", "a,b\n1,2\n".encode("utf-16")))


def test_null_bytes_are_located(put: Put) -> None:
    far = b"1,2\n" * 20_000 + b"3,\0\0\n"
    assert "line 20001, column 2: '\\x00\\x00' is not a number" in read_error(put("x.csv", far))


def test_truncated_gzip_files(put: Put) -> None:
    values = np.random.default_rng(0).integers(0, 256, (9000, 5))
    packed = gzip.compress(table(values).encode())
    for end in (len(packed) - 9, len(packed) // 2, 4000):
        with pytest.warns(AnisomapWarning, match=r"x\.csv.*damaged or cut short.* frames before"):
            found = io.read(put("x.csv", packed[:end]))
        np.testing.assert_array_equal(found.readings, values[: found.n_frames])
        assert found.n_frames > 0.9 * len(values) * end / len(packed) - 700
    assert "damaged or cut short" in read_error(put("x.csv", packed[:20]))


def test_a_truncated_last_line(put: Put) -> None:
    with pytest.warns(AnisomapWarning, match=r"last line \(4\) is truncated in field 2 of 3"):
        found = io.read(put("x.csv", "a,b,c\n1,2,3\n4,5,6\n7,8"))
    assert found.readings.tolist() == [[1, 2, 3], [4, 5, 6]]
    with pytest.warns(AnisomapWarning, match="field 3 of 3"):
        assert io.read(put("x.csv", "1,2,3\n4,5,6\n7,8,-")).n_frames == 2
    assert "line 4 has 2 fields" in read_error(put("x.csv", "a,b,c\n1,2,3\n4,5,6\n7,8\n"))
    assert "line 3 has 4 fields" in read_error(put("x.csv", "a,b,c\n1,2,3\n4,5,6,7"))
    assert "line 2 has 2 fields" in read_error(put("x.csv", "a,b,c\n1,2"))


def test_unbalanced_quotation_marks(put: Put) -> None:
    assert "unbalanced quotation marks" in read_error(put("x.csv", 'a,"b\n' + "1,2\n" * 10))


@given(st.floats(allow_nan=False) | st.integers(-(10**6), 10**6))
def test_numbers_are_parsed_as_by_python(value: float) -> None:
    assert parse_number(f" {value!r} ") == value


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


@pytest.mark.parametrize("rows", ['{},"[1, 2, 3, 4]"\n', "{};[1 2 3 4]\n"])
def test_a_column_of_lists_beyond_the_header_is_refused(tmp_path, rows):
    path = tmp_path / "lists.csv"
    path.write_text("time\n" + "".join(rows.format(i) for i in range(30)))
    with pytest.raises(FileError, match="line 2 has 2 fields, but the header names 1"):
        io.read(path)
