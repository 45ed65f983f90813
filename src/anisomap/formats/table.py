"""Numbers in lines of text: read fast by numpy, and looked at closely where that fails."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.formats.source import opened_text, quoted, readable

_BLOCK_LINES = 512


class LineError(FileError):
    """A line that cannot be read.

    Parameters
    ----------
    path : pathlib.Path
        The file.
    line : int
        Counted from 1.
    problem : str
        What is wrong with it.
    """

    def __init__(self, path: Path, line: int, problem: str) -> None:
        super().__init__(f"{path}, line {line}{problem}")
        self.line = line


def _as_it_is(line: str) -> str:
    return line


@dataclass(frozen=True)
class Table:
    """How numbers stand in a file.

    Parameters
    ----------
    path : pathlib.Path
        The file, for messages.
    delimiter : str or None
        Between the fields of a line; None for any run of blanks.
    n_columns : int
        Fields that every line must have.
    because : str
        What says so, for messages: ``"the header names 3"``.
    first_line : int
        Line of the first numbers, counted from 1; what stands before is not looked at.
    names : tuple of str
        Names of the columns, for messages; empty if they have none.
    clean : callable
        Makes of a line one that has numbers and delimiters only; must keep the order of fields.
    """

    path: Path
    delimiter: str | None
    n_columns: int
    because: str
    first_line: int = 1
    names: tuple[str, ...] = ()
    clean: Callable[[str], str] = _as_it_is


def read_table(table: Table, *, before_line: int | None = None) -> NDArray[np.float64]:
    """Read lines of numbers.

    Comments from ``#`` to the end of a line and blank lines are passed over; an empty field is a
    missing number, NaN.

    Parameters
    ----------
    table : Table
        The file, and how its numbers are laid out.
    before_line : int, optional
        Read no further than to the line before this one.

    Returns
    -------
    ndarray of float64, shape (T, n_columns)

    Raises
    ------
    LineError
        At the first line with another number of fields, or a field that is no number.
    """
    blocks = [np.empty((0, table.n_columns))]
    first_line = table.first_line
    with opened_text(table.path) as stream:
        lines = itertools.islice(stream, first_line - 1, before_line and before_line - 1)
        while block := list(itertools.islice(lines, _BLOCK_LINES)):
            blocks.append(_fast(block, table, first_line))
            first_line += len(block)
    return np.concatenate(blocks)


def line_of(table: Table, row: int) -> str:
    """Tell on which line a row of `read_table` stands: ``"line 12"``."""
    with opened_text(table.path) as stream:
        lines = itertools.islice(enumerate(stream, start=1), table.first_line - 1, None)
        filled = (number for number, line in lines if not is_skipped(line, table.delimiter))
        return f"line {next(itertools.islice(filled, row, None))}"


def is_skipped(line: str, delimiter: str | None = None) -> bool:
    """Tell whether a line is blank, or a comment only.

    Tabs alone are no blank line where they are the delimiter, but missing readings.
    """
    content = line.partition("#")[0]
    return not content.strip() and not (delimiter == "\t" and "\t" in content)


def parse_number(field: str) -> float:
    """Read a number as numpy does: NaN for an empty field, and no underscores between digits.

    Raises
    ------
    ValueError
        If it is not one.
    """
    text = field.strip()
    if not text:
        return math.nan
    if "_" in text or not text.isascii():
        raise ValueError(text)
    return float(text)


def _fast(lines: list[str], table: Table, first_line: int) -> NDArray[np.float64]:
    cleaned = [table.clean(line) for line in lines] if table.clean is not _as_it_is else lines
    if all(map(is_skipped, cleaned)):
        return _careful(lines, table, first_line)
    try:
        block = np.loadtxt(
            cleaned, np.float64, comments="#", delimiter=table.delimiter, ndmin=2, quotechar='"'
        )
    except ValueError:
        return _careful(lines, table, first_line)
    # Lines that agree with each other may still disagree with those before.
    return block if block.shape[1] == table.n_columns else _careful(lines, table, first_line)


def _careful(lines: list[str], table: Table, first_line: int) -> NDArray[np.float64]:
    rows = [
        _row(line, table, number)
        for number, line in enumerate(lines, first_line)
        if not is_skipped(line, table.delimiter)
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, table.n_columns)


def _row(line: str, table: Table, number: int) -> list[float]:
    fields = _fields(table.clean(line), table.delimiter)
    if len(fields) != table.n_columns:
        raise LineError(
            table.path,
            number,
            f" has {len(fields)} field{'s' * (len(fields) != 1)}, but {table.because}",
        )
    values = []
    for column, field in enumerate(fields):
        try:
            values.append(parse_number(field))
        except ValueError:
            name = f" ({readable(table.names[column])})" if table.names else ""
            original = _fields(line, table.delimiter)[column].strip()
            problem = f", column {column + 1}{name}: {quoted(original)} is not a number"
            raise LineError(table.path, number, problem) from None
    return values


def _fields(line: str, delimiter: str | None) -> list[str]:
    content = line.partition("#")[0].strip("\r\n")
    if delimiter is None:
        return [field.strip('"') for field in content.split()]
    if '"' not in content:
        return content.split(delimiter)
    return next(csv.reader([content], delimiter=delimiter, skipinitialspace=True), [])
