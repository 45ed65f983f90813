"""Recordings of ``yarpdatadumper``: ``data.log``, its folder, or a session of folders.

A line is ``sequence stamp value value ...``. With ``--txTime --rxTime`` it has two stamps, the
sender's and the receiver's. The values may be in brackets. ``info.log`` in the same folder names
the port. A session is a folder with one folder per port. For contacts instead of values, see
`anisomap.io.events.skin_events`.
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.files import open_regular
from anisomap.io.choice import Content, choose
from anisomap.io.events import skin_events
from anisomap.io.joining import join_streams
from anisomap.io.parsing.frames import to_float32_if_exact
from anisomap.io.parsing.source import GZIP_ERRORS, open_text
from anisomap.io.parsing.table import Table, first_rows, is_skipped, line_of, read_blocks
from anisomap.io.stream import Block, ReadOptions, Stream, salvage
from anisomap.recording import Scalar

_FILE, _INFO = "data.log", "info.log"
# A line of a log of contacts ends after the stamp if nothing touched the skin.
_LINE = re.compile(rb"\s*+(\d++)\s++(\d++(?:\.\d*+)?(?:[eE][+-]?\d++)?)(?:\s++([-+.(\dni])|\s*+$)")
_CONNECTED = "[connected]"
_INFO_BYTES = 1 << 16
_LINES_LOOKED_AT, _ROWS_LOOKED_AT = 3, 1000
# Seconds since 1970: below the stamps of any recording, above any reading.
_EPOCH = 1e8
_SAME_CLOCK_S = 60.0
_BRACKETS = str.maketrans("()", "  ")


def recognises(path: Path, head: bytes) -> bool:
    """Recognise a log by an increasing count, a non-decreasing stamp, and values.

    A log of a simulator, with stamps from 0, must also have the name ``data.log``.
    """
    if path.is_dir():
        return bool(_logs(path))
    lines = head.splitlines()
    whole = lines[:-1] or lines  # the last line may be incomplete
    found = [match for line in whole[:_LINES_LOOKED_AT] if (match := _LINE.match(line))]
    if not found or len(found) < len(whole[:_LINES_LOOKED_AT]):
        return False
    if not any(match[3] for match in found) and b"((" not in head and path.name != _FILE:
        return False
    counts = [float(match[1]) for match in found]
    stamps = [float(match[2]) for match in found]
    rising = all(a < b for a, b in itertools.pairwise(counts))
    return rising and stamps == sorted(stamps) and (stamps[0] >= _EPOCH or path.name == _FILE)


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the ports of a session, or the skin parts of a log of contacts; empty for readings."""
    if log := _single(path):
        return skin_events.contents_of_log(log) if skin_events.is_contact_log(log) else ()
    return tuple(Content(_part(path, log), _port(log) or "no info.log") for log in _logs(path))


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a data.log, its folder, or one or several ports of a session.

    `options.select` names the port of a session, or the skin part of a log of contacts; several,
    separated by commas, are joined, ports at the times of the first. Times are the sender's stamps
    from 0, or the receiver's if the sender's do not increase. A truncated last line is dropped with
    a warning.
    """
    wanted = [name.strip() for name in options.select.split(",")]
    if log := _single(path):
        source = f"{path.name}/{_FILE}" if path.is_dir() else path.name
        yield replace(_stream(log, options.bin_s, wanted), source=source)
        return
    ports = contents(path, options)
    by_port = tuple(replace(content, name=content.summary) for content in ports)
    if all(any(port.name == name for port in by_port) for name in wanted):
        chosen = [ports[by_port.index(choose(path, by_port, name, "port"))].name for name in wanted]
    else:
        chosen = [choose(path, ports, name, "port").name for name in wanted]
    logs = {_part(path, log): log for log in _logs(path)}
    streams = {name: _stream(logs[name], options.bin_s) for name in chosen}
    stream = join_streams(streams) if len(streams) > 1 else streams[chosen[0]]
    yield replace(stream, source=f"{path.name}/{', '.join(chosen)}")


def _logs(folder: Path) -> list[Path]:
    """Find the logs of a folder or a session, at most two folders deep."""
    here = folder / _FILE
    if here.is_file():
        return [here]
    return sorted(log for depth in ("*", "*/*") for log in folder.glob(f"{depth}/{_FILE}"))


def _part(session: Path, log: Path) -> str:
    return log.parent.relative_to(session).as_posix()


def _port(log: Path) -> str:
    """Read the name of the port from info.log; empty if it is not there."""
    try:
        with open_regular(log.parent / _INFO) as stream:
            lines = stream.read(_INFO_BYTES).decode("utf-8", "replace").splitlines()
    except FileError:
        return ""
    for line in lines:
        before, found, _ = line.partition(_CONNECTED)
        port = before.rpartition("]")[2].strip()
        if found and port.startswith("/"):
            return port
    return ""


def _single(path: Path) -> Path | None:
    """Return the log of a file or folder; None for a session."""
    if not path.is_dir():
        return path
    return path / _FILE if (path / _FILE).is_file() else None


def _stream(log: Path, bin_s: float | None, parts: Sequence[str] = ()) -> Stream:
    """Create a stream of a log; `parts` selects the skin parts of contacts, all by default."""
    if skin_events.is_contact_log(log):
        found = skin_events.contents_of_log(log)
        names = [choose(log, found, part, "skin part").name for part in parts]
        return skin_events.stream_contacts(log, names or [each.name for each in found], bin_s)
    table = _table(log)
    n_stamps = 2 if _has_two_stamps(first_rows(table, _ROWS_LOOKED_AT)) else 1
    n_sensors = table.n_columns - 1 - n_stamps
    if n_sensors < 1:
        raise FileError(f"{log} holds sequence numbers and stamps, but no values")
    metadata: dict[str, Scalar] = {"format": "YARP data.log", "stamps": n_stamps}
    if port := _port(log):
        metadata["port"] = port
    return Stream(
        log,
        n_sensors,
        salvage(_blocks(table, n_stamps), log, GZIP_ERRORS),
        metadata=metadata,
        from_zero=True,
        locate=functools.partial(line_of, table),
    )


def _blocks(table: Table, n_stamps: int) -> Iterator[Block]:
    for values, fraction in read_blocks(table):
        receive_times = values[:, 2] if n_stamps == 2 else None
        readings = to_float32_if_exact(values[:, 1 + n_stamps :])
        yield Block(readings, fraction, values[:, 1], receive_times)


def _table(path: Path) -> Table:
    with open_text(path) as stream:
        numbered = enumerate(stream, start=1)
        number, line = next(((i, text) for i, text in numbered if not is_skipped(text)), (0, ""))
    if not number:
        raise FileError(f"{path} has no frame")
    width = len(_without_brackets(line).split())
    return Table(path, None, width, f"line {number} has {width}", number, clean=_without_brackets)


def _without_brackets(line: str) -> str:
    """Replace balanced brackets by blanks, so that a line truncated inside them stays invalid."""
    return line.translate(_BRACKETS) if line.count("(") == line.count(")") else line


def _has_two_stamps(values: NDArray[np.float64]) -> bool:
    if values.shape[1] < 4:
        return False
    first, second = values[:, 1], values[:, 2]
    if (second >= _EPOCH).all():
        return True
    with np.errstate(invalid="ignore"):
        rising = len(values) >= _LINES_LOOKED_AT and (np.diff(second) > 0).all()
        return bool(rising and (np.abs(second - first) <= _SAME_CLOCK_S).all())
