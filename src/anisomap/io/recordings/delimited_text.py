"""Recordings as delimited text, with one line per frame and one column per sensor.

`anisomap.io.parsing.delimited` detects delimiter, decimal comma, header and columns of text, which
are skipped; `anisomap.io.parsing.columns` detects times and frame counters. Files may be gzipped.
All readings of a frame may also be a list in one quoted cell, as here of two mats::

    Timestamp,left,right
    0.1,"0,0,3,4,0,0","0,1,3,4,0,0"
"""

from __future__ import annotations

import csv
import dataclasses
import functools
import io
import itertools
import logging
import re
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, FileError, InputError
from anisomap.io.parsing import delimited
from anisomap.io.parsing import facts as comments
from anisomap.io.parsing.columns import (
    ROWS_LOOKED_AT,
    Roles,
    roles_by_content,
    roles_by_name,
    warn_of_guesses,
)
from anisomap.io.parsing.source import (
    GZIP_ERRORS,
    is_gzipped,
    open_text,
    open_text_with_progress,
    quote,
    quote_if_needed,
)
from anisomap.io.parsing.table import (
    LineError,
    Lines,
    Table,
    first_rows,
    least_rows,
    line_of,
    parse_number,
    read_blocks,
)
from anisomap.io.recordings import contacts
from anisomap.io.recordings import spikes as spike_tables
from anisomap.io.stream import (
    BLOCK_BYTES,
    Block,
    Content,
    ReadOptions,
    Stream,
    choose,
    salvage,
    to_float32_if_exact,
)
from anisomap.memory import SENSOR_BYTES, Budget, bytes_kept
from anisomap.recording import Recording, Scalar
from anisomap.wording import join_items

_ROWS_LOOKED_AT = 50
# A cell of two numbers with a comma may be one number with a decimal comma.
_MIN_LENGTH, _MIN_ROWS = 3, 2
_BETWEEN = re.compile(r"[\s,;\[\]()]+")


@dataclass(frozen=True)
class ListColumn:
    """A column of lists.

    column: From 0.
    length: Number of readings per list.
    """

    column: int
    length: int


def find_list_columns(sample: Sequence[str], layout: delimited.Layout) -> dict[str, ListColumn]:
    """Find the columns with lists of equal length in all rows."""
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
    """Create a stream of the lists of a column."""
    named = chosen.column < len(table.names)
    name = table.names[chosen.column].strip() if named else str(chosen.column + 1)
    return Stream(
        table.path,
        chosen.length,
        salvage(_blocks_of_lists(table, chosen, roles, preamble), table.path, GZIP_ERRORS),
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


def _blocks_of_lists(
    table: Table, chosen: ListColumn, roles: Roles, preamble: int
) -> Iterator[Block]:
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


TITLE = "anisomap recording"
MAP_TITLE = "anisomap map"
"""First words of files written by anisomap, after ``#``."""

SIGNATURE = b"# anisomap "

_MAX_NAME_LINES = 500  # of the lines from which the layout of a table is detected
_MAX_CLOCKS = 2  # columns that are a time or a frame counter
_TIME_COLUMN = "time_s"
_DELIMITERS = {"separated by commas": ",", "separated by tabs": "\t"}
_IN_FIRST_COLUMN, _NO_TIMES = "first column, seconds", "none"
_WITH_COMMA = re.compile(r"(?<![\d.,])\d++,\d++(?![\d.,])")
_THOUSANDS = re.compile(r"[1-9]\d{0,2},\d{3}")
_logger = logging.getLogger(__name__)


def recognises(path: Path, head: bytes) -> bool:
    """Recognise any text; this format is tried last."""
    return bool(head) and b"\0" not in head


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open a recording in delimited text.

    Empty fields are missing readings, NaN. The metadata of the stream names the columns taken as
    time and frame counter and the skipped columns of text. Errors give line and column.
    """
    if contacts.selects_columns(options.select):
        yield contacts.stream_columns(path, options)
        return
    sample, known, metadata = _read_start(path)
    if options.bin_s is not None and not known:
        yield spike_tables.stream_table(path, options.bin_s)
        return
    preamble = 0 if known else delimited.count_preamble(sample)
    layout = delimited.find_layout(
        sample[preamble:], own_delimiter=_DELIMITERS.get(str(known.get("fields")), "")
    )
    budget = Budget(path)
    n_least = layout.n_columns - len(layout.text_columns) - _MAX_CLOCKS
    budget.check(SENSOR_BYTES * n_least, "its list of sensors")
    if not known and (lists := find_list_columns(sample[preamble:], layout)):
        table = _table(path, layout, sample, preamble)
        chosen = choose(path, contents_of_lists(lists), options.select, "list column")
        yield stream_lists(
            table, lists[chosen.name], _roles_beside_lists(table, lists), preamble=preamble
        )
        return
    if options.select:
        raise FileError(
            f"{path} (delimited text) holds a single recording; leave out --select "
            f"{options.select}, or select the columns of a time and of sensors, as in time:id"
        )
    if not layout.n_columns:
        content = "only a header" if layout.header else "no line of numbers"
        raise FileError(f"{path} holds {content}; it must have one line of numbers per frame")
    table = _table(path, layout, sample, preamble)
    parse_name = delimited.unguard_formula if known else str.strip
    names = tuple(map(parse_name, layout.header))
    _warn_of_text(table)
    if not known and layout.delimiter != ",":
        _warn_of_commas(path, sample[preamble:])
    roles = _own_roles(known) if known else _detected_roles(table, names)
    if len(roles.non_sensors) == layout.n_columns:
        raise FileError(f"{path} holds times or a frame counter, but no sensor")
    if is_gzipped(path):
        # Counting lines is far faster than parsing them, and takes no memory.
        n_rows = least_rows(path) - table.first_line
        n_readings = n_rows * (layout.n_columns - len(roles.non_sensors))
        budget.check(n_readings * bytes_kept(np.dtype(np.float32)), "its table of readings")
    rate_hz = known.get("rate_hz")
    yield Stream(
        path,
        layout.n_columns - len(roles.non_sensors),
        salvage(_blocks(table, roles), path, GZIP_ERRORS),
        names=tuple(name for i, name in enumerate(names) if i not in roles.non_sensors),
        rate_hz=float(rate_hz) if isinstance(rate_hz, int | float) else None,
        source=str(known.get("source", path.name)),
        metadata=metadata if known else _column_metadata(table, roles),
        locate=None if known else functools.partial(line_of, table),
    )


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the columns that hold a list of readings per frame; empty for a table of numbers."""
    sample, known, _ = _read_start(path)
    preamble = 0 if known else delimited.count_preamble(sample)
    layout = delimited.find_layout(sample[preamble:])
    return () if known else contents_of_lists(find_list_columns(sample[preamble:], layout))


def write_recording(recording: Recording, path: Path) -> None:
    """Write a recording as text: comments, a header, and one line per frame.

    Times are the first column, in seconds. Readings, names, times, rate and metadata are read back
    equal. Positions are not written, with a warning. Suffix ``.tsv`` selects tabs, others commas.
    """
    delimiter = "\t" if path.suffix.lower() == ".tsv" else ","
    if recording.positions is not None:
        warnings.warn(
            f"{path.suffix} cannot store positions, so those of the recording are not written; "
            "use .npz to keep them",
            AnisomapWarning,
            stacklevel=2,
        )
    with path.open("w", encoding="utf-8", newline="") as stream:
        stream.write(
            header_text(
                recording.names,
                delimiter=delimiter,
                source=recording.source,
                timed=recording.times is not None,
                rate_hz=recording.rate_hz,
                metadata=recording.metadata,
            )
        )
        for frame, readings in enumerate(recording.readings):
            values = readings.tolist()
            if recording.times is not None:
                values.insert(0, float(recording.times[frame]))
            stream.write(delimiter.join(map(repr, values)) + "\n")


def header_text(
    names: Sequence[str],
    *,
    delimiter: str = ",",
    source: str = "",
    timed: bool = True,
    rate_hz: float | None = None,
    metadata: Mapping[str, Scalar] | None = None,
) -> str:
    """Format the lines of a recording before its first frame.

    Each following line is one frame: the time in seconds if `timed`, then one reading per sensor,
    separated by `delimiter`. A file can therefore be extended frame by frame.
    """
    if sum(name.count("\n") for name in names) > _MAX_NAME_LINES:
        raise InputError("the names have too many line ends for a header of text; use .npz")
    fields = next(name for name, mark in _DELIMITERS.items() if mark == delimiter)
    entries: list[tuple[str, Scalar]] = [
        ("fields", fields),
        ("source", source),
        ("times", _IN_FIRST_COLUMN if timed else _NO_TIMES),
    ]
    if rate_hz is not None:
        entries.append(("rate_hz", rate_hz))
    text = io.StringIO(newline="")
    text.write(comments.write_comments(TITLE, entries, "metadata", metadata or {}))
    csv.writer(text, delimiter=delimiter, quoting=csv.QUOTE_ALL, lineterminator="\n").writerow(
        map(delimited.guard_formula, (_TIME_COLUMN, *names) if timed else names)
    )
    return text.getvalue()


def _read_start(path: Path) -> tuple[list[str], dict[str, Scalar], dict[str, Scalar]]:
    """Read the first lines, and the entries and metadata of a file written by anisomap."""
    with open_text(path) as stream:
        sample = delimited.read_sample(stream)
    if _is_titled(sample, MAP_TITLE):
        raise FileError(f"{path} is a map, not a recording; read it with read_map")
    return sample, *_own_comments(sample)


def _is_titled(sample: list[str], title: str) -> bool:
    return bool(sample) and sample[0].startswith(f"# {title}")


def _own_comments(sample: list[str]) -> tuple[dict[str, Scalar], dict[str, Scalar]]:
    """Read entries and metadata from the comments of a file written by anisomap."""
    if not _is_titled(sample, TITLE):
        return {}, {}
    leading = itertools.takewhile(lambda line: line.startswith("#"), sample)
    entries, metadata = comments.read_comments(leading, "metadata")
    return dict(entries), metadata


def _table(path: Path, layout: delimited.Layout, sample: list[str], preamble: int) -> Table:
    if layout.header:
        because = f"the header names {layout.n_columns}"
    else:
        first = next(delimited.records(sample[preamble:], layout.delimiter))[0]
        because = f"line {preamble + first} has {layout.n_columns}"
    table = Table(
        path,
        layout.delimiter,
        layout.n_columns,
        because,
        preamble + layout.first_line,
        layout.header,
        text_columns=layout.text_columns,
    )
    unchanged = layout.delimiter == "," and not layout.trailing
    return table if unchanged else dataclasses.replace(table, clean=layout.clean)


def _own_roles(known: dict[str, Scalar]) -> Roles:
    timed = known.get("times") == _IN_FIRST_COLUMN
    return Roles(time=0, non_sensors=(0,)) if timed else Roles()


def _detected_roles(table: Table, names: tuple[str, ...]) -> Roles:
    start = first_rows(table, ROWS_LOOKED_AT)
    numeric = [i for i in range(table.n_columns) if i not in table.text_columns]
    if names:
        roles = roles_by_name([names[i] for i in numeric], start[:, numeric])
    else:
        roles = roles_by_content(start[:, numeric])
    roles = dataclasses.replace(
        roles,
        time=None if roles.time is None else numeric[roles.time],
        counter=None if roles.counter is None else numeric[roles.counter],
        non_sensors=tuple(sorted([*(numeric[i] for i in roles.non_sensors), *table.text_columns])),
        guessed=tuple(numeric[i] for i in roles.guessed),
    )
    warn_of_guesses(table.path, names, roles)
    return roles


def _roles_beside_lists(table: Table, lists: Mapping[str, ListColumn]) -> Roles:
    columns = {each.column for each in lists.values()}
    text = tuple(sorted({*table.text_columns, *columns}))
    if len(text) == table.n_columns:
        return Roles()
    return _detected_roles(dataclasses.replace(table, text_columns=text), table.names)


def _warn_of_commas(path: Path, sample: list[str]) -> None:
    """Warn if all numbers with a comma could also have thousands separators."""
    found = [match for line in sample for match in _WITH_COMMA.findall(line)]
    if found and all(_THOUSANDS.fullmatch(number) for number in found):
        warnings.warn(
            f"{path}: commas are read as decimal commas ({found[0]} as "
            f"{found[0].replace(',', '.')}); remove thousands separators from the file",
            AnisomapWarning,
            stacklevel=2,
        )


def _warn_of_text(table: Table) -> None:
    if not table.text_columns:
        return
    columns = join_items([_column_label(table, column) for column in table.text_columns])
    warnings.warn(
        f"{table.path}: skipped text in {columns}",
        AnisomapWarning,
        stacklevel=2,
    )


def _column_label(table: Table, column: int) -> str:
    name = quote_if_needed(table.names[column].strip()) if table.names else "no header"
    return f"column {column + 1} ({name})"


def _blocks(table: Table, roles: Roles) -> Iterator[Block]:
    for values, fraction in read_blocks(table):
        times = None if roles.time is None else values[:, roles.time] / roles.per_second
        yield Block(
            to_float32_if_exact(np.delete(values, roles.non_sensors, axis=1)), fraction, times
        )


def _column_metadata(table: Table, roles: Roles) -> dict[str, Scalar]:
    """Name the columns that are not sensors, in the metadata and in the log."""
    metadata: dict[str, Scalar] = {}
    for key, column in (("time_column", roles.time), ("counter_column", roles.counter)):
        if column is None:
            continue
        metadata[key] = _column_label(table, column)
        _logger.info("%s: %s is the %s", table.path, metadata[key], key.replace("_", " "))
    if table.text_columns:
        metadata["text_columns"] = ", ".join(_column_label(table, i) for i in table.text_columns)
    return metadata
