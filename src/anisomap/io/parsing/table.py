"""Numbers in lines of text: read fast by numpy, and looked at closely where that fails."""

from __future__ import annotations

import csv
import itertools
import math
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, FileError
from anisomap.io.parsing.source import (
    DAMAGED_GZIP,
    opened_text,
    opened_with_share,
    quoted,
    readable,
)

_BLOCK_LINES, _BLOCK_CHARACTERS = 512, 1 << 22


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


def read_blocks(table: Table, *, aloud: bool = True) -> Iterator[tuple[NDArray[np.float64], float]]:
    """Read lines of numbers, some at a time.

    Comments from ``#`` to the end of a line and blank lines are passed over; an empty field is a
    missing number, NaN. A last line that was cut off is left out, with a warning.

    Parameters
    ----------
    table : Table
        The file, and how its numbers are laid out.
    aloud : bool
        Whether to warn of a last line that was cut off.

    Yields
    ------
    ndarray of float64, shape (t, n_columns)
        At least one row.
    float
        The share of the file that has been read.

    Raises
    ------
    LineError
        At the first line with another number of fields, or a field that is no number.
    EOFError, zlib.error, gzip.BadGzipFile
        If a gzipped file is damaged: all that is whole has come before.
    """
    first_line, n_rows = table.first_line, 0
    with opened_with_share(table.path) as text:
        lines = itertools.islice(text.lines, first_line - 1, None)
        for block, damage in _line_blocks(lines):
            rows = _all_but_a_cut_line(
                block, table, first_line, n_before=n_rows, later=lines, aloud=aloud
            )
            first_line, n_rows = first_line + len(block), n_rows + len(rows)
            if len(rows):
                yield rows, text.share()
            if damage:
                raise damage


def first_rows(table: Table, n_rows: int) -> NDArray[np.float64]:
    """Read as many rows, or all if there are fewer; of damage behind them nothing is said.

    Raises
    ------
    LineError
        As `read_blocks`.
    """
    held = [np.empty((0, table.n_columns))]
    with suppress(*DAMAGED_GZIP):
        for rows, _ in read_blocks(table, aloud=False):
            held.append(rows)
            if sum(map(len, held)) >= n_rows:
                break
    return np.concatenate(held)[:n_rows]


def _line_blocks(lines: Iterator[str]) -> Iterator[tuple[list[str], Exception | None]]:
    """Gather lines; what goes wrong with unpacking comes after the last lines that are whole."""
    block: list[str] = []
    characters = 0
    try:
        for line in lines:
            block.append(line)
            characters += len(line)
            if len(block) == _BLOCK_LINES or characters > _BLOCK_CHARACTERS:
                yield block, None
                block, characters = [], 0
    except DAMAGED_GZIP as error:
        yield block, error
    else:
        if block:
            yield block, None


def _all_but_a_cut_line(
    lines: list[str],
    table: Table,
    first_line: int,
    *,
    n_before: int,
    later: Iterator[str],
    aloud: bool,
) -> NDArray[np.float64]:
    """Read lines; a last one without an end, and with too little in it, was cut off."""
    try:
        return _fast(lines, table, first_line)
    except LineError as error:
        *whole, broken = lines
        is_last = error.line == first_line + len(whole) and next(later, None) is None
        n_fields = len(_fields(broken, table.delimiter))
        if not is_last or broken.endswith(("\n", "\r")) or n_fields > table.n_columns:
            raise
        rows = _fast(whole, table, first_line)
        if not n_before + len(rows):
            raise
        if aloud:
            warnings.warn(
                f"{table.path}: the last line ({error.line}) was cut off in field "
                f"{n_fields} of {table.n_columns}; its frame is lost, "
                f"the {n_before + len(rows)} frames before it are whole",
                AnisomapWarning,
                stacklevel=2,
            )
        return rows


def line_of(table: Table, row: int) -> str:
    """Tell on which line a row of `read_blocks` stands: ``"line 12"``."""
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
