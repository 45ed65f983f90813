"""Text logs of robot skins: logs by ``yarpdatadumper``, and by CySkin.

YARP writes ``sequence stamp value value ...`` to ``data.log`` in a folder per port; ``info.log``
contains the port. There may be two stamps, of the sender and of the receiver, and brackets.

The port ``skin_events`` of the iCub contains contacts instead of values, and is refused.

The recorder of CySkin writes a version and the number of taxels, and for each frame its number, its
time, and addresses with responses; the acquisition program writes the addresses once::

    1                                            17776 17777 17778
    3                                            0 0.600000 0 0 12
    0 26.82 3 38135 257 38136 223 38137 129      1 0.700000 0 1 10
"""

from __future__ import annotations

import functools
import itertools
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.files.paths import open_regular
from anisomap.io.parsing.source import GZIP_ERRORS, lines_of, open_text
from anisomap.io.parsing.tables import (
    LineError,
    Table,
    first_rows,
    is_skipped,
    line_of,
    read_blocks,
)
from anisomap.io.stream import (
    Block,
    Content,
    ReadOptions,
    Stream,
    choose,
    join_streams,
    refuse_selection,
    to_float32_if_exact,
)
from anisomap.recording import Scalar

_START = re.compile(r"\s*+(\d++)((?:\s++\d[\d.eE+-]*+){1,2})\s*+\(\(")
_STAMPED_ONLY = re.compile(r"[\d.eE+\-\s]*+(?:\(\s*+\)\s*+)?")
_MAX_STAMPED = 3
_BY_PYTHON = "ten lines of Python make readings of them, which docs/robots/icub.md explains"


def _is_contact_log(path: Path) -> bool:
    """Return whether the first line with any value in a log contains contacts."""
    with open_text(path) as stream, suppress(*GZIP_ERRORS):
        for line in stream:
            # A line may contain only a sequence number, two stamps and an empty list.
            n_numbers = len(line.partition("(")[0].split())
            without_value = _STAMPED_ONLY.fullmatch(line) and n_numbers <= _MAX_STAMPED
            if not is_skipped(line) and not without_value:
                return bool(_START.match(line))
    return False


_FILE, _INFO, _HERE = "data.log", "info.log", "."
# A line of a log of contacts ends after the stamp if nothing touched the skin.
_LINE = re.compile(rb"\s*+(\d++)\s++(\d++(?:\.\d*+)?(?:[eE][+-]?\d++)?)(?:\s++([-+.(\dni])|\s*+$)")
_CONNECTED = "[connected]"
_INFO_BYTES = 1 << 16
_LINES_LOOKED_AT, _ROWS_LOOKED_AT = 3, 1000
# Seconds since 1970, below the stamps of all recordings and above all readings.
_EPOCH = 1e8
_SAME_CLOCK_S = 60.0
_BRACKETS = str.maketrans("()", "  ")


def is_yarp(path: Path, head: bytes) -> bool:
    """Recognise a count, a stamp (which may start at 0 in a ``data.log``) and values."""
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
    """List the ports of a session; empty for a log."""
    logs = _logs(path)
    if _HERE in logs:
        return ()
    return tuple(Content(folder, _port(log) or "no info.log") for folder, log in logs.items())


@contextmanager
def open_yarp(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a data.log, its folder, or ports of a session.

    Times are the stamps of the sender, or of the receiver if the former do not increase.
    """
    wanted, logs = [name.strip() for name in options.select.split(",")], _logs(path)
    if log := logs.get(_HERE):
        source = f"{path.name}/{_FILE}" if path.is_dir() else path.name
        refuse_selection(log, options.select)
        yield replace(_stream(log), source=source)
        return
    ports, streams = contents(path, options), dict[str, Stream]()
    for name in wanted:
        named = [content for content in ports if content.summary == name]
        chosen = named[0] if len(named) == 1 else choose(path, ports, name, "port")
        streams[chosen.name] = _stream(logs[chosen.name])
    yield replace(join_streams(streams), source=f"{path.name}/{', '.join(streams)}")


def _logs(path: Path) -> dict[str, Path]:
    """Return a log, the log of a folder, or the logs of a session by folder, at most two deep."""
    here = path / _FILE if path.is_dir() else path
    if here.is_file():
        return {_HERE: here}
    deeper = sorted(log for depth in ("*", "*/*") for log in path.glob(f"{depth}/{_FILE}"))
    return {log.parent.relative_to(path).as_posix(): log for log in deeper}


def _port(log: Path) -> str:
    """Read the name of the port from info.log; empty if it is missing."""
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


def _stream(log: Path) -> Stream:
    """Create a stream of a log."""
    if _is_contact_log(log):
        raise FileError(f"{log} lists contacts (skin_events) instead of readings", _BY_PYTHON)
    table = _table(log)
    n_stamps = 2 if _has_two_stamps(first_rows(table, _ROWS_LOOKED_AT)) else 1
    n_sensors = table.n_columns - 1 - n_stamps
    if n_sensors < 1:
        raise FileError(f"{log} holds sequence numbers and stamps, but no values")
    metadata: dict[str, Scalar] = {"format": "YARP data.log", "stamps": n_stamps}
    if port := _port(log):
        metadata["port"] = port
    blocks, locate = _blocks(table, n_stamps), functools.partial(line_of, table)
    return Stream(log, n_sensors, blocks, metadata=metadata, from_zero=True, locate=locate)


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


_WHOLE = re.compile(r"\d{1,9}", re.ASCII)
_TIME = re.compile(r"\d{1,15}(?:\.\d{1,15})?(?:e[+-]?\d{1,2})?", re.ASCII)
_MIN_ADDRESSES = 2
# The acquisition program skips greater responses as errors of a sensor.
_FIRST_ERROR = 43_000


@dataclass(frozen=True)
class _Addresses:
    """The first line of frames, from 1, and the addresses; `repeated`: within each frame."""

    first_line: int
    addresses: tuple[str, ...]
    repeated: bool


def is_cyskin(path: Path, head: bytes) -> bool:
    """Recognise the addresses of taxels, once or in the first frame."""
    return _find_addresses([line.split() for line in lines_of(head)[:4]]) is not None


@contextmanager
def open_cyskin(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a recording of CySkin; the sensors are named by their addresses, and errors are NaN."""
    with open_text(path) as stream:
        start = [line.split() for _, line in zip(range(4), stream, strict=False)]
    layout = _find_addresses(start)
    if layout is None:
        raise FileError(f"{path} lacks the addresses of the taxels")
    per_sensor, fixed = (2, 3) if layout.repeated else (1, 2)
    n_columns = fixed + per_sensor * len(layout.addresses)
    because = f"{len(layout.addresses)} taxels need {n_columns}"
    table = Table(path, None, n_columns, because, layout.first_line)
    first_rows(table, 1)  # report a damaged first frame
    blocks, names = _cyskin_blocks(table, layout), layout.addresses
    found = Stream(path, len(names), blocks, names=names, source=path.name, from_zero=True)
    yield replace(found, metadata={"format": "CySkin"})


def _find_addresses(start: Sequence[Sequence[str]]) -> _Addresses | None:
    """Detect the layout from the fields of the first lines."""
    alone = [line for line in start if len(line) == 1 and _WHOLE.fullmatch(line[0])]
    frame = start[len(alone)] if len(alone) < len(start) else ()
    if start[: len(alone)] == alone and len(alone) in (1, 2) and len(frame) > 3:
        addresses = tuple(frame[3::2])
        whole = all(map(_WHOLE.fullmatch, (frame[0], frame[2], *addresses)))
        counted = whole and int(frame[2]) == len(addresses) and len(frame) == 3 + 2 * int(frame[2])
        if counted and int(alone[-1][0]) == len(addresses) and _TIME.fullmatch(frame[1]):
            return _Addresses(len(alone) + 1, addresses, repeated=True)
    if len(start) > 1 and len(start[0]) >= _MIN_ADDRESSES and len(start[1]) == len(start[0]) + 2:
        whole = all(map(_WHOLE.fullmatch, (*start[0], start[1][0])))
        if whole and _TIME.fullmatch(start[1][1]) and "." in start[1][1]:
            return _Addresses(2, tuple(start[0]), repeated=False)
    return None


def _cyskin_blocks(table: Table, layout: _Addresses) -> Iterator[Block]:
    expected = np.array(layout.addresses, dtype=np.float64)
    row = 0
    for values, fraction in read_blocks(table):
        if layout.repeated:
            changed = (values[:, 3::2] != expected).any(axis=1)
            if changed.any():
                where = line_of(table, row + int(np.argmax(changed))).removeprefix("line ")
                problem = " lists other addresses than the first frame"
                raise LineError(table.path, int(where), problem)
            responses = values[:, 4::2]
        else:
            responses = np.where(values[:, 2:] >= _FIRST_ERROR, np.nan, values[:, 2:])
        row += len(values)
        yield Block(to_float32_if_exact(responses), fraction, values[:, 1])
