"""Parquet and Arrow (Feather) files: a column of lists, or one column per sensor.

Datasets for robot learning store the readings of a frame as a list (``observation.tactile``), and
times in a column ``timestamp``, which restarts from 0 in every episode.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.base.clocks import is_time, units_per_second
from anisomap.base.wording import counted
from anisomap.errors import FileError, import_extra
from anisomap.files.paths import open_regular
from anisomap.io.parsing.names import ROWS_LOOKED_AT, roles_by_name, warn_of_guesses, with_kept
from anisomap.io.parsing.source import quote
from anisomap.io.stream import BLOCK_BYTES, Block, Content, ReadOptions, Stream, choose

EXTRA = "parquet"

MAGICS = (_PARQUET := b"PAR1", _FEATHER := b"ARROW1\0\0")
_IPC_STREAM = b"\xff\xff\xff\xff"
_STREAM_SUFFIXES = (".arrow", ".arrows", ".ipc", ".feather")
_MAX_ROWS = 8192
_EPISODE = "episode_index"
_ALL_COLUMNS = "columns"


_Batches: TypeAlias = Iterator[tuple[Any, float]]
"""Record batches, each with the fraction of the file read so far, from 0 to 1."""


@dataclass(frozen=True)
class _Source:
    """An open file; `batches(names)` reads some columns."""

    path: Path
    schema: Any
    batches: Callable[[Sequence[str]], _Batches]


def recognises(path: Path, head: bytes) -> bool:
    """Recognise a stream of Arrow, whose magic number is not enough, by its suffix as well."""
    return head.startswith(_IPC_STREAM) and path.suffix.lower() in _STREAM_SUFFIXES


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the columns; without columns of lists, all numeric columns are one recording."""
    with _open(path) as source:
        return _contents(source)


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open the column of lists `options.select`, or ``columns`` for all numeric columns."""
    with _open(path) as source:
        name = choose(path, _contents(source), options.select, "column").name
        plain = _plain_columns(source.schema)
        _check_unique(path, [name, *plain], source.schema.names)
        if name == _ALL_COLUMNS and name not in source.schema.names:
            yield _of_columns(source, plain, options.keep)
        else:
            yield _of_lists(source, name, plain)


@contextmanager
def _open(path: Path) -> Iterator[_Source]:
    # Files are not memory-mapped: the system kills a process that reads a mapped file after it was
    # cut.
    with open_regular(path) as stream:
        magic = stream.read(len(_FEATHER))
        stream.seek(0)
        if magic.startswith(_PARQUET):
            parquet = import_extra("pyarrow.parquet", "reading Parquet", EXTRA)
            with parquet.ParquetFile(stream, pre_buffer=False) as file:
                yield _Source(path, file.schema_arrow, partial(_of_parquet, file))
            return
        arrow = import_extra("pyarrow", "reading Arrow", EXTRA)
        if magic.startswith(_FEATHER):
            # The file format is the streaming format between this number and an index.
            stream.seek(len(_FEATHER))
        reader = arrow.ipc.open_stream(stream)
        size = max(path.stat().st_size, 1)
        yield _Source(path, reader.schema, partial(_of_arrow, reader, lambda: stream.tell() / size))


def _of_parquet(file: Any, names: Sequence[str]) -> _Batches:
    total, done = max(file.metadata.num_rows, 1), 0
    for number in range(file.num_row_groups):
        group = file.metadata.row_group(number)
        n_values = sum(group.column(i).num_values for i in range(group.num_columns))
        rows = max(1, min(_MAX_ROWS, BLOCK_BYTES // 8 * group.num_rows // max(n_values, 1)))
        for batch in file.iter_batches(rows, row_groups=[number], columns=list(names)):
            done += batch.num_rows
            yield batch, done / total


def _of_arrow(reader: Any, fraction: Callable[[], float], names: Sequence[str]) -> _Batches:
    for batch in reader:
        batch.validate(full=True)
        kept = batch.select(list(names))
        rows = max(1, min(_MAX_ROWS, BLOCK_BYTES * batch.num_rows // max(kept.nbytes, 1)))
        for start in range(0, batch.num_rows, rows):
            yield kept.slice(start, rows), fraction()


def _contents(source: _Source) -> tuple[Content, ...]:
    found = [
        Content(field.name, str(field.type), _list_of_numbers(field.type))
        for field in source.schema
    ]
    plain = _plain_columns(source.schema)
    if plain and not any(content.usable for content in found):
        found.append(Content(_ALL_COLUMNS, f"{counted(len(plain), 'column')} of numbers"))
    return tuple(found)


def _check_unique(path: Path, used: Sequence[str], names: Sequence[str]) -> None:
    """Reject columns of the same name, which cannot be told apart."""
    counts = Counter(names)
    for name in used:
        if counts[name] > 1:
            raise FileError(
                f"{path} has {counts[name]} columns with the name {quote(name)}; all must differ"
            )


def _is(kind: Any, *names: str) -> bool:
    types = import_extra("pyarrow.types", "reading Arrow", EXTRA)
    return any(getattr(types, f"is_{name}")(kind) for name in names)


def _is_number(kind: Any) -> bool:
    return _is(kind, "floating", "integer", "boolean")


def _is_list(kind: Any) -> bool:
    return _is(kind, "fixed_size_list", "list", "large_list")


def _list_of_numbers(kind: Any) -> bool:
    """Return whether a type is that of lists, nested or not, of numbers."""
    leaf = kind
    while _is_list(leaf):
        leaf = leaf.value_type
    return leaf is not kind and _is_number(leaf)


def _plain_columns(schema: Any) -> list[str]:
    return [field.name for field in schema if _is_number(field.type)]


def _of_lists(source: _Source, name: str, plain: Sequence[str]) -> Stream:
    kind = source.schema.field(name).type
    if not _list_of_numbers(kind):
        raise FileError(f"{source.path}: column {name} must hold lists of numbers, got {kind}")
    clock = next((column for column in plain if is_time(column)), None)
    columns = [name, *([clock] if clock else []), *([_EPISODE] if _EPISODE in plain else [])]
    first, batches = _peek(source.path, source.batches(columns))
    n_sensors = _rows(source.path, first.column(name), name, None).shape[1]
    times, rate_hz = _clock(source, first, clock)

    def blocks() -> Iterator[Block]:
        for batch, fraction in batches:
            rows = _rows(source.path, batch.column(name), name, n_sensors)
            stamps = None
            if times:
                stamps = _column(batch.column(times))
                stamps = stamps / units_per_second(times, stamps)
            yield Block(rows, fraction, stamps)

    return Stream(
        source.path,
        n_sensors,
        blocks(),
        rate_hz=rate_hz,
        source=f"{source.path.name}:{name}",
        metadata={"format": "Arrow", "column": name},
    )


def _of_columns(source: _Source, plain: Sequence[str], keep: Sequence[str]) -> Stream:
    first, batches = _peek(source.path, source.batches(plain))
    roles = roles_by_name(plain, _table(first)[:ROWS_LOOKED_AT])
    _, roles = with_kept(tuple(plain), roles, keep, len(plain))
    warn_of_guesses(source.path, plain, roles)
    kept = [name for i, name in enumerate(plain) if i not in roles.non_sensors]
    if not kept:
        raise FileError(f"{source.path} holds times or a frame counter, but no sensor")

    def blocks() -> Iterator[Block]:
        for batch, fraction in batches:
            table = _table(batch)
            rows = np.delete(table, roles.non_sensors, axis=1)
            yield Block(rows, fraction, roles.times_in(table))

    return Stream(
        source.path,
        len(kept),
        blocks(),
        names=tuple(kept),
        raw_columns=True,
        source=source.path.name,
        metadata={"format": "Arrow"},
    )


def _peek(path: Path, batches: _Batches) -> tuple[Any, _Batches]:
    """Return the first batch, and an iterator over all batches."""
    first = next(batches, None)
    if first is None:
        raise FileError(f"{path} has no frame")
    return first[0], itertools.chain([first], batches)


def _clock(source: _Source, first: Any, clock: str | None) -> tuple[str | None, float | None]:
    """Return the column of times, or only the rate if there are episodes."""
    if clock is None or _EPISODE not in first.schema.names:
        return clock, None
    times, episodes = _column(first.column(clock)), _column(first.column(_EPISODE))
    steps = np.diff(times)[np.diff(episodes) == 0]
    rate_hz = 1 / float(np.median(steps)) if steps.size and np.median(steps) > 0 else None
    return None, rate_hz


def _rows(path: Path, column: Any, name: str, n_sensors: int | None) -> NDArray[Any]:
    """Convert a column of lists, possibly nested, to rows."""
    n_rows = len(column)
    while _is_list(column.type):
        if column.null_count:
            raise FileError(f"{path}: column {name} must hold a list in every row, got null")
        column = column.flatten()
    values = _column(column)
    width = n_sensors or (len(values) // n_rows if n_rows else 0)
    if not width or len(values) != n_rows * width:
        raise FileError(
            f"{path}: the lists in column {name} differ in length; "
            "all frames must have the same number of readings"
        )
    return values.reshape(n_rows, width)


def _table(batch: Any) -> NDArray[np.float64]:
    return np.column_stack([_column(column) for column in batch.columns])


def _column(column: Any) -> NDArray[Any]:
    values: NDArray[Any] = column.to_numpy(zero_copy_only=False)
    # pyarrow converts integers and booleans with nulls to objects.
    return values.astype(np.float64) if values.dtype.kind == "O" else values
