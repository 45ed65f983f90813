"""Tables of text: how fields are separated, which columns they have, and their numbers."""

from __future__ import annotations

import csv
import functools
import itertools
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError, InputError
from anisomap.io.parsing.source import (
    GZIP_ERRORS,
    Item,
    TextLines,
    batches,
    open_text,
    quote,
    quote_if_needed,
    warn,
    warn_of_loss,
)

# Limits memory for very wide tables; columns are told apart by at least eight rows.
_MIN_FIRST_ROWS, _MAX_FIRST_CELLS = 8, 1 << 22
_BLOCK_CHARACTERS, _LEAST_PER_LINE = 1 << 22, 1 << 13  # so that blocks have at most 512 lines


class LineError(FileError):
    """A line, from 1, that cannot be parsed; with surplus fields it is not truncated."""

    def __init__(self, path: Path, line: int, problem: str, *, surplus: bool = False) -> None:
        super().__init__(f"{path}, line {line}{problem}")
        self.line, self.surplus, self.reason = line, surplus, f"line {line}{problem}"


def field_error(
    path: Path,
    line: int,
    column: int,
    field: str,
    *,
    problem: str = "is not a number",
    name: str = "",
) -> LineError:
    """Return the error of a field, with the index of its column and perhaps its name."""
    label = f" ({name})" if name else ""
    return LineError(path, line, f", column {column + 1}{label}: {quote(field)} {problem}")


def read_undamaged(
    path: Path,
    parse: Callable[[TextLines], Iterator[Item]],
    noun: str,
    *,
    count: Callable[[Item], int] = lambda _: 1,
    quietly: bool = False,
) -> Iterator[Item]:
    """Yield what is parsed before any damage or a truncated last line, and warn about the rest."""
    n_read = 0
    with open_text(path) as lines:
        try:
            for item in parse(lines):
                yield item
                n_read += count(item)
        except (LineError, csv.Error) as error:
            is_last = not isinstance(error, LineError) or error.line == lines.number
            truncated = is_last and not lines.last.endswith(("\n", "\r"))
            if not n_read or not truncated or getattr(error, "surplus", False) or next(lines, ""):
                raise
            reason = getattr(error, "reason", str(error))
            if not quietly:
                problem = f"the last line is truncated and dropped ({reason})"
                warn(path, f"{problem}; read the {n_read} {noun} before it")
        except GZIP_ERRORS as error:
            if not quietly:
                if not n_read:
                    raise
                warn_of_loss(path, error, f"{n_read} {noun}", lines.fraction())


@dataclass(frozen=True)
class Table:
    """Layout of the numbers in a text file; columns of text are read as NaN.

    delimiter: None for any run of white space.
    because: Reason for `n_columns` in messages, such as ``"the header names 3"``.
    first_line: First line of numbers, from 1.
    clean: Converts a line to numbers and delimiters; must keep the order of fields.
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

    Comments begin with ``#``; an empty field is NaN. The rest after damage is dropped as above.
    """

    def parse(text: TextLines) -> Iterator[tuple[NDArray[np.float64], float]]:
        first_line = table.first_line
        lines = itertools.islice(text, first_line - 1, None)
        for block in batches(lines, lambda line: len(line) + _LEAST_PER_LINE, _BLOCK_CHARACTERS):
            for rows in _parsed(block, table, first_line):
                yield rows, text.fraction()
            first_line += len(block)

    return read_undamaged(
        table.path, parse, "frames", count=lambda block: len(block[0]), quietly=quietly
    )


def first_rows(table: Table, n_rows: int) -> NDArray[np.float64]:
    """Read the first `n_rows` rows, or fewer of very wide tables, ignoring damage after them."""
    n_rows = min(n_rows, max(_MIN_FIRST_ROWS, _MAX_FIRST_CELLS // max(table.n_columns, 1)))
    held = [np.empty((0, table.n_columns))]
    for rows, _ in read_blocks(table, quietly=True):
        held.append(rows)
        if sum(map(len, held)) >= n_rows:
            break
    return np.concatenate(held)[:n_rows]


def line_of(table: Table, row: int) -> str:
    """Return the line of a row of `read_blocks`: ``"line 12"``."""
    with open_text(table.path) as stream:
        lines = itertools.islice(enumerate(stream, start=1), table.first_line - 1, None)
        filled = (number for number, line in lines if not is_skipped(line, table.delimiter))
        return f"line {next(itertools.islice(filled, row, None))}"


def is_skipped(line: str, delimiter: str | None = None) -> bool:
    """Return whether a line is blank or a comment; between tabs, readings may be missing."""
    content = line.partition("#")[0]
    return not content.strip() and not (delimiter == "\t" and "\t" in content)


def parse_number(field: str, delimiter: str | None = ",") -> float:
    """Parse a number as numpy does, with a decimal comma too unless commas separate the fields."""
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
            raise field_error(path, line, column, fields[column], name=name) from None
    return values


def is_number(field: str, delimiter: str | None = ",") -> bool:
    """Return whether `parse_number` accepts a field."""
    with suppress(ValueError):
        parse_number(field, delimiter)
        return True
    return False


def _text_to_nan(field: str) -> float:
    """Convert a field of a text column to NaN; raise ValueError for a number."""
    if field.strip() and is_number(field):
        raise ValueError(field)
    return math.nan


def _parsed(lines: list[str], table: Table, first_line: int) -> Iterator[NDArray[np.float64]]:
    """Yield the rows of some lines, those before a wrong line before its error."""
    cleaned = list(map(table.clean, lines)) if table.clean else lines
    block = np.empty((0, 0))
    if not all(map(is_skipped, cleaned)):
        with suppress(ValueError):
            block = np.loadtxt(
                cleaned,
                np.float64,
                comments="#",
                delimiter=table.delimiter,
                converters=dict.fromkeys(table.text_columns, _text_to_nan) or None,
                ndmin=2,
                quotechar='"',
            )
    # np.loadtxt compares the widths of lines only within the block.
    if block.shape[1] == table.n_columns:
        yield block
        return
    filled = (
        _row(line, table, number)
        for number, line in enumerate(lines, first_line)
        if not is_skipped(line, table.delimiter)
    )
    for rows in batches(filled, len, _BLOCK_CHARACTERS):
        yield np.array(rows)


def _row(line: str, table: Table, number: int) -> list[float]:
    fields = _fields(table.clean(line) if table.clean else line, table.delimiter)
    if len(fields) != table.n_columns:
        problem = f" has {len(fields)} field{'s' * (len(fields) != 1)}, but {table.because}"
        raise LineError(table.path, number, problem, surplus=len(fields) > table.n_columns)
    values = []
    for column, field in enumerate(fields):
        is_text = column in table.text_columns
        try:
            values.append(_text_to_nan(field) if is_text else parse_number(field))
        except ValueError:
            name = quote_if_needed(table.names[column]) if table.names else ""
            # Cleaning a line may change the number of its fields, such as that of "(1 2),3".
            originals = _fields(line, table.delimiter)
            original = (originals if len(originals) == len(fields) else fields)[column].strip()
            problem = "is a number in a column of text" if is_text else "is not a number"
            raise field_error(
                table.path, number, column, original, problem=problem, name=name
            ) from None
    return values


def _fields(line: str, delimiter: str | None) -> list[str]:
    content = line.partition("#")[0].strip("\r\n")
    if delimiter is None:
        return [field.strip('"') for field in content.split()]
    if '"' not in content:
        return content.split(delimiter)
    return next(csv.reader([content], delimiter=delimiter, skipinitialspace=True), [])


Record = tuple[int, list[str]]
"""First line of a record, from 1, and its fields."""

FORMULA_STARTS = (*"=+-@\t\r", *"\uff1d\uff0b\uff0d\uff20")
"""First characters of a cell that spreadsheets take for a formula, some in full width."""

_SAMPLE_LINES, _SAMPLE_CHARACTERS = 1000, 1 << 21
_SAMPLE_RECORDS = 50
# In order of reliability: numbers and names rarely contain semicolons and tabs; commas may be
# decimal.
DELIMITERS = (";", "\t", ",", None)
_BLANK_SEPARATED = re.compile(r'"((?:[^"]|"")*)"|(\S+)')
# Chosen by hand, so that a row of numbers is not mistaken for the labels 0, 1, 2, ...
_MIN_COUNTED = 4
_MAX_PREAMBLE, _MIN_UNIFORM_ROWS = 100, 5
_MIN_TEXT_CELLS = 2


def guard_formula(name: str) -> str:
    """Precede a name that a spreadsheet would run as a formula with one more apostrophe."""
    if len(name) >= csv.field_size_limit():
        raise InputError(f"a name of {len(name)} characters is too long for delimited text")
    return f"'{name}" if name.lstrip("'").startswith(FORMULA_STARTS) else name


def unguard_formula(field: str) -> str:
    """Restore a name from `guard_formula`."""
    guarded = field.startswith("'") and field.lstrip("'").startswith(FORMULA_STARTS)
    return field[1:] if guarded else field


def read_sample(path: Path) -> list[str]:
    """Read the first lines of a file to detect its layout, up to the first gzip damage."""
    sample: list[str] = []
    characters = longest = 0
    with open_text(path) as stream, suppress(*GZIP_ERRORS):
        for line in itertools.islice(stream, _SAMPLE_LINES):
            sample.append(line)
            characters += len(line)
            longest = max(longest, len(line))
            # The longest line is not counted: a header of many names must not hide the numbers.
            if characters - longest > _SAMPLE_CHARACTERS:
                break
    return sample


def records(lines: Iterable[str], delimiter: str | None) -> Iterator[Record]:
    """Split lines that are not skipped into records; a quoted field may span several lines."""
    first = 0  # line of the record that is being read

    def filled() -> Iterator[str]:
        nonlocal first
        for number, line in enumerate(lines, start=1):
            if first or not is_skipped(line, delimiter):
                first = first or number
                yield line

    if delimiter is None:
        for line in filled():
            yield first, [quoted or bare for quoted, bare in _BLANK_SEPARATED.findall(line)]
            first = 0
        return
    try:
        for fields in csv.reader(filled(), delimiter=delimiter, skipinitialspace=True, strict=True):
            yield first, fields
            first = 0
    except csv.Error as error:
        raise csv.Error(f"line {first}: {error}") from error


def find_delimiter(sample: Sequence[str]) -> str | None:
    """Return the first delimiter that gives all records equally many fields, or splits most."""
    splits = Counter[str | None]()
    for delimiter in DELIMITERS:
        first = itertools.islice(_all_records(sample, delimiter), _SAMPLE_RECORDS)
        widths = [len(fields) for _, fields in first]
        body = set(widths[1:] or widths)
        if len(body) == 1 and min(body) > 1 and abs(widths[0] - min(body)) <= 1:
            return delimiter
        splits[delimiter] = sum(width > 1 for width in widths)
    best, count = splits.most_common(1)[0]
    return best if count else ","


def count_preamble(sample: Sequence[str]) -> int:
    """Count the lines of metadata above some equal rows of numbers, wider than the first line."""
    top = sample[:_MAX_PREAMBLE]
    for delimiter in DELIMITERS:
        widths = [0 if is_skipped(s, delimiter) else len(_split(s, delimiter)) for s in top]
        first = next((width for width in widths if width), 0)
        wide = (i for i, width in enumerate(widths) if width > first + 1)
        start = next((i for i in wide if _is_numeric(top[i], delimiter)), None)
        if start is None:
            continue
        rows = range(start, min(start + _MIN_UNIFORM_ROWS, len(top)))
        alike = all(widths[i] == widths[start] and _is_numeric(top[i], delimiter) for i in rows)
        if alike and len(rows) == _MIN_UNIFORM_ROWS:
            named = abs(widths[start - 1] - widths[start]) <= 1
            return start - named
    return 0


def _split(line: str, delimiter: str | None) -> list[str]:
    return line.strip("\r\n").split(delimiter)


def _is_numeric(line: str, delimiter: str | None) -> bool:
    fields = _split(line, delimiter)
    numeric = all(is_number(field, delimiter) for field in fields)
    return numeric and len(fields) > 1 and any(field.strip() for field in fields)


def find_table(path: Path, sample: Sequence[str], own_delimiter: str | None = None) -> Table:
    """Detect the layout of a file of numbers; `n_columns` is 0 if there is no line of numbers.

    Files of anisomap, with their own delimiter, have a header and nothing but numbers below.
    """
    preamble = count_preamble(sample) if own_delimiter is None else 0
    sample = sample[preamble:]
    delimiter = own_delimiter or find_delimiter(sample)
    found = list(itertools.islice(records(sample, delimiter), _SAMPLE_RECORDS))
    rows = [fields for _, fields in found]
    text = () if own_delimiter else _text_columns(sample, delimiter, rows)
    numeric = [[f for i, f in enumerate(row) if i not in text] for row in rows[:2]]
    has_header = bool(rows) and (bool(own_delimiter) or _looks_like_header(delimiter, *numeric))
    header, body = (rows[0], rows[1:]) if has_header else ([], rows)
    width, empty = (len(body[0]), empty_columns(body)) if body else (0, 0)
    if header:
        named = header[: len(header) - empty_columns([header])]
        trailing = width - len(named)
        header, trailing = (named, trailing) if 0 <= trailing <= empty else (header, 0)
        n_columns = len(header) if body else 0
        because = f"the header names {n_columns}"
        first_line = found[1][0] if body else len(sample) + 1
    else:
        n_columns, trailing, first_line = width - empty, empty, 1
        because = f"line {preamble + found[0][0] if found else 0} has {n_columns}"
    changed = delimiter != "," or trailing
    return Table(
        path,
        delimiter,
        n_columns,
        because,
        preamble + first_line,
        tuple(header),
        functools.partial(_clean, delimiter, trailing) if changed else None,
        text,
    )


def _clean(delimiter: str | None, n_trailing: int, line: str) -> str:
    """Replace decimal commas by points, and drop trailing delimiters."""
    if delimiter != ",":
        line = line.replace(",", ".")
    for _ in range(n_trailing):
        line = line.rstrip(" \r\n").removesuffix(delimiter or "")
    return line


def _text_columns(
    sample: Sequence[str], delimiter: str | None, rows: Sequence[Sequence[str]]
) -> tuple[int, ...]:
    """Find columns that hold text and no number below the first record, which may be a header."""
    # A header may name fewer columns than a damaged row has.
    candidates = [i for i in _without_numbers(rows[1:], delimiter) if i < len(rows[0])]
    if candidates:
        every = [fields for _, fields in _all_records(sample, delimiter)]
        in_every = set(_without_numbers(every[1:], delimiter))
        candidates = [i for i in candidates if i in in_every]
    # A file without a column of numbers gives an error about its first cell instead.
    return tuple(candidates) if rows and len(candidates) < len(rows[0]) else ()


def _without_numbers(rows: Sequence[Sequence[str]], delimiter: str | None) -> list[int]:
    found = []
    for i in range(len(rows[0]) if rows else 0):
        cells = [row[i] for row in rows if i < len(row) and row[i].strip()]
        if len(cells) >= _MIN_TEXT_CELLS and not any(is_number(c, delimiter) for c in cells):
            found.append(i)
    return found


def empty_columns(rows: Sequence[Sequence[str]]) -> int:
    """Count the empty columns at the end of all rows; the first column always counts as used."""
    columns = range(1, min(map(len, rows)))
    return sum(
        1 for _ in itertools.takewhile(lambda i: not any(r[-i].strip() for r in rows), columns)
    )


def _all_records(sample: Sequence[str], delimiter: str | None) -> Iterator[Record]:
    """Yield the records up to the first unbalanced quotation mark."""
    try:
        yield from records(sample, delimiter)
    except csv.Error:
        return


def _looks_like_header(
    delimiter: str | None, first: Sequence[str], second: Sequence[str] = ()
) -> bool:
    if not all(is_number(field, delimiter) for field in first):
        return True
    if first and not first[0].strip():
        first, second = first[1:], second[1:]
    return _counts(first) and not (second and _counts([*first, second[0]]))


def _counts(fields: Sequence[str]) -> bool:
    """Return whether fields are 0, 1, 2, ... or 1, 2, 3, ...: default labels of data frames."""
    return len(fields) >= _MIN_COUNTED and any(
        all(field.strip() == str(number) for number, field in enumerate(fields, start))
        for start in (0, 1)
    )
