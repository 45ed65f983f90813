"""Delimited text: its records, its delimiter, and whether it has a header."""

from __future__ import annotations

import csv
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TextIO

from anisomap.io.parsing.source import DAMAGED_GZIP
from anisomap.io.parsing.table import is_skipped, parse_number

Record = tuple[int, list[str]]
"""The line on which a record begins, counted from 1, and its fields."""

_SAMPLE_LINES, _SAMPLE_CHARACTERS = 1000, 1 << 22
_SAMPLE_RECORDS = 50
# A semicolon or a tab is hardly ever part of a number or a name, a comma may be a decimal one.
_DELIMITERS = (";", "\t", ",", None)
_BLANK_SEPARATED = re.compile(r'"((?:[^"]|"")*)"|(\S+)')
_FEWEST_COUNTED = 4
_LINES_ABOVE, _ROWS_BEYOND_DOUBT = 100, 5


@dataclass(frozen=True)
class Layout:
    """How a delimited file of numbers is laid out.

    Parameters
    ----------
    delimiter : str or None
        Between fields; None for any run of blanks.
    header : tuple of str
        Names of the columns; empty if the file has none.
    n_columns : int
        Number of columns, 0 if there is no line of numbers.
    trailing : int
        How many delimiters end every line with nothing between or after them.
    first_line : int
        The line after the header, counted from 1; 1 without a header.
    """

    delimiter: str | None
    header: tuple[str, ...]
    n_columns: int
    trailing: int
    first_line: int

    def clean(self, line: str) -> str:
        """Make decimal points of decimal commas, and drop empty fields at the end."""
        if self.delimiter != ",":
            line = line.replace(",", ".")
        for _ in range(self.trailing):
            line = line.rstrip(" \r\n").removesuffix(self.delimiter or "")
        return line


def take_sample(stream: TextIO) -> list[str]:
    """Read as many lines from the start of a file as it takes to know its layout.

    Where a gzipped file is damaged they end, so that what is whole can still be read.
    """
    sample: list[str] = []
    characters = 0
    with suppress(*DAMAGED_GZIP):
        for line in itertools.islice(stream, _SAMPLE_LINES):
            sample.append(line)
            characters += len(line)
            if characters > _SAMPLE_CHARACTERS:
                break
    return sample


def records(lines: Iterable[str], delimiter: str | None) -> Iterator[Record]:
    """Split lines into records; a quoted field may go on over several lines.

    Blank lines and lines that begin with ``#`` are passed over, but not inside a quoted field.

    Parameters
    ----------
    lines : iterable of str
        With their line ends.
    delimiter : str or None
        Between fields; None for any run of blanks.

    Yields
    ------
    (int, list of str)
        The line on which a record begins, and its fields.

    Raises
    ------
    csv.Error
        If quotation marks do not match up.
    """
    numbered = enumerate(lines, start=1)
    for number, line in numbered:
        if is_skipped(line, delimiter):
            continue
        if delimiter is None:
            yield number, [quoted or bare for quoted, bare in _BLANK_SEPARATED.findall(line)]
            continue
        from_here = itertools.chain([line], (later for _, later in numbered))
        reader = csv.reader(from_here, delimiter=delimiter, skipinitialspace=True, strict=True)
        try:
            yield number, next(reader)
        except csv.Error as error:
            raise csv.Error(f"line {number}: {error}") from error


def find_delimiter(sample: Sequence[str]) -> str | None:
    """Tell what stands between fields.

    The first of semicolon, tab, comma and blanks by which the records agree in their number of
    fields; if they agree by none (a damaged file), the one that splits most of them.

    Parameters
    ----------
    sample : sequence of str
        The first lines of a file.

    Returns
    -------
    str or None
        None for any run of blanks.
    """
    splits = Counter[str | None]()
    for delimiter in _DELIMITERS:
        widths = [len(fields) for _, fields in _first_records(sample, delimiter)]
        body = set(widths[1:] or widths)
        if len(body) == 1 and min(body) > 1 and abs(widths[0] - min(body)) <= 1:
            return delimiter
        splits[delimiter] = sum(width > 1 for width in widths)
    best, count = splits.most_common(1)[0]
    return best if count else ","


def lines_above(sample: Sequence[str]) -> int:
    """Count the lines above a table, as measuring programs write them to say what was measured.

    They are such only beyond doubt: the first line has hardly as many fields as the many rows of
    numbers that follow, which agree with one another.

    Parameters
    ----------
    sample : sequence of str
        The first lines of a file.

    Returns
    -------
    int
        0 if the file begins with its table. The line of names, if there is one, is of the table.
    """
    top = sample[:_LINES_ABOVE]
    for delimiter in _DELIMITERS:
        widths = [0 if is_skipped(s, delimiter) else len(_split(s, delimiter)) for s in top]
        first = next((width for width in widths if width), 0)
        wide = (i for i, width in enumerate(widths) if width > first + 1)
        start = next((i for i in wide if _is_numeric(top[i], delimiter)), None)
        if start is None:
            continue
        rows = range(start, min(start + _ROWS_BEYOND_DOUBT, len(top)))
        alike = all(widths[i] == widths[start] and _is_numeric(top[i], delimiter) for i in rows)
        if alike and len(rows) == _ROWS_BEYOND_DOUBT:
            named = abs(widths[start - 1] - widths[start]) <= 1
            return start - named
    return 0


def _split(line: str, delimiter: str | None) -> list[str]:
    return line.strip("\r\n").split(delimiter)


def _is_numeric(line: str, delimiter: str | None) -> bool:
    fields = _split(line, delimiter)
    try:
        for field in fields:
            parse_number(field if delimiter == "," else field.replace(",", "."))
    except ValueError:
        return False
    return len(fields) > 1 and any(field.strip() for field in fields)


def find_layout(sample: Sequence[str], *, own_delimiter: str = "") -> Layout:
    """Tell how a file of numbers is laid out.

    Parameters
    ----------
    sample : sequence of str
        Its first lines.
    own_delimiter : str
        The delimiter, if the file itself names it; then the first record is a header.

    Returns
    -------
    Layout

    Raises
    ------
    csv.Error
        If quotation marks do not match up.
    """
    delimiter = own_delimiter or find_delimiter(sample)
    found = list(itertools.islice(records(sample, delimiter), _SAMPLE_RECORDS))
    rows = [fields for _, fields in found]
    has_header = bool(rows) and (bool(own_delimiter) or _looks_like_header(delimiter, *rows[:2]))
    header, body = (rows[0], rows[1:]) if has_header else ([], rows)
    first_line = _line_after_header(sample, delimiter) if has_header else 1
    width, empty = (len(body[0]), empty_columns(body)) if body else (0, 0)
    if not header:
        return Layout(delimiter, (), width - empty, empty, first_line)
    named = header[: len(header) - empty_columns([header])]
    if 0 <= width - len(named) <= empty:
        return Layout(delimiter, tuple(named), len(named), width - len(named), first_line)
    return Layout(delimiter, tuple(header), len(header) if body else 0, 0, first_line)


def empty_columns(rows: Sequence[Sequence[str]]) -> int:
    """Count the columns at the end in which nothing stands; the first column is none of them."""
    columns = range(1, min(map(len, rows)))
    return sum(
        1 for _ in itertools.takewhile(lambda i: not any(r[-i].strip() for r in rows), columns)
    )


def _first_records(sample: Sequence[str], delimiter: str | None) -> Iterator[Record]:
    """Give the first records, up to where quotation marks do not fit this delimiter."""
    try:
        yield from itertools.islice(records(sample, delimiter), _SAMPLE_RECORDS)
    except csv.Error:
        return


def _line_after_header(sample: Sequence[str], delimiter: str | None) -> int:
    rest = iter(sample)
    next(records(rest, delimiter))  # it may go over several lines
    return len(sample) - sum(1 for _ in rest) + 1


def _looks_like_header(
    delimiter: str | None, first: Sequence[str], second: Sequence[str] = ()
) -> bool:
    try:
        for field in first:
            parse_number(field if delimiter == "," else field.replace(",", "."))
    except ValueError:
        return True
    if not first[0].strip():
        first, second = first[1:], second[1:]
    return _counts(first) and not (second and _counts([*first, second[0]]))


def _counts(fields: Sequence[str]) -> bool:
    """Tell whether fields are 0, 1, 2 ... or 1, 2, 3 ...: names that a data frame gives columns."""
    return len(fields) >= _FEWEST_COUNTED and any(
        [field.strip() for field in fields] == [str(start + i) for i in range(len(fields))]
        for start in (0, 1)
    )
