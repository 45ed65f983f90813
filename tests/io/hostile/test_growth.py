"""Reading hostile text takes time linear in its size.

Linear time is at most seconds at `SIZE`, and quadratic time at least half a minute: the guard is
about hangs, and no measurement.
"""

import signal
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from anisomap import io
from anisomap.errors import AnisomapError
from anisomap.io.parsing.source import HEAD_BYTES
from anisomap.placement import parse_length
from anisomap.sensor_map import SensorMap

SIZE = 1 << 18
HANG_S = 15
"""CPU time of this process, so that other processes do not count."""

HOSTILE = {
    "entry-blanks.csv": ("Comment", " ", "\n1,2\n3,4\n"),
    "entry-words.csv": ("", "a ", "!\n1,2\n"),
    "entry-marks.csv": ("rows", ' "', "!\n1,2\n"),
    "frame.asf": ("frame 1", " ", "!\n1,2\n"),
    "clock.asf": ("rows 1\ncols 2\nframe 1\ntime", " :", "!\n1,2\nframe 2\n3,4\n"),
    "clock-digits.asf": ("rows 1\ncols 2\nframe 1\ntime 1:", "1", "\n1,2\nframe 2\n3,4\n"),
    "taxels.txt": ("", "taxel2Repr(", "\n[calibration]\n1 0 0 0 0 1\n"),
    "comments.xml": ("", "<!--", ""),
    "declarations.xml": ("", "<?", ""),
    "blanks.xml": ("<", " ", "robot/>"),
    "stamps.log": ("1 ", "1", "\n2 1.5 3\n"),
    "quotes.csv": ("a,b\n1,2\n", '"', ""),
    "quoted.txt": ("a b\n", '"a ', "\n1 2\n"),
    "header.csv": ("time", ",time", "\n"),
    "text.csv": ("a", ",a", "\n"),
    "contacts.csv": ("time,taxels\n0,", "1 ", "\n"),
    "lists.csv": ('a,b\n0,"', "1,", '"\n1,"2"\n'),
    "events.log": ("1 1.5 ((", "1 ", "))\n2 1.6 \n"),
    "addresses.txt": ("", "1 ", "\n0 0.5 1 1\n"),
    "calibration.json": ('{"skin": {"taxels": [', '{"id": 1, "x": [0, 0, 0]},', '{"id": 2}]}}'),
    "brackets.json": ("", "[", ""),
    "map.json": ('{"a": "', "a", '"}'),
    "points.ply": ("ply\nformat ascii 1.0\n", "comment a: 1\n", "end_header\n"),
}


@contextmanager
def no_hang() -> Iterator[None]:
    """Ignore refusals; fail after `HANG_S`, where the system has a timer of CPU time."""

    def fail(*_: object) -> None:
        raise AssertionError(f"still computing after {HANG_S} s")

    with warnings.catch_warnings(), suppress(AnisomapError):
        warnings.simplefilter("ignore")
        if not hasattr(signal, "setitimer"):
            yield
            return
        before = signal.signal(signal.SIGPROF, fail)
        signal.setitimer(signal.ITIMER_PROF, HANG_S)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            signal.signal(signal.SIGPROF, before)


@pytest.mark.slow
@pytest.mark.parametrize("reader", [io.read, io.read_map])
@pytest.mark.parametrize("name", HOSTILE)
def test_reading_takes_linear_time(name: str, reader, tmp_path: Path) -> None:
    before, repeated, after = HOSTILE[name]
    path = tmp_path / name
    path.write_text(before + repeated * (SIZE // len(repeated)) + after, encoding="utf-8")
    with no_hang():
        reader(path)


def test_names_and_lengths_take_linear_time(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "data.log").write_text("1 1.5 3 4\n2 1.6 3 5\n")
    (tmp_path / "a" / "info.log").write_text("]/x" * (SIZE // 3))
    with no_hang():
        io.contents(tmp_path)
    long = SensorMap(np.eye(3), names=["a" + "1" * SIZE + "x", "b", "c"], units="m")
    with no_hang():
        io.write(long, tmp_path / "s.icub.txt")
    with no_hang():
        parse_length("e" * SIZE + "!")


@pytest.mark.parametrize("repeated", ["\n", " ", "\t", "[", "<", "# ", "a:"])
def test_recognising_takes_linear_time(repeated: str, tmp_path: Path) -> None:
    path = tmp_path / "start.txt"
    path.write_text("DATA_TYPE " + repeated * (HEAD_BYTES // len(repeated)), newline="")
    with no_hang():
        for _ in range(10):
            with suppress(AnisomapError):
                io.read_map(path)
