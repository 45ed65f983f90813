"""Parse lines of numbers: fast with numpy, and line by line to locate errors."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.source import (
    GZIP_ERRORS,
    TextLines,
    open_text,
    quote,
    quote_if_needed,
    warn,
    warn_of_loss,
)

Item = TypeVar("Item")

# Limits memory for very wide tables; columns are told apart by at least eight rows.
_MIN_FIRST_ROWS, _MAX_FIRST_CELLS = 8, 1 << 22
_BLOCK_LINES, _BLOCK_CHARACTERS = 512, 1 << 22


class LineError(FileError):
    """A line that cannot be parsed.

    line: From 1.
    problem: Rest of the message.
    """

    def __init__(self, path: Path, line: int, problem: str) -> None:
        super().__init__(f"{path}, line {line}{problem}")
        self.line = line


def read_undamaged(
    path: Path, parse: Callable[[TextLines], Iterator[Item]], noun: str
) -> Iterator[Item]:
    """Yield what is parsed from the lines of a file before any damage, and warn about the rest.

    A truncated last line is dropped with a warning.
    """
    n_read = 0
    with open_text(path) as lines:
        try:
            for item in parse(lines):
                yield item
                n_read += 1
        except (LineError, csv.Error):
            whole = lines.last.endswith(("\n", "\r"))
            if not n_read or whole or next(lines, None) is not None:
                raise
            problem = "the last line is truncated and dropped"
            warn(path, f"{problem}; read the {n_read} {noun} before it")
        except GZIP_ERRORS as error:
            if not n_read:
                raise
            warn_of_loss(path, error, f"{n_read} {noun}", lines.fraction())


@dataclass(frozen=True)
class Table:
    """Layout of the numbers in a text file.

    delimiter: Field separator; None for any run of white space.
    n_columns: Required number of fields per line.
    because: Reason for `n_columns` in messages, such as ``"the header names 3"``.
    first_line: First line of numbers, from 1; earlier lines are skipped.
    names: Column names, for messages; empty without a header.
    clean: Converts a line to numbers and delimiters; must keep the order of fields.
    text_columns: Columns of text, which are read as NaN.
    """

    path: Path
    delimiter: str | None
    n_columns: int
    because: str
    first_line: int = 1
    names: tuple[str, ...] = ()
    clean: Callable[[str], str] | None = None
    text_columns: tuple[int, ...] = ()


def read_blocks(
    table: Table, *, quietly: bool = False
) -> Iterator[tuple[NDArray[np.float64], float]]:
    """Read lines of numbers in blocks, each with the fraction of the file read so far.

    Blank lines and comments, from ``#`` to the end of the line, are skipped; an empty field is
    NaN. A truncated last line and what is behind damage are dropped with a warning, or `quietly`.
    """
    first_line, n_rows = table.first_line, 0
    with open_text(table.path) as text:
        lines = itertools.islice(text, first_line - 1, None)
        try:
            for block, damage in _line_blocks(lines):
                rows, problem = _parse_whole_lines(block, table, first_line, n_rows, lines)
                first_line, n_rows = first_line + len(block), n_rows + len(rows)
                if problem and not quietly:
                    warn(table.path, problem)
                if len(rows):
                    yield rows, text.fraction()
                if damage:
                    raise damage
        except GZIP_ERRORS as error:
            if not n_rows and not quietly:
                raise
            if not quietly:
                warn_of_loss(table.path, error, f"{n_rows} frames", text.fraction())


def first_rows(table: Table, n_rows: int) -> NDArray[np.float64]:
    """Read the first `n_rows` rows, or all if there are fewer, ignoring damage after them.

    Of tables with thousands of columns, fewer rows are read.
    """
    n_rows = min(n_rows, max(_MIN_FIRST_ROWS, _MAX_FIRST_CELLS // max(table.n_columns, 1)))
    held = [np.empty((0, table.n_columns))]
    for rows, _ in read_blocks(table, quietly=True):
        held.append(rows)
        if sum(map(len, held)) >= n_rows:
            break
    return np.concatenate(held)[:n_rows]


def _line_blocks(lines: Iterator[str]) -> Iterator[tuple[list[str], Exception | None]]:
    """Group lines into blocks, each with the decompression error that follows it, if any."""
    block: list[str] = []
    characters = 0
    try:
        for line in lines:
            block.append(line)
            characters += len(line)
            if len(block) == _BLOCK_LINES or characters > _BLOCK_CHARACTERS:
                yield block, None
                block, characters = [], 0
    except GZIP_ERRORS as error:
        yield block, error
    else:
        if block:
            yield block, None


def _parse_whole_lines(
    lines: list[str], table: Table, first_line: int, n_before: int, later: Iterator[str]
) -> tuple[NDArray[np.float64], str]:
    """Parse lines without an incomplete last line of the file, which a message tells of."""
    try:
        return _parse_fast(lines, table, first_line), ""
    except LineError as error:
        *whole, broken = lines
        is_last = error.line == first_line + len(whole) and next(later, None) is None
        n_fields = len(_fields(broken, table.delimiter))
        if not is_last or broken.endswith(("\n", "\r")) or n_fields > table.n_columns:
            raise
        rows = _parse_fast(whole, table, first_line)
        if not n_before + len(rows):
            raise
        return rows, (
            f"the last line ({error.line}) is truncated in field {n_fields} of "
            f"{table.n_columns} and dropped; read the {n_before + len(rows)} frames before it"
        )


def line_of(table: Table, row: int) -> str:
    """Return the line of a row of `read_blocks`: ``"line 12"``."""
    with open_text(table.path) as stream:
        lines = itertools.islice(enumerate(stream, start=1), table.first_line - 1, None)
        filled = (number for number, line in lines if not is_skipped(line, table.delimiter))
        return f"line {next(itertools.islice(filled, row, None))}"


def is_skipped(line: str, delimiter: str | None = None) -> bool:
    """Return whether a line is blank or a comment.

    If the delimiter is a tab, a line of tabs is a row of missing readings.
    """
    content = line.partition("#")[0]
    return not content.strip() and not (delimiter == "\t" and "\t" in content)


def parse_number(field: str, delimiter: str | None = ",") -> float:
    """Parse a number as numpy does: no underscores, and NaN for an empty field.

    It may have a decimal comma unless commas separate the fields.
    """
    text = (field if delimiter == "," else field.replace(",", ".")).strip()
    if not text:
        return math.nan
    if "_" in text or not text.isascii():
        raise ValueError(text)
    return float(text)


def parse_row(
    path: Path, line: int, fields: Sequence[str], columns: Mapping[int, str]
) -> list[float]:
    """Parse some columns of a line; their names are for messages."""
    values = []
    for column, name in columns.items():
        try:
            values.append(parse_number(fields[column]))
        except ValueError:
            label = f" ({name})" if name else ""
            problem = f", column {column + 1}{label}: {quote(fields[column])} is not a number"
            raise LineError(path, line, problem) from None
    return values


def is_number(field: str, delimiter: str | None = ",") -> bool:
    """Return whether `parse_number` accepts a field."""
    try:
        parse_number(field, delimiter)
    except ValueError:
        return False
    return True


def _text_to_nan(field: str) -> float:
    """Convert a field of a text column to NaN; raise ValueError for a number."""
    if field.strip() and is_number(field):
        raise ValueError(field)
    return math.nan


def _parse_fast(lines: list[str], table: Table, first_line: int) -> NDArray[np.float64]:
    cleaned = list(map(table.clean, lines)) if table.clean else lines
    if all(map(is_skipped, cleaned)):
        return _parse_lines(lines, table, first_line)
    try:
        block = np.loadtxt(
            cleaned,
            np.float64,
            comments="#",
            delimiter=table.delimiter,
            converters=dict.fromkeys(table.text_columns, _text_to_nan) or None,
            ndmin=2,
            quotechar='"',
        )
    except ValueError:
        return _parse_lines(lines, table, first_line)
    # np.loadtxt compares the widths of lines only within the block.
    return block if block.shape[1] == table.n_columns else _parse_lines(lines, table, first_line)


def _parse_lines(lines: list[str], table: Table, first_line: int) -> NDArray[np.float64]:
    rows = [
        _row(line, table, number)
        for number, line in enumerate(lines, first_line)
        if not is_skipped(line, table.delimiter)
    ]
    return np.array(rows, dtype=np.float64).reshape(-1, table.n_columns)


def _row(line: str, table: Table, number: int) -> list[float]:
    fields = _fields(table.clean(line) if table.clean else line, table.delimiter)
    if len(fields) != table.n_columns:
        raise LineError(
            table.path,
            number,
            f" has {len(fields)} field{'s' * (len(fields) != 1)}, but {table.because}",
        )
    values = []
    for column, field in enumerate(fields):
        is_text = column in table.text_columns
        try:
            values.append(_text_to_nan(field) if is_text else parse_number(field))
        except ValueError:
            name = f" ({quote_if_needed(table.names[column])})" if table.names else ""
            # Cleaning a line may change the number of its fields, such as that of "(1 2),3".
            originals = _fields(line, table.delimiter)
            original = (originals if len(originals) == len(fields) else fields)[column].strip()
            problem = "is a number in a column of text" if is_text else "is not a number"
            raise LineError(
                table.path, number, f", column {column + 1}{name}: {quote(original)} {problem}"
            ) from None
    return values


def _fields(line: str, delimiter: str | None) -> list[str]:
    content = line.partition("#")[0].strip("\r\n")
    if delimiter is None:
        return [field.strip('"') for field in content.split()]
    if '"' not in content:
        return content.split(delimiter)
    return next(csv.reader([content], delimiter=delimiter, skipinitialspace=True), [])
