"""Lines as programs print them, with text around the numbers, and frames of several lines."""

import json
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from anisomap import io
from anisomap.errors import AnisomapWarning, FileError
from anisomap.recording import Recording
from texts import read_alike, sent

ROWS, COLUMNS = 3, 4
READINGS = np.random.default_rng(3).integers(0, 400, (40, ROWS * COLUMNS))
READINGS[READINGS < 150] = 0
READINGS[:, 5] = 0  # a dead sensor is a sensor
NAMES = [f"c{k}" for k in range(ROWS * COLUMNS)]


def clock(i: int) -> str:
    return f"10:{i // 3000:02d}:{i // 50 % 60:02d}.{20 * i % 1000:03d}"


def joined(values: list, mark: str = ",") -> str:
    return mark.join(map(str, values))


def labelled(form: str, mark: str = " ") -> Callable[[int, list[int]], str]:
    return lambda _, row: mark.join(form.format(k=k, v=v) for k, v in enumerate(row))


def matrix(row: list[int], mark: str = " ") -> str:
    return "\n".join(joined(part, mark) for part in np.reshape(row, (ROWS, COLUMNS)).tolist())


LINES: dict[str, tuple[Callable[[int, list[int]], str], float | None, str]] = {
    "arrow and tabs": (lambda i, r: f"{clock(i)} -> " + joined(r, "\t"), 50, "s0"),
    "arrow and commas": (lambda i, r: f"{clock(i)} -> " + joined(r), 50, "s0"),
    "clock in brackets": (lambda i, r: f"[{clock(i)}] " + joined(r), 50, "s0"),
    "seconds and a colon": (lambda i, r: f"{i / 50}: " + joined(r, " "), 50, "s0"),
    "date, clock, level": (lambda i, r: f"2026-03-01 {clock(i)} INFO " + joined(r, " "), 50, "s0"),
    "a log of ESP-IDF": (lambda i, r: f"I ({1000 + 20 * i}) SKIN: " + joined(r, " "), 50, "s0"),
    "a log of glog": (lambda i, r: f"I1103 {clock(i)} 48 a.cc:9] " + joined(r, " "), 50, "s0"),
    "a launch of ROS 2": (lambda i, r: f"[a-1] [INFO] [{1e9 + i / 50}] [b]: {joined(r)}", 50, "s0"),
    "an address": (lambda _, r: f"192.168.1.7:5005 -> {joined(r)}", None, "s0"),
    "controls": (lambda _, r: f"\x1b]0;lab\a\x13{joined(r)}", None, "s0"),
    "a list": (lambda _, r: str(r), None, "s0"),
    "a time and a list": (lambda i, r: str((i / 50, r)), 50, "s0"),
    "an array": (lambda _, r: repr(np.array(r)), None, "s0"),
    "a wrapped array": (lambda _, r: np.array2string(np.array(r), max_line_width=30), None, "s0"),
    "a matrix": (lambda _, r: str(np.array(r).reshape(ROWS, COLUMNS)), None, "r0c0"),
    "a tensor": (lambda _, r: f"tensor({r}, device='cuda:0')", None, "s0"),
    "a dictionary": (lambda _, r: str(dict(zip(NAMES, r, strict=True))), None, "c0"),
    "JSON": (lambda i, r: json.dumps({"t": i / 50, "p": r}), 50, "p.0"),
    "labels with a colon": (labelled("S{k}:{v}"), None, "S0"),
    "labels with an equals sign": (labelled("c{k}={v}"), None, "c0"),
    "labels of two words": (labelled("Sensor {k}: {v}", ", "), None, "Sensor 0"),
    "labels with an index": (labelled("s[{k}]={v}", "; "), None, "s[0]"),
    "labels before a blank": (labelled("T{k} {v}"), None, "T0"),
    "letters": (lambda _, r: " ".join(map("{}{}".format, "ABCDEFGHIJKL", r)), None, "A"),
    "NMEA": (lambda i, r: f"$SKIN,{joined(r)}*{i % 100:02X}", None, "s0"),
    "blocks": (lambda _, r: matrix(r) + "\n", None, "r0c0"),
    "blocks with commas": (lambda _, r: matrix(r, ",") + "\n", None, "r0c0"),
    "blocks below comments": (lambda _, r: "# a frame\n" + matrix(r), None, "r0c0"),
    "blocks with titles": (lambda i, r: f"frame at {i / 50}\n{matrix(r)}\n", None, "r0c0"),
}
"""Each gives the lines of a frame; the rate and the name of the first sensor follow."""


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@pytest.mark.parametrize("kind", LINES)
def test_lines_of_programs(put, kind: str) -> None:
    write, rate, first = LINES[kind]
    text = "".join(write(i, row) + "\n" for i, row in enumerate(READINGS.tolist()))
    found = read_alike(put("log.txt", text))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names[0] == first
    assert found.rate_hz == (rate and pytest.approx(rate, rel=1e-4))


HEADER = joined(NAMES)
TABLES = {
    "a row of units": (f"{HEADER}\n{joined(['kPa'] * len(NAMES))}\n", lambda _, r: joined(r)),
    "bars": (joined(NAMES, "|") + "\n", lambda _, r: joined(r, "|")),
    "a table of Markdown": (
        f"| {joined(NAMES, ' | ')} |\n|{'---|' * len(NAMES)}\n",
        lambda _, r: f"| {joined(r, ' | ')} |",
    ),
    "row names": (f"{joined(NAMES, ' ')}\n", lambda i, r: f"{i} {joined(r, ' ')}"),
    "units at the values": (f"{HEADER}\n", lambda _, r: joined([f"{v} mN" for v in r])),
    "a label beside them": (f"who,{HEADER}\n", lambda i, r: f"S{i // 20:02d},{joined(r)}"),
}


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@pytest.mark.parametrize("kind", TABLES)
def test_tables_of_programs(put, kind: str) -> None:
    header, write = TABLES[kind]
    text = header + "".join(write(i, row) + "\n" for i, row in enumerate(READINGS.tolist()))
    found = read_alike(put("table.csv", text))
    np.testing.assert_array_equal(found.readings, READINGS)
    assert found.names == tuple(NAMES)


@pytest.mark.parametrize(
    ("header", "stamp"),
    [
        ("time", "2026-03-01T10:00:{:06.3f}"),
        ("time", "2026-03-01T10:00:{:06.3f}+01:00"),
        ("time", "2026-03-01T1{1}:00:{0:06.3f}+0{1}:00"),
        ("time", "2026-03-01T0{1}:30:{0:06.3f}-0{2}30"),
        ("", "2026-03-01 10:00:{:06.3f}"),
        ("when", "10:00:{:06.3f}"),
        ("Datum,Zeit", "01.03.2026,10:00:{:06.3f}"),
        ("t", "3/1/2026 10:00:{:06.3f} PM"),
        ("t", "Sun Mar  1 10:00:{:06.3f} 2026"),
        ("t", "01-Mar-2026 10:00:{:06.3f}"),
    ],
)
def test_dates_and_clocks(put, header: str, stamp: str) -> None:
    stamps = [stamp.format(i / 50, i % 2, 1 - i % 2) for i in range(40)]
    rows = "".join(f"{s},{joined(r)}\n" for s, r in zip(stamps, READINGS.tolist(), strict=True))
    found = read_alike(put("run.csv", f"{header},{HEADER}\n{rows}"))
    assert found.names == tuple(NAMES)
    np.testing.assert_allclose(found.times, np.arange(40) / 50, atol=1e-6)


WORDS = ("NA", "n/a", "null", "None", "NaN", "-", "", "nil", "?", "--", "#N/A", "#DIV/0!")


@pytest.mark.parametrize("mark", [",", ";", "\t", "|"])
def test_words_for_missing_values(put, mark: str) -> None:
    words = iter(WORDS * 40)
    rows = [
        [next(words) if k == i % 12 else v for k, v in enumerate(r)]
        for i, r in enumerate(READINGS.tolist())
    ]
    found = read_alike(put("gaps.csv", "".join(joined(row, mark) + "\n" for row in [NAMES, *rows])))
    expected = np.where(np.arange(12) == np.arange(40)[:, None] % 12, np.nan, READINGS)
    np.testing.assert_array_equal(found.readings, expected)


@pytest.mark.parametrize("kind", ["arrow and commas", "labels with a colon", "a list", "JSON"])
@pytest.mark.parametrize("wrong", ["overflow", "S0:1 S1:2", "1, 2, 3", "[1, 2, 3]"])
def test_the_first_line_that_does_not_fit_is_shown(put, kind: str, wrong: str) -> None:
    write, _, _ = LINES[kind]
    lines = [write(i, row) for i, row in enumerate(READINGS.tolist())]
    lines[30] = wrong
    with pytest.warns(AnisomapWarning, match="left out lines: 1 of 40.*: line 31") as caught:
        found = io.read(put("log.txt", "\n".join(lines) + "\n"))
    assert wrong[:9] in str(caught[-1].message)
    expected = READINGS.copy()
    expected[30] = READINGS[29]
    np.testing.assert_array_equal(found.readings[-9:], expected[-9:])
    lines[31] = wrong
    with pytest.raises(FileError, match="line 31"):
        io.read(put("log.txt", "\n".join(lines)))


@pytest.mark.parametrize("n_bad", [1, 10, 11])
def test_up_to_one_line_in_a_hundred_is_left_out(put, n_bad: int) -> None:
    rows = [f"{i / 50},{i % 7},{i % 5}\n" for i in range(1000)]
    for i in range(n_bad):
        rows[50 + 80 * i] = "WARN: i2c timeout\n" if i % 2 else "0.5,12\n"
    path = put("log.csv", "".join(["time,a,b\n", *rows]))
    if n_bad > 10:
        with pytest.raises(FileError, match="line 52 has 2 instead of 3 fields"):
            io.read(path)
        return
    with pytest.warns(AnisomapWarning, match=rf"left out lines: {n_bad} of 1000: line 52 has"):
        found = io.read(path)
    assert found.n_frames == 1000 - n_bad
    assert found.rate_hz == pytest.approx(50)


@pytest.mark.parametrize("mark", ["\t", ", ", " "])
@pytest.mark.parametrize("label", ["T{}_{}:", "t{}p{}=", "L{}_R{}: "])
def test_labels_with_two_numbers(put, mark: str, label: str) -> None:
    names = [label.format(i // 4, i % 4) for i in range(12)]
    lines = [mark.join(map("{}{}".format, names, map(int, row))) for row in READINGS.tolist()]
    found = read_alike(put("log.txt", "\n".join(lines) + "\n"))
    assert found.names == tuple(name.rstrip(":= ") for name in names)
    np.testing.assert_array_equal(found.readings, READINGS.astype(int))


@pytest.mark.filterwarnings("ignore:.*numbers the 3 rows of a frame")
@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize(
    "head", ["", "row,a,b,c,d\n", "timestamp,row,c0,c1,c2,c3\n", "frame,row,c0,c1,c2,c3\n"]
)
def test_rows_of_a_matrix_are_joined(put, head: str, first: int) -> None:
    frames = np.random.default_rng(0).integers(1, 9, (40, 3, 4))
    lines = [
        (f"{t / 50}," if "time" in head else f"{t}," if "frame" in head else "")
        + (f"{i + first}," if head else f"Row {i + first}: ")
        + (",".join if head else " ".join)(map(str, row))
        for t, frame in enumerate(frames)
        for i, row in enumerate(frame)
    ]
    del lines[0]  # the log begins in a frame
    found = read_alike(put("log.csv", head + "\n".join(lines) + "\n"))
    np.testing.assert_array_equal(found.readings, frames[1:].reshape(39, 12))
    assert found.names[4] == "r1c0"
    assert (found.rate_hz or 50) == pytest.approx(50)


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@given(
    prefix=st.sampled_from(["", "-> ", "data: ", "[", "<", "#1: ", "A: [", "t=5 v="]),
    mark=st.sampled_from([",", ", ", " ", "\t", ";", " | "]),
    suffix=st.sampled_from(["", "]", ">", " ;", " end"]),
    values=st.lists(st.lists(st.integers(-5, 5), min_size=4, max_size=4), min_size=3, max_size=9),
)
def test_no_sensor_is_lost_or_moved(tmp_path_factory, prefix, mark, suffix, values) -> None:
    """Whatever stands around the numbers: they are all read, in their order, or none is."""
    path = tmp_path_factory.getbasetemp() / "around.txt"
    path.write_text("".join(prefix + joined(row, mark) + suffix + "\n" for row in values))
    try:
        found = io.read(path).readings
    except FileError:
        return
    np.testing.assert_array_equal(found[:, -4:], values)
    assert (found[:, :-4] == found[:1, :-4]).all(), "others are numbers in the text around them"


SLOW = np.random.default_rng(6).normal(0, 9, (200, ROWS * COLUMNS)).cumsum(axis=0).round(3)


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@pytest.mark.parametrize("numbered", [False, True])
def test_rows_without_a_name_are_told_by_their_changes(put, numbered: bool) -> None:
    rows = SLOW.reshape(-1, COLUMNS).tolist()
    text = "".join(f"{i % ROWS}," * numbered + f"{joined(row)}\n" for i, row in enumerate(rows))
    path = put("log.csv", text)
    if not numbered:
        with pytest.raises(FileError, match=r"resembles the one 3 lines before .* --grid 3x4"):
            io.read(path)
        assert not len(sent(text.encode())[1])
    found = read_alike(path, None if numbered else (ROWS, COLUMNS))
    np.testing.assert_array_equal(found.readings, SLOW)
    frames = "".join(f"{i % 7},{joined(row)}\n" for i, row in enumerate(SLOW.tolist()))
    np.testing.assert_array_equal(read_alike(put("frames.csv", frames)).readings, SLOW)


@pytest.mark.parametrize("mark", [-1, 65535, -32768, 2**32 - 1, -9999, 3.402823e38])
@pytest.mark.parametrize("n_marks", [0, 1, 2])
def test_numbers_for_missing_readings(put, mark: float, n_marks: int) -> None:
    slow = np.round(np.abs(SLOW)) + 5.0
    slow[:, :2] += slow.max()
    if mark > 0:  # pressed sensors may be saturated
        slow[::20, :2] = slow[2::20, :2] = 5
    slow[1::20, :n_marks] = mark
    slow[:, 4] = mark  # not connected
    path = put("run.csv", "".join(joined(row) + "\n" for row in slow.tolist()))
    if not n_marks:
        np.testing.assert_array_equal(read_alike(path).readings, slow)
        at_rest = np.maximum(slow - np.median(slow), -1)  # of a board that clips there
        path = put("rest.csv", "".join(joined(row) + "\n" for row in at_rest.tolist()))
        np.testing.assert_array_equal(read_alike(path).readings, at_rest)
        saturated = np.where(slow > np.quantile(slow[:, :2], 0.98), abs(mark), slow)
        path = put("saturated.csv", "".join(joined(row) + "\n" for row in saturated.tolist()))
        np.testing.assert_array_equal(read_alike(path).readings, saturated)
        return
    with pytest.warns(AnisomapWarning, match=r"missing reading in s0.* \(first in frame 1\)"):
        found = io.read(path)
    slow[:, :4][slow[:, :4] == mark] = np.nan
    np.testing.assert_allclose(found.readings, slow)


FIELDS = [f"{10 + i % 5},{20 + i % 7},{30 + i % 9},{41 + i % 8}" for i in range(60)]


@pytest.mark.parametrize("cell", ["12", "12,33", "12,22,FF,43"])
def test_short_lines_and_hexadecimal_digits_are_bad_lines(put, cell: str) -> None:
    with pytest.warns(AnisomapWarning, match="left out lines: 1 of 60"):
        found = io.read(put("run.csv", "\n".join([*FIELDS[:30], cell, *FIELDS[31:]]) + "\n"))
    assert found.readings.shape == (60, 4)
    many = [*FIELDS[:9], *["garbage"] * 20, *FIELDS, "1,2,3,4"]
    with pytest.raises(FileError, match="line 10 has"):  # although the last line may be cut
        io.read(put("many.csv", "\n".join(many)))


PRESSES = np.sin(np.arange(2000)[:, None] / 9 - np.arange(9)).clip(0)
ROWS_OF_PRESSES = [joined(row) for row in (900 * PRESSES).astype(int).tolist()]
TOP = joined([f"s{i}" for i in range(9)])


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@pytest.mark.parametrize("above", ["", TOP, "[boot; v1.2]", joined(["0.0"] * 9), "messages"])
def test_messages_and_lines_at_the_start_are_no_frames(put, above: str) -> None:
    lines, n_more = [above, *ROWS_OF_PRESSES], above.startswith("0")
    if above in ("", TOP, "messages"):
        for i in range(2000, 0, -100):
            lines.insert(i + 1, "heartbeat ok")
    found = io.read(put("run.csv", "\n".join(lines[above == "messages" :]) + "\n")).readings
    assert found.shape[1] == 9
    assert found.shape[0] == 2000 + 20 * (above in ("", TOP, "messages")) + n_more


def test_a_row_that_begins_with_inf_divides_no_frame(put) -> None:
    rows = np.random.default_rng(0).normal(size=(40, 4, 4)).round(3).astype(str)
    rows[20, 2, 0] = "inf"
    text = "\n\n".join("\n".join(joined(row, " ") for row in frame) for frame in rows.tolist())
    with pytest.warns(AnisomapWarning, match="divide frames of 4 rows"):
        assert np.isinf(io.read(put("run.txt", text + "\n")).readings[20, 8])


def test_own_files_keep_numbers_for_missing_readings_and_gaps_are_no_rest(tmp_path) -> None:
    readings = np.round(np.abs(SLOW)) + 5.0
    readings[1::20, 1] = 65535
    io.write(Recording(readings), tmp_path / "own.csv")
    np.testing.assert_array_equal(io.read(tmp_path / "own.csv").readings, readings)
    names = [*(f"s{i}" for i in range(readings.shape[1] - 1)), "palm"]
    readings[5, -1], readings[6, 0] = np.nan, np.inf
    rows = "".join(joined(row) + "\n" for row in readings.tolist())
    (tmp_path / "odd.csv").write_text(f"{joined(names)}\n{rows}")
    assert io.read(tmp_path / "odd.csv").names == tuple(names)


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
def test_lines_that_were_sent_twice_or_cut(put) -> None:
    whole = np.round(SLOW).astype(int) + 50_000
    rows = [f"{t / 50},{joined(row)}\n" for t, row in enumerate(whole.tolist())]
    twice = "".join([*rows[:30], *rows[29:]])
    for text, kept in ((twice, 200), ("".join(rows)[:-4], 199), ("".join(rows)[:-1], 200)):
        found = read_alike(put("run.csv", text))
        np.testing.assert_array_equal(found.readings, whole[:kept])
        assert found.rate_hz == pytest.approx(50)


@pytest.mark.parametrize("name", ["ms", "millis", "micros"])
@pytest.mark.parametrize(
    ("low", "bits"), [(0, 16), (0, 24), (0, 32), (-(2**15), 16), (-(2**31), 32)]
)
def test_clocks_go_on_when_their_counter_is_full(put, name: str, low: int, bits: int) -> None:
    ticks = low + (2**bits - 2000 + 20 * np.arange(200)) % 2**bits
    rows = "".join(f"{t},{joined(row)}\n" for t, row in zip(ticks, SLOW.tolist(), strict=True))
    found = read_alike(put("run.csv", f"{name},{HEADER}\n{rows}"))
    per_second = 1e6 if name == "micros" else 1e3
    np.testing.assert_allclose(np.diff(found.times), 20 / per_second, atol=1e-9)


@pytest.mark.parametrize(
    "line", ["fs = 50 Hz", "Scan rate [kHz]: 0.05", "rate: 50", "baud rate 50"]
)
@pytest.mark.parametrize("header", ["", f"# {HEADER}\n", f"{HEADER}\n"])
def test_a_comment_states_the_rate(put, line: str, header: str) -> None:
    rate = None if "baud" in line else 50
    rows = "".join(f"{joined(row)}\n" for row in SLOW.tolist())
    assert io.read(put("run.csv", f"# skin\n# {line}\n{header}{rows}")).rate_hz == rate
