"""Tables of text: separators of fields, columns, and contents of cells.

Cells are numbers, words for missing values, clocks, names or formulas.
"""

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

from anisomap.base.clocks import parse_clock
from anisomap.errors import FileError, InputError
from anisomap.io.parsing.lines import ADDRESS, MisfitError
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

# Limits memory for very wide tables; kinds of columns are determined by at least eight rows.
_MIN_FIRST_ROWS, _MAX_FIRST_CELLS = 8, 1 << 22
_MAX_TOGETHER = 1 << 23  # characters of the lines of a frame
_BLOCK_CHARACTERS, _LEAST_PER_LINE = 1 << 22, 1 << 13  # so that blocks have at most 512 lines


_NUMPY = "nan -nan +nan nat"
_PROGRAMS = "- -- --- . ? na n/a <na> null none nil missing ovf ovl ol overflow err"
MISSING = frozenset(["", *_NUMPY.split(), *_PROGRAMS.split()])
"""Words for a missing value, in lower case, in recordings, layouts, maps and dissimilarities."""

_IDENTIFIER = re.compile(r"[^\W\d][\w.\-/\\]*")
_IN_TEXT = re.compile(r"\d")
_DIGITS = "0123456789.,eE+-"
_ROW = re.compile(r"[^\s,;|][\s,;|]+[^\s,;|]")
_WORD = re.compile(r"\s*[^\W\d_][\w/]*")

SUM = re.compile(r"(?:0x)?(?:[0-9A-Fa-f]{2}){1,4}")
"""Pattern of a checksum in hexadecimal digits."""

FORMULA_STARTS = (*"=+-@\t\r", *"\uff1d\uff0b\uff0d\uff20")
"""First characters of a cell that spreadsheets treat as a formula, some in full width."""


def is_missing(cell: str) -> bool:
    """Return whether a cell is empty or a word for a missing value."""
    return cell.strip().lower() in MISSING


def parse_number(cell: str, delimiter: str | None = ",") -> float:
    """Parse a number as numpy does; also with a decimal comma, unless commas separate fields."""
    text = (cell if delimiter == "," else cell.replace(",", ".")).strip()
    if text.lower() in MISSING:
        return math.nan
    if "_" in text or not text.isascii():
        raise ValueError(text)
    return float(text)


def parse_time(cell: str) -> float:
    """Parse a clock as seconds, or a number."""
    found = parse_clock(cell)
    return parse_number(cell) if found is None else found


def is_number(cell: str, delimiter: str | None = ",") -> bool:
    """Return whether `parse_number` accepts a cell."""
    with suppress(ValueError):
        parse_number(cell, delimiter)
        return True
    return False


def is_label(cell: str) -> bool:
    """Return whether a cell is text without a number: ``left``, or a name such as ``S01``."""
    text = cell.strip()
    named = _IDENTIFIER.fullmatch(text) or re.fullmatch(ADDRESS, text)
    return not _IN_TEXT.search(text) or text[-1] == ":" or bool(named)


_REMEDIES = {
    r"[-+]?\d{1,3}(?:([.,' \u00a0])\d{3})(?:\1\d{3})*(?:[.,]\d+)?": "remove thousands separators",
    r"[-+.\d]{20,}": "separate the numbers by commas",
    r"true|false|on|off": "write 1 and 0",
    r"0x[0-9a-f]+|\d[0-9a-f]+": "write decimal numbers",
    r"[-+]?[\d.]+d[-+]?\d+": "write exponents with E",
    r"[\d.,]+-|\([\d.,]+\)|\u2212[\d.,]+": "write negative numbers as -12",
}


def remedy_of(cell: str) -> str:
    """Return advice about a cell that is not a number; empty if there is none."""
    text = cell.strip().lower()
    found = (remedy for form, remedy in _REMEDIES.items() if re.fullmatch(form, text))
    return "".join(f"; {remedy} in the file" for remedy in itertools.islice(found, 1))


def guard_formula(name: str) -> str:
    """Prefix a name that a spreadsheet would run as a formula with an apostrophe."""
    if len(name) >= csv.field_size_limit():
        raise InputError(f"a name of {len(name)} characters is too long for delimited text")
    return f"'{name}" if name.lstrip("'").startswith(FORMULA_STARTS) else name


def unguard_formula(field: str) -> str:
    """Restore a name from `guard_formula`."""
    guarded = field.startswith("'") and field.lstrip("'").startswith(FORMULA_STARTS)
    return field[1:] if guarded else field


NO_NUMBER = "is not a number"

_GOOD_PER_BAD = 100  # lines of a log per line that is left out


class LineError(FileError):
    """A line, from 1, that cannot be parsed; with surplus fields it is not truncated."""

    def __init__(self, path: Path, line: int, problem: str, *, surplus: bool = False) -> None:
        super().__init__(f"{path}, line {line}{problem}")
        self.line, self.surplus, self.reason = line, surplus, f"line {line}{problem}"


class HeaderError(LineError):
    """A line of names below the first frame, such as of a second recording."""


@dataclass
class LeftOut:
    """Lines that do not fit the others: up to 1 in 100, but at least one is allowed.

    repeats: Whether each is replaced by the preceding frame, so that the frame rate is kept.
    headers: Whether lines of names are such lines, instead of an error.
    """

    repeats: bool = False
    headers: bool = False
    n_lines: int = 0
    n_left: int = 0
    first: LineError | None = None
    before: Sequence[float] | NDArray[np.float64] | None = None

    def check(self) -> None:
        """Raise the first error if too many lines were left out, or all."""
        most = max(1, self.n_lines / _GOOD_PER_BAD)
        if self.first is not None and (self.n_left > most or self.before is None):
            raise self.first

    def __str__(self) -> str:
        """Return the number of lines left out, and the first of them."""
        reason = "" if self.first is None else self.first.reason
        place = "; the previous frame replaces each of them" if self.repeats else ""
        return f"left out lines: {self.n_left} of {self.n_lines}{place}: {reason}"


def field_error(
    path: Path,
    line: int,
    column: int,
    field: str,
    *,
    problem: str = NO_NUMBER,
    name: str = "",
    kind: type[LineError] = LineError,
) -> LineError:
    """Return the error of a field, with the index of its column and perhaps its name."""
    label = f" ({name})" if name else ""
    problem += remedy_of(field) if problem == NO_NUMBER else ""
    return kind(path, line, f", column {column + 1}{label}: {quote(field)} {problem}")


def read_undamaged(
    path: Path,
    parse: Callable[[TextLines], Iterator[Item]],
    noun: str,
    *,
    count: Callable[[Item], int] = lambda _: 1,
    quietly: bool = False,
) -> Iterator[Item]:
    """Yield parsed lines before any damage or a truncated last line, and warn about lost lines."""
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
    names: Names of all columns; some may be empty.
    clean: Converts a line to numbers and delimiters; must keep the order of fields.
    clocks: Columns of dates and times of the day, which are read as seconds.
    block: Rows and columns of the blocks of lines that are frames: see `divides`.
    nested: Whether brackets enclose the lines of a frame.
    numeric: The delimiter of cleaned lines.
    skipped: Description of the contents skipped above the first line.
    above: Stripped lines above the first one, which a recorder writes again after a restart.
    ended: Whether every line has a line end, so that a line without an end is truncated.
    doubt: Question to the user if the meaning of the file is not clear.
    """

    path: Path
    delimiter: str | None
    n_columns: int
    because: str
    first_line: int = 1
    names: tuple[str, ...] = ()
    clean: Callable[[str], str] | None = None
    text_columns: tuple[int, ...] = ()
    clocks: tuple[int, ...] = ()
    block: tuple[int, int] | None = None
    nested: bool = False
    numeric: str | None = ""
    skipped: str = ""
    above: frozenset[str] = frozenset()
    ended: bool = False
    doubt: str = ""

    def is_skipped(self, line: str) -> bool:
        """Return whether a line contains no frame."""
        return is_apart(line) if self.numeric else is_skipped(line, self.delimiter)

    @property
    def separator(self) -> str | None:
        """The delimiter of cleaned lines."""
        return self.delimiter if self.numeric == "" else self.numeric


Numbered = tuple[int, str]
"""A line, or the lines of a frame as one, with its number from 1."""


def _single_lines(
    numbered: Iterable[Numbered], table: Table, *, quietly: bool
) -> Iterator[Numbered]:
    """Yield the lines, except repetitions of lines above the first."""
    again = list[int]()
    for number, line in numbered:
        if table.ended and not line.endswith(("\n", "\r")):
            raise LineError(table.path, number, " has no end")
        if table.above and line.strip() in table.above:
            again.append(number)
        else:
            yield number, line
    if again and not quietly:
        count = f"{len(again)} lines, from line {again[0]} on, repeat earlier lines"
        problem = count if len(again) > 1 else f"line {again[0]} repeats an earlier line"
        warn(table.path, f"skipped: {problem} above the first frame; the recorder restarted")


def numbered_from(lines: Iterable[str], table: Table) -> Iterator[Numbered]:
    """Yield the lines from the first line of numbers, with line numbers from 1."""
    return itertools.islice(enumerate(lines, start=1), table.first_line - 1, None)


def frame_lines(
    numbered: Iterable[Numbered], table: Table, *, quietly: bool = True
) -> Iterator[Numbered]:
    """Yield the lines of frames: a line, a block of lines, or all lines inside brackets."""
    if table.block is None and not table.nested:
        yield from _single_lines(numbered, table, quietly=quietly)
        return
    held, size, depth, number, n_frames = list[str](), 0, 0, 0, 0
    n_rows = table.block[0] if table.block and not table.nested else 0
    between = table.delimiter or " "
    for number, line in numbered:
        size += len(line)
        if size > _MAX_TOGETHER:
            raise LineError(table.path, number, ": the lines of a frame do not end", surplus=True)
        if not table.nested:
            ends = divides(line)
            held += [] if ends else [_clean_row(line, table)]
        else:
            held.append(line.strip())
            depth += depth_of(line)
            ends = depth <= 0
        if ends and held:
            yield number, between.join(held)
            held, size, n_frames = [], 0, n_frames + 1
    if not held:
        return
    if n_frames and (len(held) < n_rows or depth > 0):
        if not quietly:
            problem = f"the last frame has {len(held)} of {n_rows or 'its'} lines and is dropped"
            warn(table.path, f"{problem}; read the frames before it: {n_frames}")
        return
    yield number, between.join(held)


def _clean_row(line: str, table: Table) -> str:
    content = line.partition("#")[0].strip()
    content = content.removeprefix("|")
    return content.rstrip(table.delimiter).strip() if table.delimiter else content


def depth_of(line: str) -> int:
    """Return the number of brackets that a line opens and does not close."""
    return sum(map(line.count, "[({")) - sum(map(line.count, "])}"))


def read_blocks(
    table: Table, *, quietly: bool = False, repeats: bool = False
) -> Iterator[tuple[NDArray[np.float64], float]]:
    """Read frames in blocks, each with the fraction of the file read so far.

    Comments begin with ``#``; an empty field is NaN. Lines after damage are dropped as above, and
    lines that do not fit are left out: see `LeftOut`.
    """

    def parse(text: TextLines) -> Iterator[tuple[NDArray[np.float64], float]]:
        left = LeftOut(repeats)
        lines = frame_lines(numbered_from(text, table), table, quietly=quietly)
        for some in batches(lines, lambda line: len(line[1]) + _LEAST_PER_LINE, _BLOCK_CHARACTERS):
            is_cut = some[-1][0] == text.number and not text.last.endswith(("\n", "\r"))
            short = is_cut and is_short([line for _, line in some])
            for rows in parsed(some[:-1] if short else some, table, left, is_cut=is_cut):
                yield rows, text.fraction()
            if short:
                left.check()
                raise LineError(table.path, text.number, " ends in a short number")
            if 2 * left.n_left > left.n_lines:
                left.check()
        left.check()
        if left.n_left and not quietly:
            warn(table.path, str(left))

    return read_undamaged(
        table.path, parse, "frames", count=lambda block: len(block[0]), quietly=quietly
    )


def is_short(lines: Sequence[str]) -> bool:
    """Return whether the last number of the last line has fewer characters than in all others."""
    *before, last = (len(line.rstrip()) - len(line.rstrip().rstrip(_DIGITS)) for line in lines)
    return len(before) >= _MIN_FIRST_ROWS and bool(lines[-1].strip()) and last < min(before)


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
        lines = frame_lines(numbered_from(stream, table), table)
        filled = (number for number, line in lines if _holds_frame(line, table, number))
        return f"line {next(itertools.islice(filled, row, None))}"


def _holds_frame(line: str, table: Table, number: int) -> bool:
    with suppress(LineError):
        return not table.is_skipped(line) and bool(_row(line, table, number))
    return False


def is_skipped(line: str, delimiter: str | None = None) -> bool:
    """Return whether a line is blank or a comment; between tabs, readings may be missing."""
    content = line.partition("#")[0]
    return not content.strip() and not (delimiter == "\t" and "\t" in content)


def is_apart(line: str) -> bool:
    """Return whether a line without numbers and text divides frames: ``""``, ``#``, ``-----``."""
    return is_skipped(line) or not any(map(str.isalnum, line))


def divides(line: str) -> bool:
    """Return whether a line divides frames of rows: it is apart, or a word or number is first."""
    word = _WORD.match(line)
    single = not _ROW.search(line)
    return single or is_apart(line) or (word is not None and not is_number(word[0]))


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


def _text_to_nan(field: str) -> float:
    """Convert a field of a text column to NaN; raise ValueError for a number."""
    if not is_missing(field) and is_number(field) and not SUM.fullmatch(field.strip()):
        raise ValueError(field)
    return math.nan


_WORDS = "|".join(re.escape(word) for word in sorted(MISSING - {""}, key=len, reverse=True))


@functools.cache
def _missing_in(delimiter: str | None) -> re.Pattern[str]:
    """Return a pattern of words for missing values, and empty fields, between delimiters."""
    mark = re.escape(delimiter) if delimiter else r"\s"
    blank = r"[^\S\t\r\n]*" if delimiter else ""
    words = f"(?:{_WORDS}|)" if delimiter else f"(?:{_WORDS})"
    start, end = rf"(?:(?<={mark})|^)", rf"(?={mark}|[\r\n]|$)"
    return re.compile(rf"{start}{blank}{words}{blank}{end}", re.IGNORECASE)


def parsed(
    lines: list[Numbered], table: Table, left: LeftOut, *, is_cut: bool = False
) -> Iterator[NDArray[np.float64]]:
    """Yield the rows of some lines; rows before a wrong line are yielded before its error.

    is_cut: Whether the last line may be truncated, which is a separate error.
    """
    block = np.empty((0, 0))
    with suppress(ValueError):
        texts = [line for _, line in lines]
        cleaned = list(map(table.clean, texts)) if table.clean else texts
        if not all(map(is_skipped, cleaned)):
            try:
                block = _by_numpy(cleaned, table)
            except ValueError:
                missing = _missing_in(table.separator)
                filled = [s for s in cleaned if not is_skipped(s, table.separator)]
                block = _by_numpy([missing.sub("nan", s) for s in filled], table)
    # np.loadtxt compares the widths of lines only within the block.
    if len(block) and block.shape[1] == table.n_columns:
        left.n_lines, left.before = left.n_lines + len(block), block[-1]
        yield block
        return
    for rows in batches(_rows(lines, table, left, is_cut), len, _BLOCK_CHARACTERS):
        yield np.array(rows)


def _rows(
    lines: list[Numbered], table: Table, left: LeftOut, is_cut: bool
) -> Iterator[Sequence[float] | NDArray[np.float64]]:
    for number, line in lines:
        if table.is_skipped(line):
            continue
        left.n_lines += 1
        try:
            left.before = _row(line, table, number)
        except LineError as error:
            again = isinstance(error, HeaderError) and not left.headers
            if again or (is_cut and number == lines[-1][0]):
                raise
            left.n_left, left.first = left.n_left + 1, left.first or error
            if not left.repeats or left.before is None:
                continue
        yield left.before


def _parsers(table: Table) -> dict[int | str, Callable[[str], float]]:
    """Return the parsers of columns that contain other values than numbers."""
    found: dict[int | str, Callable[[str], float]] = dict.fromkeys(table.text_columns, _text_to_nan)
    return found | dict.fromkeys(table.clocks, parse_time)


def _by_numpy(lines: list[str], table: Table) -> NDArray[np.float64]:
    return np.loadtxt(
        lines,
        np.float64,
        comments="#",
        delimiter=table.separator,
        converters=_parsers(table) or None,
        ndmin=2,
        quotechar='"',
    )


def _row(line: str, table: Table, number: int) -> list[float]:
    try:
        cleaned = table.clean(line) if table.clean else line
    except MisfitError as error:
        raise LineError(table.path, number, f": {error}") from None
    fields = _fields(cleaned, table.separator)
    if len(fields) != table.n_columns:
        problem = f" has {len(fields)} instead of {table.n_columns} fields: {table.because}"
        raise LineError(table.path, number, problem, surplus=len(fields) > table.n_columns)
    parsers = _parsers(table)
    values = []
    for column, field in enumerate(fields):
        try:
            values.append(parsers.get(column, parse_number)(field))
        except ValueError:
            name = quote_if_needed(table.names[column]) if table.names else ""
            # Cleaning may change the number of fields in a line, such as "(1 2),3".
            originals = _fields(line, table.delimiter)
            original = (originals if len(originals) == len(fields) else fields)[column].strip()
            is_text = column in table.text_columns
            problem = "is a number in a column of text" if is_text else NO_NUMBER
            below = number > table.first_line and not any(map(is_number, fields))
            if below and not remedy_of(original):
                problem += " (a second header? save each recording in a file of its own)"
            kind = HeaderError if below and not is_text else LineError
            raise field_error(
                table.path, number, column, original, problem=problem, name=name, kind=kind
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

SAMPLE_LINES, _SAMPLE_CHARACTERS = 1000, 1 << 21
SAMPLE_RECORDS = 50
# In order of reliability: numbers and names rarely contain semicolons and tabs; commas may be
# decimal.
DELIMITERS = (";", "\t", "|", ",", None)
_BLANK_SEPARATED = re.compile(r'"((?:[^"]|"")*)"|(\S+)')


def read_sample(path: Path) -> list[str]:
    """Read the first lines of a file to detect its layout, up to the first gzip damage."""
    sample: list[str] = []
    characters = longest = 0
    with open_text(path) as stream, suppress(*GZIP_ERRORS):
        for line in itertools.islice(stream, SAMPLE_LINES):
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
    """Return the first delimiter with which all records have equally many fields, or most."""
    splits = Counter[str | None]()
    for delimiter in DELIMITERS:
        first = itertools.islice(all_records(sample, delimiter), SAMPLE_RECORDS)
        widths = [len(fields) for _, fields in first]
        body = set(widths[1:] or widths)
        if len(body) == 1 and min(body) > 1 and abs(widths[0] - min(body)) <= 1:
            return delimiter
        splits[delimiter] = sum(width > 1 for width in widths)
    best, count = splits.most_common(1)[0]
    return best if count else ","


def empty_columns(rows: Sequence[Sequence[str]]) -> int:
    """Count the empty columns at the end of all rows; the first column always counts as used."""
    columns = range(1, min(map(len, rows)))
    return sum(
        1 for _ in itertools.takewhile(lambda i: not any(r[-i].strip() for r in rows), columns)
    )


def all_records(sample: Sequence[str], delimiter: str | None) -> Iterator[Record]:
    """Yield the records up to the first unbalanced quotation mark."""
    try:
        yield from records(sample, delimiter)
    except csv.Error:
        return
