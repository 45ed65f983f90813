"""Detect the layout of delimited text: delimiter, header, preamble and text columns."""

from __future__ import annotations

import csv
import functools
import itertools
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from anisomap.errors import InputError
from anisomap.io.parsing.source import GZIP_ERRORS, open_text
from anisomap.io.parsing.table import Table, is_number, is_skipped

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
    """Precede a name that a spreadsheet would run as a formula with an apostrophe.

    `unguard_formula` restores every name; names of apostrophes before a formula get one more.
    """
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
    """Split lines into records; a quoted field may span several lines.

    Blank lines and lines that start with ``#`` are skipped, except inside a quoted field.
    """
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
    """Detect the delimiter.

    The delimiter is the first of semicolon, tab, comma and white space that gives all records the
    same number of fields. If none does (in a damaged file), it is the one that splits most records.
    """
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
    """Count the lines of metadata above the table, as measurement programs export them.

    Metadata are recognised only if several rows of numbers of equal width follow, with more fields
    than the first line.
    """
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

    Files with an own delimiter have a header, no column of text and no metadata above the table.
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
        first_line = _line_after_header(sample, delimiter)
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


def _line_after_header(sample: Sequence[str], delimiter: str | None) -> int:
    rest = iter(sample)
    next(records(rest, delimiter))  # the header may span several lines
    return len(sample) - sum(1 for _ in rest) + 1


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
