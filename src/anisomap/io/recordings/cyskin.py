"""Text recordings of CySkin, with the addresses of the taxels in the file.

The recorder of robotskinlib writes a version, the number of taxels, and per frame the addresses
beside the responses::

    1
    3
    0 26.82 3 38135 257 38136 223 38137 129
    1 26.92 3 38135 199 38136 106 38137 270

The acquisition program writes the addresses once, above the frames::

    17776 17777 17778
    0 0.600000 0 0 12
    1 0.700000 0 1 10

A frame begins with its number and its time in seconds.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from anisomap.errors import FileError
from anisomap.io.parsing.source import open_text
from anisomap.io.parsing.table import LineError, Table, first_rows, line_of, read_blocks
from anisomap.io.stream import Block, ReadOptions, Stream, to_float32_if_exact

_WHOLE = re.compile(r"\d{1,9}")
_TIME = re.compile(r"\d{1,15}(?:\.\d{1,15})?(?:e[+-]?\d{1,2})?")
_MIN_ADDRESSES = 2
# The acquisition program skips responses from here on as errors of a sensor.
_FIRST_ERROR = 43_000


@dataclass(frozen=True)
class _Layout:
    """The first line of frames, from 1, and the addresses; inside the frames if `repeated`."""

    first_line: int
    addresses: tuple[str, ...]
    repeated: bool


def recognises(path: Path, head: bytes) -> bool:
    """Recognise the addresses of taxels, once or in the first frame."""
    if b"\0" in head:
        return False
    # Bytes that are not text become marks, which are no numbers.
    lines = head.decode("ascii", "replace").splitlines()
    return _find_layout([line.split() for line in lines[:4]]) is not None


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a recording of CySkin; the sensors are named by their addresses.

    Responses that the acquisition program marks as errors are NaN.
    """
    with open_text(path) as stream:
        start = [line.split() for _, line in zip(range(4), stream, strict=False)]
    layout = _find_layout(start)
    if layout is None:
        raise FileError(f"{path} lacks the addresses of the taxels")
    per_sensor, fixed = (2, 3) if layout.repeated else (1, 2)
    n_columns = fixed + per_sensor * len(layout.addresses)
    because = f"{len(layout.addresses)} taxels need {n_columns}"
    table = Table(path, None, n_columns, because, layout.first_line)
    first_rows(table, 1)  # report a damaged first frame
    yield Stream(
        path,
        len(layout.addresses),
        _blocks(table, layout),
        names=layout.addresses,
        source=path.name,
        metadata={"format": "CySkin"},
        from_zero=True,
    )


def _find_layout(start: Sequence[Sequence[str]]) -> _Layout | None:
    """Detect the layout from the fields of the first lines."""
    alone = [line for line in start if len(line) == 1 and _WHOLE.fullmatch(line[0])]
    frame = start[len(alone)] if len(alone) < len(start) else ()
    if start[: len(alone)] == alone and len(alone) in (1, 2) and len(frame) > 3:
        addresses = tuple(frame[3::2])
        whole = all(map(_WHOLE.fullmatch, (frame[0], frame[2], *addresses)))
        counted = whole and int(frame[2]) == len(addresses) and len(frame) == 3 + 2 * int(frame[2])
        if counted and int(alone[-1][0]) == len(addresses) and _TIME.fullmatch(frame[1]):
            return _Layout(len(alone) + 1, addresses, repeated=True)
    if len(start) > 1 and len(start[0]) >= _MIN_ADDRESSES and len(start[1]) == len(start[0]) + 2:
        whole = all(map(_WHOLE.fullmatch, (*start[0], start[1][0])))
        if whole and _TIME.fullmatch(start[1][1]) and "." in start[1][1]:
            return _Layout(2, tuple(start[0]), repeated=False)
    return None


def _blocks(table: Table, layout: _Layout) -> Iterator[Block]:
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
