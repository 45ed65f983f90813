"""Recordings as delimited text: CSV, TSV, or columns between blanks; gzipped or not.

A line is a frame, a column a sensor. What may differ from file to file (delimiter, decimal comma,
header, time column, frame counter) is found out: see `delimited` and `columns`.
"""

from __future__ import annotations

import csv
import dataclasses
import functools
import itertools
import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from anisomap.errors import AnisomapWarning, FileError
from anisomap.io.parsing import comments, delimited
from anisomap.io.parsing.columns import ROWS_LOOKED_AT, Roles, roles_by_content, roles_by_name
from anisomap.io.parsing.frames import narrowed
from anisomap.io.parsing.source import DAMAGED_GZIP, opened_text
from anisomap.io.parsing.table import Table, first_rows, line_of, read_blocks
from anisomap.io.stream import Block, ReadOptions, Stream, salvaged
from anisomap.recording import Recording, Scalar

TITLE = "anisomap recording"
MAP_TITLE = "anisomap map"
"""First words of our own files, after ``#``."""

_TIME_COLUMN = "time_s"
_DELIMITERS = {"separated by commas": ",", "separated by tabs": "\t"}
_IN_FIRST_COLUMN, _NO_TIMES = "first column, seconds", "none"
_logger = logging.getLogger(__name__)


def recognises(path: Path, head: bytes) -> bool:
    """Tell whether a file is text at all; asked last, after every format with a mark of its own."""
    return bool(head) and b"\0" not in head


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a recording in delimited text.

    Parameters
    ----------
    path : pathlib.Path
        A line a frame, a column a sensor; empty fields are missing readings, NaN.
    options : ReadOptions
        None of them matters here.

    Yields
    ------
    Stream
        Its metadata says which column was taken for time, and which for a frame counter.

    Raises
    ------
    FileError
        With line and column of what cannot be read.
    """
    with opened_text(path) as stream:
        sample = delimited.take_sample(stream)
    if _is_titled(sample, MAP_TITLE):
        raise FileError(f"{path} is a map, not a recording; read it with read_map")
    known, metadata = _own_comments(sample)
    above = 0 if known else delimited.lines_above(sample)
    layout = delimited.find_layout(
        sample[above:], own_delimiter=_DELIMITERS.get(str(known.get("fields")), "")
    )
    if not layout.n_columns:
        held = "a header and nothing below it" if layout.header else "no line of numbers"
        raise FileError(f"{path} holds {held}; give a line of numbers for every frame")
    form = _table(path, layout, sample, above)
    names = layout.header if known else tuple(name.strip() for name in layout.header)
    roles = _own_roles(known) if known else _foreign_roles(form, names)
    if len(roles.left_out) == layout.n_columns:
        raise FileError(f"{path} holds times or a frame counter, but no sensor beside them")
    rate_hz = known.get("rate_hz")
    yield Stream(
        path,
        layout.n_columns - len(roles.left_out),
        salvaged(_blocks(form, roles), path, DAMAGED_GZIP),
        names=tuple(name for i, name in enumerate(names) if i not in roles.left_out),
        rate_hz=float(rate_hz) if isinstance(rate_hz, int | float) else None,
        source=str(known.get("source", path.name)),
        metadata=metadata if known else _remarks(path, names, roles),
        locate=None if known else functools.partial(line_of, form),
    )


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording as text: comments, names, and a line a frame.

    Times are the first column, in seconds. Positions are not part of the format: a warning says so.

    Parameters
    ----------
    recording : Recording
        What to write; reading it back gives the same readings, names, times, rate and metadata.
    path : pathlib.Path
        Fields are separated by tabs if it ends in ``.tsv``, else by commas.
    """
    delimiter = "\t" if path.suffix.lower() == ".tsv" else ","
    if recording.positions is not None:
        warnings.warn(
            f"{path.suffix} holds no positions, so those of the recording are not written; "
            "write .npz to keep them",
            AnisomapWarning,
            stacklevel=2,
        )
    fields = next(name for name, mark in _DELIMITERS.items() if mark == delimiter)
    entries: list[tuple[str, Scalar]] = [
        ("fields", fields),
        ("source", recording.source),
        ("times", _NO_TIMES if recording.times is None else _IN_FIRST_COLUMN),
    ]
    if recording.rate_hz is not None:
        entries.append(("rate_hz", recording.rate_hz))
    names = (_TIME_COLUMN, *recording.names) if recording.times is not None else recording.names
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(comments.write_comments(TITLE, entries, "metadata", recording.metadata))
        csv.writer(
            stream, delimiter=delimiter, quoting=csv.QUOTE_ALL, lineterminator="\n"
        ).writerow(names)
        for frame, readings in enumerate(recording.readings):
            values = readings.tolist()
            if recording.times is not None:
                values.insert(0, float(recording.times[frame]))
            stream.write(delimiter.join(map(repr, values)) + "\n")


def _is_titled(sample: list[str], title: str) -> bool:
    return bool(sample) and sample[0].startswith(f"# {title}")


def _own_comments(sample: list[str]) -> tuple[dict[str, Scalar], dict[str, Scalar]]:
    """Give what the comments of a file of our own say, and its metadata; nothing of another."""
    if not _is_titled(sample, TITLE):
        return {}, {}
    leading = itertools.takewhile(lambda line: line.startswith("#"), sample)
    entries, metadata = comments.read_comments(leading, "metadata")
    return dict(entries), metadata


def _table(path: Path, layout: delimited.Layout, sample: list[str], above: int) -> Table:
    if layout.header:
        because = f"the header names {layout.n_columns}"
    else:
        first = next(delimited.records(sample[above:], layout.delimiter))[0]
        because = f"line {above + first} has {layout.n_columns}"
    form = Table(
        path, layout.delimiter, layout.n_columns, because, above + layout.first_line, layout.header
    )
    untouched = layout.delimiter == "," and not layout.trailing
    return form if untouched else dataclasses.replace(form, clean=layout.clean)


def _own_roles(known: dict[str, Scalar]) -> Roles:
    timed = known.get("times") == _IN_FIRST_COLUMN
    return Roles(time=0, left_out=(0,)) if timed else Roles()


def _foreign_roles(form: Table, names: tuple[str, ...]) -> Roles:
    start = first_rows(form, ROWS_LOOKED_AT)
    return roles_by_name(names, start) if names else roles_by_content(start)


def _blocks(form: Table, roles: Roles) -> Iterator[Block]:
    for values, share in read_blocks(form):
        times = None if roles.time is None else values[:, roles.time] / roles.per_second
        yield Block(narrowed(np.delete(values, roles.left_out, axis=1)), share, times)


def _remarks(path: Path, names: tuple[str, ...], roles: Roles) -> dict[str, Scalar]:
    """Say which columns were not taken for sensors: in the metadata, and in the log."""
    remarks: dict[str, Scalar] = {}
    for key, column in (("time_column", roles.time), ("counter_column", roles.counter)):
        if column is None:
            continue
        name = names[column] if names else "no header"
        remarks[key] = f"column {column + 1} ({name})"
        _logger.info("%s: %s is %s, no sensor", path, remarks[key], key.replace("_", " "))
    return remarks
