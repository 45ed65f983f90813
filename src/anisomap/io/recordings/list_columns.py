"""Delimited text with a column of lists: all readings of a frame in one quoted cell.

For example, with two mats of six cells::

    Timestamp,left,right
    0.1,"0,0,3,4,0,0","0,1,3,4,0,0"
"""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from anisomap.io.choice import Content
from anisomap.io.parsing import delimited
from anisomap.io.parsing.columns import Roles
from anisomap.io.parsing.frames import to_float32_if_exact
from anisomap.io.parsing.source import GZIP_ERRORS, open_text_with_progress, quote
from anisomap.io.parsing.table import LineError, Lines, Table, parse_number
from anisomap.io.stream import BLOCK_BYTES, Block, Stream, salvage

_ROWS_LOOKED_AT = 50
# A cell of two numbers with a comma may be one number with a decimal comma.
_MIN_LENGTH, _MIN_ROWS = 3, 2
_BETWEEN = re.compile(r"[\s,;\[\]()]+")


@dataclass(frozen=True)
class ListColumn:
    """A column of lists.

    Parameters
    ----------
    column : int
        From 0.
    length : int
        Number of readings per list.
    """

    column: int
    length: int


def find_list_columns(sample: Sequence[str], layout: delimited.Layout) -> dict[str, ListColumn]:
    """Find the columns with lists of equal length in all rows.

    Parameters
    ----------
    sample : sequence of str
        The first lines of the table.
    layout : anisomap.io.parsing.delimited.Layout

    Returns
    -------
    dict of str to ListColumn
        By name; columns without a header are numbered from 1.
    """
    try:
        found = delimited.records(sample, layout.delimiter)
        rows = [fields for _, fields in itertools.islice(found, _ROWS_LOOKED_AT)]
    except csv.Error:
        return {}
    rows = rows[1:] if layout.header else rows
    lists = {}
    for column in range(min(map(len, rows), default=0)):
        lengths = {_length(row[column]) for row in rows}
        if len(rows) >= _MIN_ROWS and len(lengths) == 1 and (length := lengths.pop()):
            named = layout.header[column].strip() if column < len(layout.header) else ""
            lists[named or str(column + 1)] = ListColumn(column, length)
    return lists


def contents_of_lists(lists: Mapping[str, ListColumn]) -> tuple[Content, ...]:
    """List the columns for display."""
    return tuple(
        Content(name, f"lists of {column.length} numbers") for name, column in lists.items()
    )


def stream_lists(table: Table, chosen: ListColumn, roles: Roles, *, preamble: int) -> Stream:
    """Create a stream of the lists of a column.

    Parameters
    ----------
    table : Table
    chosen : ListColumn
    roles : Roles
        `time` gives the column of times.
    preamble : int
        Number of lines above the table.

    Returns
    -------
    Stream
        Without names of sensors.
    """
    named = chosen.column < len(table.names)
    name = table.names[chosen.column].strip() if named else str(chosen.column + 1)
    return Stream(
        table.path,
        chosen.length,
        salvage(_blocks(table, chosen, roles, preamble), table.path, GZIP_ERRORS),
        source=f"{table.path.name}:{name}",
        metadata={"format": "delimited text, lists", "column": name},
        from_zero=True,
    )


def _length(cell: str) -> int:
    """Return the length of a list of numbers; 0 for anything else."""
    fields = _fields(cell)
    try:
        for field in fields:
            parse_number(field)
    except ValueError:
        return 0
    return len(fields) if len(fields) >= _MIN_LENGTH else 0


def _fields(cell: str) -> list[str]:
    return [field for field in _BETWEEN.split(cell) if field]


def _blocks(table: Table, chosen: ListColumn, roles: Roles, preamble: int) -> Iterator[Block]:
    step = max(1, BLOCK_BYTES // (8 * chosen.length))
    with open_text_with_progress(table.path) as text:
        lines = Lines(table.path, itertools.islice(text.lines, preamble, None))
        rows = _rows(table, chosen, roles, lines, preamble)
        damage: Exception | None = None
        while not damage:
            frames: list[tuple[NDArray[np.float64], float]] = []
            try:
                frames.extend(itertools.islice(rows, step))
            except GZIP_ERRORS as error:
                damage = error
            if frames:
                readings = to_float32_if_exact(np.array([values for values, _ in frames]))
                times = np.array([time for _, time in frames]) / roles.per_second
                yield Block(readings, text.fraction(), None if roles.time is None else times)
            elif not damage:
                return
        raise damage


def _rows(
    table: Table, chosen: ListColumn, roles: Roles, lines: Lines, preamble: int
) -> Iterator[tuple[NDArray[np.float64], float]]:
    n_read = 0
    try:
        records = delimited.records(lines, table.delimiter)
        for line, fields in itertools.islice(records, 1 if table.names else 0, None):
            yield _row(table, chosen, roles, preamble + line, fields)
            n_read += 1
    except (LineError, csv.Error) as error:
        lines.end_early(error, n_read, "frames")


def _row(
    table: Table, chosen: ListColumn, roles: Roles, line: int, fields: Sequence[str]
) -> tuple[NDArray[np.float64], float]:
    unnamed = bool(table.names) and chosen.column >= len(table.names)
    if unnamed or len(fields) <= max(chosen.column, roles.time or 0):
        raise LineError(table.path, line, f" has {len(fields)} fields, but {table.because}")
    values = _fields(fields[chosen.column])
    if len(values) != chosen.length:
        problem = f", column {chosen.column + 1}: the list has {len(values)} numbers"
        raise LineError(table.path, line, f"{problem}; the lists before have {chosen.length}")
    try:
        readings = np.array([parse_number(value) for value in values])
        return readings, 0.0 if roles.time is None else parse_number(fields[roles.time])
    except ValueError as error:
        problem = f": {quote(str(error))} is not a number"
        raise LineError(table.path, line, problem) from None
