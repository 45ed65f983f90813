"""Recordings that ``yarpdatadumper`` made: ``data.log``, its folder, or a session of folders.

A line is ``sequence stamp value value ...``, or with two stamps (``--txTime --rxTime``) first the
sender's, then the receiver's; the values may stand in brackets. ``info.log`` beside it names the
port. A session is a folder with a folder for every port.
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.choice import Content, choose
from anisomap.io.joining import joined
from anisomap.io.parsing.frames import narrowed
from anisomap.io.parsing.source import DAMAGED_GZIP, opened_text
from anisomap.io.parsing.table import Table, first_rows, is_skipped, line_of, read_blocks
from anisomap.io.stream import Block, ReadOptions, Stream, salvaged
from anisomap.recording import Scalar

_FILE, _INFO = "data.log", "info.log"
_LINE = re.compile(rb"\s*(\d+)\s+(\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)\s+[-+.(\dni]")
_PORT = re.compile(r"\]\s*(/\S+)\s*\[connected\]")
_INFO_CHARACTERS = 1 << 16
_LOOKED_AT, _ROWS_LOOKED_AT = 3, 1000
# Seconds since 1970 of any recording that there is; no reading of a skin is as large.
_EPOCH = 1e8
_SAME_CLOCK_S = 60.0
_BRACKETS = str.maketrans("()", "  ")


def recognises(path: Path, head: bytes) -> bool:
    """Tell a log by its first lines: a rising count, a stamp that does not fall, and values.

    Stamps of a simulator start near zero; a file with such is recognised by its name, too.
    """
    if path.is_dir():
        return bool(_logs(path))
    lines = head.splitlines()
    whole = lines[:-1] or lines  # the last one may be cut
    found = [match for line in whole[:_LOOKED_AT] if (match := _LINE.match(line))]
    if not found or len(found) < len(whole[:_LOOKED_AT]):
        return False
    counts = [float(match[1]) for match in found]
    stamps = [float(match[2]) for match in found]
    rising = all(a < b for a, b in itertools.pairwise(counts))
    return rising and stamps == sorted(stamps) and (stamps[0] >= _EPOCH or path.name == _FILE)


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the ports of a session; nothing of a single file.

    Parameters
    ----------
    path : pathlib.Path
        The file, its folder, or the folder of the session.
    options : ReadOptions
        None of them matters here.
    """
    if not path.is_dir() or (path / _FILE).is_file():
        return ()
    return tuple(Content(_part(path, log), _port(log) or "no info.log") for log in _logs(path))


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a recording in a data.log.

    Parameters
    ----------
    path : pathlib.Path
        The file, the folder that holds it, or the folder of a session.
    options : ReadOptions
        `select` names the port of a session, or several between commas: these become one
        recording, on the clock of the first.

    Yields
    ------
    Stream
        Its times are the sender's stamps from 0 on, or the receiver's where the sender's do not
        increase. A last line that was cut off is left out, with a warning.

    Raises
    ------
    FileError
        With line and column of what cannot be read.
    """
    ports = contents(path, options)
    if not ports:
        folder = path.is_dir()
        source = f"{path.name}/{_FILE}" if folder else path.name
        yield replace(_stream(path / _FILE if folder else path), source=source)
        return
    wanted = [name.strip() for name in options.select.split(",")]
    by_port = tuple(replace(content, name=content.summary) for content in ports)
    if all(any(port.name == name for port in by_port) for name in wanted):
        chosen = [ports[by_port.index(choose(path, by_port, name, "port"))].name for name in wanted]
    else:
        chosen = [choose(path, ports, name, "port").name for name in wanted]
    logs = {_part(path, log): log for log in _logs(path)}
    streams = {name: _stream(logs[name]) for name in chosen}
    stream = joined(streams) if len(streams) > 1 else streams[chosen[0]]
    yield replace(stream, source=f"{path.name}/{', '.join(chosen)}")


def _logs(folder: Path) -> list[Path]:
    """Find the logs of a folder or a session, two folders deep at the most."""
    here = folder / _FILE
    if here.is_file():
        return [here]
    return sorted(log for depth in ("*", "*/*") for log in folder.glob(f"{depth}/{_FILE}"))


def _part(session: Path, log: Path) -> str:
    return log.parent.relative_to(session).as_posix()


def _port(log: Path) -> str:
    """Read from info.log which port was recorded; empty if it does not say."""
    try:
        with (log.parent / _INFO).open(encoding="utf-8", errors="replace") as stream:
            found = _PORT.search(stream.read(_INFO_CHARACTERS))
    except OSError:
        return ""
    return found[1] if found else ""


def _stream(log: Path) -> Stream:
    form = _table(log)
    n_stamps = 2 if _has_two_stamps(first_rows(form, _ROWS_LOOKED_AT)) else 1
    n_sensors = form.n_columns - 1 - n_stamps
    if n_sensors < 1:
        raise FileError(f"{log} holds sequence numbers and stamps, but no values after them")
    metadata: dict[str, Scalar] = {"format": "YARP data.log", "stamps": n_stamps}
    if port := _port(log):
        metadata["port"] = port
    return Stream(
        log,
        n_sensors,
        salvaged(_blocks(form, n_stamps), log, DAMAGED_GZIP),
        metadata=metadata,
        from_zero=True,
        locate=functools.partial(line_of, form),
    )


def _blocks(form: Table, n_stamps: int) -> Iterator[Block]:
    for values, share in read_blocks(form):
        receipts = values[:, 2] if n_stamps == 2 else None
        yield Block(narrowed(values[:, 1 + n_stamps :]), share, values[:, 1], receipts)


def _table(path: Path) -> Table:
    with opened_text(path) as stream:
        numbered = enumerate(stream, start=1)
        number, line = next(((i, text) for i, text in numbered if not is_skipped(text)), (0, ""))
    if not number:
        raise FileError(f"{path} holds no frame")
    width = len(_without_brackets(line).split())
    return Table(path, None, width, f"line {number} has {width}", number, clean=_without_brackets)


def _without_brackets(line: str) -> str:
    """Take brackets away where they match up; a line cut inside them stays unreadable."""
    return line.translate(_BRACKETS) if line.count("(") == line.count(")") else line


def _has_two_stamps(values: NDArray[np.float64]) -> bool:
    if values.shape[1] < 4:
        return False
    first, second = values[:, 1], values[:, 2]
    if (second >= _EPOCH).all():
        return True
    with np.errstate(invalid="ignore"):
        rising = len(values) >= _LOOKED_AT and (np.diff(second) > 0).all()
        return bool(rising and (np.abs(second - first) <= _SAME_CLOCK_S).all())
