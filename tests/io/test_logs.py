"""Logs of real programs: each is read right, or refused with what would be right."""

import json

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import FileError, InputError
from anisomap.io import ReadOptions
from texts import read_alike, sent

N, T = 12, 300
RNG = np.random.default_rng(5)
PRESSED = np.where(RNG.random((T, N)) < 0.3, RNG.integers(20, 3000, (T, N)), 0)
NAMES = [f"c{i}" for i in range(N)]
FRAMES = [*enumerate(PRESSED.tolist())]


def joined(row, mark=","):
    return mark.join(map(str, row))


def table(rows, mark=",", names=NAMES):
    lines = [names, *rows] if names else [*rows]
    return "".join(joined(row, mark) + "\n" for row in lines)


def lines(form):
    """Write a line for each frame: `form` gives it from the number and the readings."""
    return "".join(form(t, row) + "\n" for t, row in FRAMES)


ESCAPED = "\x1b[0;32mI ({}) SKIN: {}\x1b[0m"
READ = {
    "numpy scalars": lines(lambda t, row: f"[{', '.join(f'np.int64({v})' for v in row)}]"),
    "lists of JSON": lines(lambda t, row: json.dumps(row)),
    "objects of JSON": lines(
        lambda t, row: json.dumps(dict(zip(NAMES, row, strict=True)), separators=(",", ":"))
    ),
    "colours of a terminal": lines(lambda t, row: ESCAPED.format(1020 + 20 * t, joined(row, " "))),
    "stamps in two columns": lines(
        lambda t, row: f"{1_700_000_000 + t // 50},{t % 50 * 20_000_000},skin,{joined(row)}"
    ),
    "stamps of JSON": lines(
        lambda t, row: json.dumps(
            {"stamp": {"sec": 1_700_000_000 + t // 50, "nanosec": t % 50 * 20_000_000}, "d": row}
        )
    ),
    "a time zone": "time,"
    + table([[f"2026-03-01T10:00:{t / 50:09.6f}+01:00", *row] for t, row in FRAMES]),
    "durations of pandas": ","
    + table([[f"0 days 00:00:{t / 50:09.6f}", *row] for t, row in FRAMES]),
    "a header in a comment": "# rate: 50 Hz\n# " + table(PRESSED),
    "a header of MATLAB": "% " + table(PRESSED, "\t"),
    "a header of C": "// " + table(PRESSED, " "),
    "cells that pad a title": f"Skin{',' * 11}\nDate,2026-03-01{',' * 10}\n" + table(PRESSED),
    "BOM and empty columns": "\ufeff" + table(PRESSED, ";").replace("\n", ";;;\r\n"),
    "an empty first column": "," + table(PRESSED).replace("\n", "\n,").removesuffix(","),
    "a repeated header": table(PRESSED[:100]) + table(PRESSED[100:]),
    "c0 and others every 50 lines": "".join(table(PRESSED[i : i + 50]) for i in range(0, T, 50)),
    "a restart": "Booting\n"
    + table(PRESSED[:9], names=None)
    + "Booting\n"
    + table(PRESSED[9:], names=None),
    "a clock of CoolTerm": lines(lambda t, row: f"2026-03-01 10:00:{t / 50:06.3f} {joined(row)}"),
    "stamps of JSON, with text": lines(
        lambda t, row: json.dumps({"ts": t / 50, "data": joined(row)})
    ),
    "a second header": joined(["S"] * N) + "\n" + table(PRESSED, names=range(N)),
    "a list with its length": lines(lambda t, row: f"taxels,{N},{N},0,{joined(row)}"),
    "checksums of NMEA": lines(lambda t, row: f"{joined(row)}*{t % 256:02X}"),
    "checksums": lines(lambda t, row: f"{joined(row)},{(sum(row) * 40503 + t) % 65536:04X}"),
    "a clock of Zephyr": lines(
        lambda t, row: f"[00:{t // 60:02}:{t % 60:02}.100,000] skin: {joined(row, ' ')}"
    ),
    "words between frames": lines(
        lambda t, row: f"SCAN {t}\n" + table(np.reshape(row, (3, 4)), names=None) + "END"
    ),
    "places of sensors": table([np.arange(N) % 4 * 5, np.arange(N) // 4 * 5, *PRESSED]),
    "gains of sensors": table([np.arange(N) / 100 + 1, *PRESSED]),
    "a temperature": lines(lambda t, row: f"{joined(row)},{24 + t / 128:.2f}"),
    "c0 and units": lines(lambda t, row: " ".join(f"c{i}={v}mV" for i, v in enumerate(row))),
    "stamps of JSON, with objects": lines(
        lambda t, row: json.dumps({"t": t / 50, "d": [{"id": v, "v": row[v]} for v in range(N)]})
    ),
    "stamps of each channel": table(
        [[x for v in row for x in (t / 50, v)] for t, row in FRAMES],
        names=[x for name in NAMES for x in ("X[s]", name)],
    ),
    "a counter of 4 bits": table([[t % 16, *row] for t, row in FRAMES], names=None),
    "labels and limits": lines(
        lambda t, row: "Min:0,Max:4095," + ",".join(f"c{i}:{v}" for i, v in enumerate(row))
    ),
}


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@pytest.mark.parametrize("kind", READ)
def test_logs_are_read(put, kind: str) -> None:
    found = read_alike(put("log.jsonl" if "JSON" in kind else "log.txt", READ[kind]))
    np.testing.assert_array_equal(found.readings, PRESSED)
    named = READ[kind].startswith(tuple("ceM{%/#")) and "stamps" not in kind
    assert found.names[:2] == ("c0", "c1") or not named
    if "stamps" in kind or "zone" in kind or "days" in READ[kind]:
        assert found.rate_hz == pytest.approx(50)


def by_board(label):
    return "".join(
        f"{label(k)},{joined(row[4 * k : 4 * k + 4])}\n" for _, row in FRAMES for k in range(3)
    )


def by_sensor(form):
    return "".join(form(t, i, v) + "\n" for t, row in FRAMES for i, v in enumerate(row))


def candump(form):
    return lines(lambda t, r: f"({t / 50}) can0 100#" + "".join(f"{v:{form}}" for v in r[:4]))


SMOOTH = RNG.normal(size=(T, 2, 6)).cumsum(axis=0).round(2)
MIXED = RNG.permuted([[0, 1]] * T, axis=1)
REFUSED = {
    "json": (json.dumps({"data": PRESSED.tolist()}), "lines with an object or a list per frame"),
    "numpy, in short": (
        lines(lambda t, row: np.array2string(np.tile(row, 99), threshold=9)),
        "leaves out numbers, as in .*savetxt",
    ),
    "topics": (
        lines(lambda t, row: "data:\n" + "".join(f"- {v}\n" for v in row) + "---"),
        "record a bag, or use --csv",
    ),
    **{f"candump of {form}": (candump(form), "CAN bus .*decode") for form in ("04X", "04d", "04x")},
    "hexadecimal": (
        lines(lambda t, row: " ".join(f"0x{v:04X}" for v in row)),
        "'0x0000' is not a number; write decimal numbers",
    ),
    "hexadecimal bytes": (
        lines(lambda t, row: f"{t:08x}: " + " ".join(f"{v:04x}" for v in row)),
        "holds hexadecimal numbers, as in '00000000: ",
    ),
    "MATLAB": ("  Columns 1 through 12\n\n" + table(PRESSED, " ", None), "use writematrix"),
    "no blanks": (lines(lambda t, row: "".join(f"{v + 1000:4}" for v in row)), "no separators"),
    "thousands": (
        table([[f"{v:,}".replace(",", "'") for v in row] for row in PRESSED], ";"),
        "is not a number; remove thousands",
    ),
    "thousands like decimals": (
        table([[f"{v:,}" for v in row] for row in PRESSED], ";"),
        "commas separate thousands",
    ),
    "commas twice": (
        table([[f"{v / 10:.1f}".replace(".", ",") for v in row] for row in PRESSED]),
        "save it with semicolons",
    ),
    "labels in any order": (
        lines(
            lambda t, row: " ".join(f"S{i}={row[i]}" for i in [*range(N)][:: (-1) ** t])
        ),
        "the labels of the values must not change",
    ),
    "boards": (by_board(lambda k: f"B{k}"), "column 1 repeats .* 3 lines seem to be a frame"),
    "boards in any order": (
        "".join(f"{'AB'[k]},{joined(SMOOTH[t, k])}\n" for t in range(T) for k in MIXED[t]),
        "column 1 names boards",
    ),
    "bytes": (lines(lambda t, row: f"{bytes(v % 256 for v in row)}"), r"print list\(data\)"),
    "wrapped lines": (table(PRESSED, "  ").replace("c11", "c11 \\"), "wraps its lines"),
    "frames in a line": (str([*map(tuple, PRESSED.tolist())])[1:], "a single line"),
    "readings by line": (
        "time,node,adc\n" + by_sensor(lambda t, i, v: f"{t / 50},{i},{v}"),
        r"pivot\(index='time', columns='node', values='adc'\)",
    ),
    "cells by line": (
        "frame,row,col,value\n" + by_sensor(lambda t, i, v: f"{t},{i // 4},{i % 4},{v}"),
        r"\(col\) repeats 0, 1, 2",
    ),
    "sensors in rows": (
        "sensor," + joined(f"t{t}" for t, _ in FRAMES) + "\n"
        + "".join(f"c{i},{joined(row)}\n" for i, row in enumerate(PRESSED.T)),
        "transpose the table",
    ),
    "objects of a reading": (
        by_sensor(lambda t, i, v: json.dumps({"t": t / 50, "id": i, "v": v, "gain": 2})),
        "lists events",
    ),
    "two tables": (
        table(PRESSED[:99]) + table(PRESSED[99:, ::-1], names=NAMES[::-1]),
        "line 101, .*a second header",
    ),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore::anisomap.errors.AnisomapWarning")
@pytest.mark.parametrize("kind", REFUSED)
def test_logs_are_refused_with_what_would_be_right(put, kind: str) -> None:
    text, said = REFUSED[kind]
    assert kind == "two tables" or not len(sent(text.encode())[1])
    with pytest.raises(FileError, match=said):
        io.read(put("log.csv", text))


TIMED = np.column_stack([np.arange(T) / 50, PRESSED])


@pytest.mark.filterwarnings("ignore:.*is taken as time")
def test_a_time_is_kept_as_a_sensor_by_its_name(tmp_path) -> None:
    path = tmp_path / "run.csv"
    np.savetxt(path, TIMED, "%g", ",", header=",".join(["clock", *NAMES]), comments="")
    assert io.read(path).names == tuple(NAMES)
    assert io.read(path, options=ReadOptions(keep=("c*",))).names == tuple(NAMES)
    for keep in (("clock", "c0-c11"), ("clock-c11",)):
        found = io.read(path, options=ReadOptions(keep=keep))
        assert found.names == ("clock", *NAMES)
        np.testing.assert_allclose(found.readings, TIMED, rtol=1e-6)
        assert found.times is None


def test_columns_without_a_header_are_kept_by_number(put) -> None:
    path = put("run.csv", table(TIMED.tolist(), names=None))
    assert io.read(path).names[0] == "s0"
    found = io.read(path, options=ReadOptions(keep=("column 1", "s0-s11")))
    assert found.names == ("column 1", *(f"s{i}" for i in range(N)))
    np.testing.assert_array_equal(found.readings, TIMED)


@pytest.mark.filterwarnings("ignore:.*skipped text in")
def test_text_is_not_kept(put) -> None:
    path = put("run.csv", "label," + table([["on", *row] for row in PRESSED.tolist()]))
    with pytest.raises(InputError, match="column label holds text"):
        io.read(path, options=ReadOptions(keep=("label", "c0-c3")))


def test_an_inertial_unit_is_no_layout(put) -> None:
    text = "time,x,y,z\n" + "".join(f"{t / 50},{t % 3},{t % 5},9.8\n" for t in range(50))
    with pytest.raises(FileError, match=r"holds times .*'time'.* not a list of positions"):
        io.read_map(put("imu.csv", text))


def test_a_remark_is_no_header(put) -> None:
    rows = PRESSED[:, :3]
    found = io.read(put("log.txt", "# left foot pressure\n" + table(rows, " ", None)))
    np.testing.assert_array_equal(found.readings, rows)
    assert found.names == ("s0", "s1", "s2")
