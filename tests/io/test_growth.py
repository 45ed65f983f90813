"""Reading hostile text takes time linear in its size."""

import time
import warnings
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapError
from anisomap.placement import parse_length
from anisomap.sensor_map import SensorMap

SIZES = [1 << 10, 1 << 13, 1 << 16, 1 << 19, 1 << 20]
STEP = 8
"""Largest ratio of two consecutive sizes."""
TOLERANCE = 4
"""Quadratic time exceeds it: it grows by `STEP` more than linear time."""
FLOOR_S = 0.1
"""Shorter times count as this one. They are mostly fixed costs, and a longer file may need one
more step, such as a second reader. Quadratic time that passes takes at most 3.2 s at 1 MiB."""

HOSTILE = {
    "entry-blanks.csv": ("Comment", " ", "\n1,2\n3,4\n"),
    "entry-tabs.csv": ("note", "\t", "\n1,2\n3,4\n"),
    "entry-words.csv": ("", "a ", "!\n1,2\n"),
    "entry-underscores.csv": ("a", "_", "!\n"),
    "entry-marks.csv": ("rows", ' "', "!\n1,2\n"),
    "frame.asf": ("frame 1", " ", "!\n1,2\n"),
    "frame-marks.asf": ("frame", ":,", "!\n1,2\n"),
    "clock.asf": ("rows 1\ncols 2\nframe 1\ntime", " :", "!\n1,2\nframe 2\n3,4\n"),
    "clock-digits.asf": ("rows 1\ncols 2\nframe 1\ntime 1:", "1", "\n1,2\nframe 2\n3,4\n"),
    "clock-in-frame.asf": ("rows 1\ncols 2\nframe 1\n1,2\nframe 2\ntime", " :", "!\n1,2\n"),
    "taxels.txt": ("", "taxel2Repr(", "\n[calibration]\n1 0 0 0 0 1\n"),
    "taxel-blanks.txt": ("taxel2Repr", " ", "\n[calibration]\n1 0 0 0 0 1\n"),
    "comments.xml": ("", "<!--", ""),
    "closed.xml": ("", "<!---->", "<robot/>"),
    "declarations.xml": ("", "<?", ""),
    "types.xml": ("", "<!DOCTYPE", ""),
    "blanks.xml": ("<", " ", "robot/>"),
    "stamps.log": ("1 ", "1", "\n2 1.5 3\n"),
    "stamp-blanks.log": ("1", " ", "!\n2 1.5 3\n"),
    "quotes.csv": ("a,b\n1,2\n", '"', ""),
    "quoted.txt": ("a b\n", '"a ', "\n1 2\n"),
    "header.csv": ("time", ",time", "\n"),
    "text.csv": ("a", ",a", "\n"),
    "contacts.csv": ("time,taxels\n0,", "1 ", "\n"),
    "contact-rows.csv": ("time,taxels\n", "1,2\n", ""),
    "contact-brackets.csv": ('time,taxels\n0,"', "[", '"\n'),
    "contact-columns.csv": ("time,taxels\n0", ",1", "\n"),
    "lists.csv": ('a,b\n0,"', "1,", '"\n1,"2"\n'),
    "events.log": ("1 1.5 ((", "1 ", "))\n2 1.6 \n"),
    "event-lists.log": ("1 1.5 (", "(1) ", ")\n2 1.6 \n"),
    "event-brackets.log": ("1 1.5 ", "(", "\n2 1.6\n"),
    "addresses.txt": ("", "1 ", "\n0 0.5 1 1\n"),
    "responses.txt": ("1\n2\n0 0.5 2 7 1 8 1\n", "1 0.6 2 7 1 8 1\n", ""),
    "calibration.json": ('{"skin": {"taxels": [', '{"id": 1, "x": [0, 0, 0]},', '{"id": 2}]}}'),
    "brackets.json": ("", "[", ""),
    "map.json": ('{"a": "', "a", '"}'),
    "points.pcd": ("VERSION 0.7\nFIELDS x y z\n", "# a: 1\n", "POINTS 1\nDATA ascii\n0 0 0\n"),
    "points.ply": ("ply\nformat ascii 1.0\n", "comment a: 1\n", "end_header\n"),
}


def timed(call, *arguments: object) -> float:
    start = time.process_time()
    with warnings.catch_warnings(), suppress(AnisomapError):
        warnings.simplefilter("ignore")
        call(*arguments)
    return time.process_time() - start


def assert_linear(seconds_at) -> None:
    before = None
    for size in SIZES:
        # The least of several, because other processes disturb the measurement.
        seconds = min(seconds_at(size) for _ in range(2))
        if before is not None:
            assert seconds < TOLERANCE * STEP * max(before, FLOOR_S), f"at {size} characters"
        before = seconds


@pytest.mark.slow
@pytest.mark.parametrize("reader", [io.read, io.read_map])
@pytest.mark.parametrize("name", HOSTILE)
def test_reading_takes_linear_time(name: str, reader, tmp_path: Path) -> None:
    before, repeated, after = HOSTILE[name]
    path = tmp_path / name

    def seconds_at(size: int) -> float:
        path.write_text(before + repeated * (size // len(repeated)) + after, encoding="utf-8")
        return timed(reader, path)

    assert_linear(seconds_at)


def test_port_names_are_read_in_linear_time(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "data.log").write_text("1 1.5 3 4\n2 1.6 3 5\n")

    def seconds_at(size: int) -> float:
        (tmp_path / "a" / "info.log").write_text("]/x" * (size // 3))
        return timed(io.contents, tmp_path)

    assert_linear(seconds_at)


def test_names_are_numbered_in_linear_time(tmp_path: Path) -> None:
    def seconds_at(size: int) -> float:
        names = ["a" + "1" * size + "x", "b", "c"]
        return timed(
            io.write, SensorMap(np.eye(3), names=names, units="m"), tmp_path / "s.icub.txt"
        )

    assert_linear(seconds_at)


def test_lengths_are_parsed_in_linear_time() -> None:
    assert_linear(lambda size: timed(parse_length, "e" * size + "!"))
