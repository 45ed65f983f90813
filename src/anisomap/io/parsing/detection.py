"""Detection of the layout of lines: separators, header, text around numbers, and blocks.

The first lines determine the layout. See `anisomap.io.parsing.lines` for text around numbers.
"""

from __future__ import annotations

import functools
import itertools
import operator
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.base.clocks import parse_clock
from anisomap.base.wording import join_items
from anisomap.io.parsing.lines import Template, as_objects, find_template
from anisomap.io.parsing.source import RefusedError, quote
from anisomap.io.parsing.tables import (
    DELIMITERS,
    SAMPLE_RECORDS,
    SUM,
    Numbered,
    Table,
    all_records,
    depth_of,
    divides,
    empty_columns,
    find_delimiter,
    is_apart,
    is_label,
    is_missing,
    is_number,
    is_skipped,
    parse_number,
    records,
)

# Chosen by hand, so that a row of numbers is not mistaken for the labels 0, 1, 2, ...
_MIN_COUNTED = 4
_MAX_PREAMBLE, _MIN_UNIFORM_ROWS = 100, 5
_MIN_TEXT_CELLS, _MOST_DECIMAL = 2, 0.75  # of two hexadecimal digits, 0.4 are decimal
_MIN_BLOCKS, _MIN_NESTED, _TALL, _MOST_ROWS = 3, 2, 128, 64  # between messages
# A cell of two numbers with a comma may be one number with a decimal comma.
_MIN_LISTED = 3
_MAX_UNIT = 12  # characters
# Change between lines of a block, relative to change between blocks: 2.3 for matrices of successive
# frames, .5 for other matrices, and .25 for recordings of presses (simulated).
_CONTINUOUS = 0.4
_DIGITS = re.compile(r"\d+")
_RULE = re.compile(r"[+|\s]*(?:=[=+|\s]+|-{2}[-+|\s]+)")
_MAX_REMARK = 8  # words
_MIN_COMPARED, _MIN_PLACES = 20, 9
_COMMENT, _MARKED = re.compile(r"\s*(?:#|%|//)+\s*"), re.compile(r"\s*(?:%|//)")
_BETWEEN = re.compile(r"[\s,;\[\]()]+")


def count_preamble(sample: Sequence[str], *, padded: bool = False) -> int:
    """Count the lines of metadata above equal rows of numbers that are wider than the first line.

    padded: Whether empty cells follow the text of such a line, as in spreadsheets; a header must be
        below.
    """
    top = sample[:_MAX_PREAMBLE]
    for delimiter in DELIMITERS[:-1] if padded else DELIMITERS:
        lines = [line.rstrip(f"{delimiter} \r\n") if padded else line for line in top]
        widths = [0 if is_skipped(s, delimiter) else len(_split(s, delimiter)) for s in lines]
        first = next((width for width in widths if width), 0)
        wide = (i for i, width in enumerate(widths) if width > first + 1)
        start = next((i for i in wide if _is_numeric(top[i], delimiter)), None)
        if start is None:
            continue
        rows = range(start, min(start + _MIN_UNIFORM_ROWS, len(top)))
        alike = all(widths[i] == widths[start] and _is_numeric(top[i], delimiter) for i in rows)
        if alike and len(rows) == _MIN_UNIFORM_ROWS:
            named = int(abs(widths[start - 1] - widths[start]) <= 1)
            cells = [_split(line, delimiter) for line in top[max(start - 2, 0) : start + 1]]
            if named and len(cells[-2]) > 1 and not _looks_like_header(delimiter, *cells[-2:]):
                return start - 1  # a word in the first line of readings
            if named and len(cells) == 3 and widths[start - 2] == widths[start]:
                named += _are_units(cells[1], cells[2], delimiter)
            if named or not padded:
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

    Files of anisomap, with their own delimiter, have a header and only numbers below. Other files
    may contain text around the numbers: see `anisomap.io.parsing.lines`.
    """
    if own_delimiter:
        return replace(_find_columns(path, sample, 0, own_delimiter), ended=True)
    found = _find_objects(path, sample) or _find_nested(path, sample) or _find_blocks(path, sample)
    if found:
        return found
    sample = _with_header(["" if _RULE.fullmatch(line) else line for line in sample])
    preamble = count_preamble(sample) or count_preamble(sample, padded=True)
    table = _find_columns(path, sample[preamble:], preamble, None)
    above = {line.strip() for line in sample[: table.first_line - 1] if not is_apart(line)}
    header = _split(sample[preamble - 1], table.delimiter) if preamble else []
    if 2 < 2 * len(header) == table.n_columns and table.delimiter == ",":
        problem = "commas are decimal and separate fields, too"
        raise RefusedError(f"{path}: {problem}; save it with semicolons")
    numeric = (i for i in range(preamble) if _is_numeric(sample[i], table.delimiter))
    if not table.skipped and (first := next(numeric, -1)) >= 0:
        shown = quote(sample[first].strip())
        table = replace(table, skipped=f"the lines above line {preamble + 1}, such as {shown}")
    return replace(table, above=frozenset(above))


def _with_header(sample: Sequence[str]) -> Sequence[str]:
    """Uncover a header in a comment: the last comment line above the first line of data."""
    marked = [*itertools.takewhile(lambda line: _COMMENT.match(line) or not line.strip(), sample)]
    if not 0 < len(marked) < len(sample):
        return sample
    header = _COMMENT.sub("", marked[-1], count=1)
    below = [line for line in sample[len(marked) :] if not is_skipped(line)][:_MIN_UNIFORM_ROWS]
    delimiter = find_delimiter(below)
    widths = {len(fields) for _, fields in all_records(below, delimiter)}
    names = next((fields for _, fields in all_records([header], delimiter)), [])
    numbered = all(_DIGITS.search(name) for name in names)
    # A remark may have as many words as the table has columns.
    few = len(names) < (_MIN_LISTED if delimiter or numbered else _MAX_REMARK)
    if few or widths != {len(names)} or any(is_number(name, delimiter) for name in names):
        return ["" if _MARKED.match(line) else line for line in marked] + [*sample[len(marked) :]]
    return [*("\n" for _ in marked[:-1]), header, *sample[len(marked) :]]


def _find_columns(
    path: Path, sample: Sequence[str], preamble: int, own_delimiter: str | None
) -> Table:
    """Find the columns of a table below its header, or of lines with text between numbers."""
    delimiter = own_delimiter or find_delimiter(sample)
    framed = delimiter == "|" and sum(s.lstrip()[:1] == "|" for s in sample) > len(sample) / 2
    if framed:
        sample = list(map(_unframed, sample))
    found = list(itertools.islice(all_records(sample, delimiter), SAMPLE_RECORDS))
    found = found or list(itertools.islice(records(sample, delimiter), 1))  # or its error
    rows = [fields for _, fields in found]
    every = rows if own_delimiter else [fields for _, fields in all_records(sample, delimiter)]
    clocks = () if own_delimiter else _columns_of(rows, every, _is_clock)
    text = () if own_delimiter else _text_columns(every, delimiter, rows, clocks)
    numeric = [[f for i, f in enumerate(r) if i not in (*text, *clocks)] for r in rows[:2]]
    has_header = bool(rows) and (bool(own_delimiter) or _looks_like_header(delimiter, *numeric))
    around = not own_delimiter and bool(rows) and _holds_text(rows, text, delimiter)
    if around and (lines := _find_lines(path, sample, preamble)):
        return lines
    header, body = (rows[0], rows[1:]) if has_header else ([], rows)
    if header and body and not header[0].strip() and all(is_missing(row[0]) for row in body if row):
        text = (0, *text)  # a column without a name and cells
    header, n_below, skipped = _rows_below(header, [] if own_delimiter else body, delimiter)
    body = body[n_below:]
    width, empty = (len(body[0]), empty_columns(body)) if body else (0, 0)
    if header:
        named = header[: len(header) - empty_columns([header])]
        if len(header) + 1 == width and not empty and _are_row_names(body):
            header = named = ["", *header]
        trailing = width - len(named)
        header, trailing = (named, trailing) if 0 <= trailing <= empty else (header, 0)
        n_columns = len(header) if body else 0
        because = f"the header names {n_columns}"
        first = found[1 + n_below][0] if body else len(sample) + 1
    else:
        n_columns, trailing, first = width - empty, empty, 1
        because = f"line {preamble + found[0][0] if found else 0} has {n_columns}"
    clean = functools.partial(_clean, delimiter, trailing, framed=framed)
    shape = (n_columns, because, preamble + first, tuple(header))
    table = Table(path, delimiter, *shape, clean if delimiter != "," or trailing else None)
    return replace(table, text_columns=text, clocks=clocks, skipped=skipped)


def _unframed(line: str) -> str:
    """Remove the first and the last bar of a line."""
    return line.strip().removeprefix("|").removesuffix("|")


def _clean(delimiter: str | None, n_trailing: int, line: str, *, framed: bool = False) -> str:
    """Replace decimal commas by points, and drop trailing delimiters."""
    if framed:
        line = _unframed(line)
    if delimiter != ",":
        line = line.replace(",", ".")
    for _ in range(n_trailing):
        line = line.rstrip(" \r\n").removesuffix(delimiter or "")
    return line


def _columns_of(
    rows: Sequence[Sequence[str]], every: Sequence[Sequence[str]], fits: Callable[[str], bool]
) -> tuple[int, ...]:
    """Find at least two columns in which all cells below the first record fit."""

    def fitting(some: Sequence[Sequence[str]], columns: Iterable[int]) -> list[int]:
        cells = ((i, [r[i] for r in some if i < len(r) and not is_missing(r[i])]) for i in columns)
        return [i for i, held in cells if len(held) >= _MIN_TEXT_CELLS and all(map(fits, held))]

    # A header may name fewer columns than a damaged row has.
    columns = fitting(rows[1:], range(len(rows[0]) if rows else 0))
    return tuple(fitting(every[1:], columns)) if columns else ()


def _text_columns(
    every: Sequence[Sequence[str]],
    delimiter: str | None,
    rows: Sequence[Sequence[str]],
    clocks: Sequence[int],
) -> tuple[int, ...]:
    """Find columns with only text below the first record, which may be a header."""
    found = _columns_of(
        rows, every, lambda c: not is_number(c, delimiter) and (is_label(c) or is_list(c))
    )
    sums = _columns_of(rows, every, lambda c: bool(SUM.fullmatch(c.strip())))
    for i in sums:
        cells = [is_number(row[i], delimiter) for row in rows[1:] if i < len(row)]
        found += (i,) * (sum(cells) < _MOST_DECIMAL * len(cells))
    found = tuple(i for i in sorted({*found}) if i not in clocks)
    # A file without a column of numbers gives an error about its first cell instead.
    return found if rows and len(found) + len(clocks) < len(rows[0]) else ()


def _holds_text(
    rows: Sequence[Sequence[str]], skipped: Sequence[int], delimiter: str | None
) -> bool:
    """Return whether cells contain text around numbers, or no cell below the first is a number.

    skipped: Columns of text. Names with digits in them (``S01``) may be values (``A12 B7``), unless
    a header names their column.
    """
    every = (cell.partition("#")[0] for row in rows[1:] or rows for cell in row)
    cells = [cell for cell in every if not is_missing(cell)]
    others = [cell for cell in cells if not (is_number(cell, delimiter) or _is_clock(cell))]
    if any(not is_label(cell) and (delimiter is None or not is_list(cell)) for cell in others):
        return True
    numbered = [i for i in skipped if i < len(rows[0]) and _DIGITS.search(rows[0][i])]
    forms = ([_DIGITS.sub("0", row[i]) for row in rows[:2] if i < len(row)] for i in numbered)
    alike = [i for i, held in zip(numbered, forms, strict=True) if len({*held}) == 1]
    vary = any(len({row[i] for row in rows if i < len(row)}) > 1 for i in alike)
    return vary or len(alike) > 1 or len(others) == len(cells)


def _find_objects(path: Path, sample: Sequence[str]) -> Table | None:
    """Find lines that contain one JSON object each; the first line may be cut off."""
    filled = [each for each in enumerate(sample, start=1) if not is_apart(each[1])]
    for start in range(min(2, len(filled))):
        if objects := as_objects([line for _, line in filled[start : start + 2]]):
            names, convert = objects
            return _of_lines(path, filled, start, names, convert=convert)
    return None


def _find_lines(path: Path, sample: Sequence[str], preamble: int) -> Table | None:
    """Find a layout of lines with text around the numbers."""
    numbered = enumerate(sample, start=1 + preamble)
    filled = [(number, line) for number, line in numbered if not is_apart(line)]
    lines = [line.partition("#")[0] for _, line in filled]
    template = find_template(lines)
    if template is None:
        return None
    start = lines.index(template.example)
    names, header = template.names, _header_of(template, lines[start - 1 : start])
    named = bool(header) and not all(names)
    names = tuple(header) if named else names
    table = _of_lines(path, filled, start, names, convert=template, n_headers=int(named))
    if "" in template.fixed.values():
        apart = "constant numbers outside the list of readings"
        table = replace(table, skipped=" and ".join(filter(None, (table.skipped, apart))))
    return table


def _header_of(template: Template, above: Sequence[str]) -> list[str]:
    """Return the names in the line above the values, below a terminal's clock; else none."""
    fields = next(records(above, find_delimiter(above)), (0, []))[1] if above else []
    if fields and template.clocks == {0} and len(fields) == template.n_values - 1:
        _, mark, first = fields[0].partition(template.texts[1])
        fields = ["", first if mark else fields[0], *fields[1:]]
    if len(fields) != template.n_values or any(map(is_number, fields[1:])):
        return []
    return [field.strip() for field in fields]


def _of_lines(
    path: Path,
    filled: Sequence[Numbered],
    start: int,
    names: tuple[str, ...],
    *,
    convert: Callable[[str], str],
    n_headers: int = 0,
) -> Table:
    """Return the layout of the lines from `start` that are not skipped."""
    number = filled[start][0]
    above = [quote(line.strip()) for _, line in filled[: start - n_headers]]
    return Table(
        path,
        None,
        len(names),
        f"line {number} has {len(names)}",
        number,
        names,
        lambda line: "" if is_apart(line) else convert(line.partition("#")[0]),
        clocks=tuple(sorted(convert.clocks)) if isinstance(convert, Template) else (),
        numeric=",",
        skipped=f"lines at the start: {join_items(above, 1)}" if above else "",
    )


def _is_clock(cell: str) -> bool:
    return parse_clock(cell) is not None


def is_list(cell: str) -> bool:
    """Return whether a cell contains a list of at least three numbers and no other text."""
    fields = [field for field in _BETWEEN.split(cell) if field]
    return len(fields) >= _MIN_LISTED and all(map(is_number, fields))


def _are_row_names(body: Sequence[Sequence[str]]) -> bool:
    """Return whether the first column contains row names, whose header R and pandas omit."""
    first = [row[0] for row in body]
    count = _MIN_UNIFORM_ROWS
    numbered = any(first == [str(k + i) for k in range(len(body))] for i in (0, 1))
    return len(body) >= count and (numbered or not any(map(is_number, first)))


def _are_units(row: Sequence[str], following: Sequence[str], delimiter: str | None) -> bool:
    """Return whether a row below the header gives units: text above a row of numbers."""
    cells = [i for i, cell in enumerate(row) if not is_missing(cell)]
    text = [
        i for i in cells if not is_number(row[i], delimiter) and len(row[i].strip()) < _MAX_UNIT
    ]
    below = [i for i in text if i < len(following) and is_number(following[i], delimiter)]
    return bool(cells) and len(text) == len(cells) and len(row) == len(following) and bool(below)


def _rows_below(
    header: list[str], body: Sequence[Sequence[str]], delimiter: str | None
) -> tuple[list[str], int, str]:
    """Return the whole header, the number of rows below it that are no readings, and their kind.

    Such a row gives units, or numbers columns of equal names, like a second header of pandas; or
    rows count, are two rows of a lattice, or have fractions above whole numbers.
    """
    if not header or len(body) < 2:
        return header, 0, ""
    if _are_units(body[0], body[1], delimiter):
        return header, 1, "a row of units"
    if _are_numbers_of(header, body[0]):
        pairs = zip(header, body[0], strict=True)
        return [f"{name}.{number}" if name else "" for name, number in pairs], 1, ""
    n_apart = _count_apart(body)
    shown = f"rows unlike the others: {n_apart}, from {join_items(body[0], 4)} on"
    return header, n_apart, shown if n_apart else ""


def _are_numbers_of(header: Sequence[str], row: Sequence[str]) -> bool:
    """Return whether a row numbers columns of equal names, like a second header of pandas."""
    counts = Counter(name for name in header if name.strip())
    numbers = [number for name, number in zip(header, row, strict=False) if name.strip()]
    if len(header) != len(row) or not counts or min(counts.values()) < 2:
        return False
    expected = ([str(i + k) for n in counts.values() for i in range(n)] for k in (0, 1))
    return sorted(numbers) in map(sorted, expected)


def _count_apart(body: Sequence[Sequence[str]]) -> int:
    """Count rows that are not readings: numbers, places or gains of the sensors."""
    if len(body) < _MIN_COMPARED or len(body[0]) < _MIN_PLACES:
        return 0
    places = [[parse_number(c) if is_number(c) else np.nan for c in row] for row in body[:2]]
    steps = [{*np.diff(sorted({*row})).round(6).tolist()} for row in places]
    cells, fewest = {*zip(*places, strict=False)}, min(len({*row}) for row in places)
    if [len(each) for each in steps] == [1, 1] and fewest > 2 and len(cells) == len(body[0]):
        return 2
    whole = not any(set(cell) & set(".,") for row in body[1:] for cell in row)
    fractions = whole and bool(np.mean(np.mod(places[0], 1) > 0) > 0.5)
    return int(_counts(body[0]) or fractions)


def _find_nested(path: Path, sample: Sequence[str]) -> Table | None:
    """Find frames whose brackets span several lines, as in printed arrays."""
    lines = [line for line in sample if not is_skipped(line)]
    first = next((i for i, line in enumerate(lines) if depth_of(line) > 0), None)
    if first is None or first > _MIN_UNIFORM_ROWS or lines[first].lstrip()[:1] == "{":
        return None
    joined, held, depth = list[str](), list[str](), 0
    for line in lines[first:]:
        held.append(line.strip())
        depth += depth_of(line)
        if depth <= 0:
            joined.append(" ".join(held))
            held = []
    template = find_template(joined) if len(joined) >= _MIN_NESTED else None
    if template is None:
        return None
    number = 1 + next(i for i, line in enumerate(sample) if line == lines[first])
    n_rows = _inner_rows(joined[0])
    fits = n_rows and template.n_values % n_rows == 0 and not any(template.names)
    block = (n_rows, template.n_values // n_rows) if fits else None
    table = _of_lines(path, [(number, "")], 0, template.names, convert=template)
    return replace(table, block=block, nested=True)


def _inner_rows(frame: str) -> int:
    """Return the number of rows of a printed matrix; 0 for a list."""
    inner = re.findall(r"\[[^\[\]]*\]", frame)
    return len(inner) if len(inner) > 1 and frame.count("[") == len(inner) + 1 else 0


def _find_blocks(path: Path, sample: Sequence[str]) -> Table | None:
    """Find frames of several lines, between empty lines, comments, words or single numbers."""
    parts = [(apart, [*lines]) for apart, lines in itertools.groupby(sample, divides)]
    groups = [lines for apart, lines in parts if not apart]
    between = [lines for apart, lines in parts[1:-1] if apart]
    # Words or empty lines alone are no evidence: a board may send occasional messages.
    titles = [" ".join(line for line in lines if not is_apart(line)) for lines in between]
    above = parts[0][1] if parts and parts[0][0] else []
    numbers = [int(digits[0]) for digits in map(_DIGITS.search, titles) if digits]
    rising = len(numbers) == len(titles) and all(map(operator.lt, numbers, numbers[1:]))
    marked = not all(map(is_apart, above)) and (
        rising or all(len({*map(is_apart, lines)}) > 1 for lines in between)
    )
    whole = groups[:-1] if len(groups) > _MIN_BLOCKS else groups  # the last one may be cut short
    heights = set(map(len, whole))
    if len(whole) < _MIN_BLOCKS or len(heights) != 1 or not 1 < (height := heights.pop()) <= _TALL:
        return None
    messages = any(titles) and not marked
    for delimiter in DELIMITERS:
        lines = itertools.chain.from_iterable(whole)
        rows = [_split(_unframed(s) if delimiter == "|" else s, delimiter) for s in lines]
        widths, empty = set(map(len, rows)), empty_columns(rows)
        numeric = all(is_number(cell, delimiter) for row in rows for cell in row)
        n_columns = min(widths) - empty
        headers = [] if delimiter is None else above[-1:]
        named = (_split(line, delimiter) for line in itertools.chain(headers, *between))
        names = any({len(s)} == widths and not any(map(is_number, s)) for s in named)
        if len(widths) == 1 and numeric and n_columns > 1 and not names:
            first = next(i for i, line in enumerate(sample) if not divides(line))
            cells = [[parse_number(c, delimiter) for c in row[:n_columns]] for row in rows]
            blocks = np.array(cells).reshape(len(whole), height, n_columns)
            doubt = "" if marked else _doubt_of(blocks)
            if messages and (doubt or height > _MOST_ROWS):
                return None
            return Table(
                path,
                delimiter,
                height * n_columns,
                f"the first block has {height} x {n_columns}",
                first + 1,
                clean=functools.partial(_clean, delimiter, 0) if delimiter != "," else None,
                block=(height, n_columns),
                doubt=doubt,
            )
    return None


def _doubt_of(blocks: NDArray[np.float64]) -> str:
    """Return a question if blocks, (t, rows, columns), may be recordings instead of frames."""
    changes = [float(np.nanmean(np.abs(np.diff(blocks, axis=axis)))) for axis in (0, 1)]
    if changes[1] >= _CONTINUOUS * changes[0]:
        return ""
    size = "{}x{}".format(*blocks.shape[1:])
    problem = f"blocks of {size} numbers change less within blocks than from one to the next"
    remedy = "if each block is a frame, or remove these lines if each line is a frame"
    return f"{problem}: give --grid {size} {remedy}"


def _looks_like_header(
    delimiter: str | None, first: Sequence[str], second: Sequence[str] = ()
) -> bool:
    numbers = [field for field in first if is_number(field, delimiter)]
    if len(numbers) < len(first):  # some may be words in a line of readings
        pairs = zip(first, second, strict=False)
        named = [c for f, c in pairs if not is_number(f, delimiter)]
        above = bool(named) and not any(is_missing(c) or not is_number(c, delimiter) for c in named)
        return above or 2 * len(numbers) <= len(first) or len({*numbers}) == len(numbers)
    if first and not first[0].strip():
        first, second = first[1:], second[1:]
    return _counts(first) and not (second and _counts([*first, second[0]]))


def _counts(fields: Sequence[str]) -> bool:
    """Return whether fields are 0, 1, 2, ... or 1, 2, 3, ...: default labels of data frames."""
    counted = ([str(i + start) for i in range(len(fields))] for start in (0, 1))
    return len(fields) >= _MIN_COUNTED and [*map(str.strip, fields)] in counted
