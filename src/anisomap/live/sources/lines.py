"""Lines of text as frames, read like files: the first lines determine the layout."""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.base.columns import UNLIKE, find_others, said_of
from anisomap.base.wording import shortened
from anisomap.errors import MAX_CHARACTERS, FileError, InputError
from anisomap.io.columns import sensors_of
from anisomap.io.parsing import tables
from anisomap.io.parsing.names import ROWS_LOOKED_AT
from anisomap.io.parsing.refusals import lines_per_frame
from anisomap.io.parsing.source import RefusedError, file_errors, plain, quote, said_here
from anisomap.io.presets import grid_names, in_grid
from anisomap.io.recordings.delimited_text import layout_of, stream_of
from anisomap.io.stream import ReadOptions, doubt_of_rows
from anisomap.live.batches import Batch, Item, Names, Notice

MAX_LINE = 1 << 22
"""Maximum bytes of a line that is a frame. A frame of 100,000 sensors in JSON has fewer."""

MIN_SENSORS = 2
"""Minimum numbers in a frame."""

_LOOKED_AT, LOOKED_AT_S = 100, 2.0  # lines, or seconds, for the detection of the layout
_MAX_HELD = 1000  # lines without a frame
_LEAST_NAMES = 4  # of a header that is no other line
_COMPARED = 50  # lines, with one that may be cut
_MOST_UNREAD = 20  # successive lines that do not fit, before the layout is detected again
_MAX_BAD = 0.1  # share of the lines for the detection of the layout
_WHERE = Path("the stream")  # in errors of file readers


class LineParser:
    """Splits bytes into lines, and reads lines as `anisomap.io` reads files.

    First lines are buffered until their layout is known: a header, a time, text around numbers.
    grid: Rows and columns of a frame, if each line contains a row or a frame.
    """

    def __init__(self, grid: tuple[int, int] | None = None) -> None:
        self._options = ReadOptions(grid=grid)
        self._rest = bytearray()
        self._overlong = self._after_return = False
        self._held: list[str] = []
        self._last: list[str] = []
        self._n_filled, self._since = 0, 0.0
        self._reader: _Reader | None = None

    def feed(self, content: bytes, *, complete: bool = False) -> Iterator[Item]:
        """Parse the whole lines in the next bytes, and keep the remaining bytes."""
        if self._after_return:
            content = content.removeprefix(b"\n")
        self._after_return = content.endswith(b"\r")
        # Bytes are only appended until a line ends, since a line may arrive byte by byte.
        content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        ended, end, rest = content.rpartition(b"\n")
        lines: list[bytes] = []
        if end:
            lines = bytes(self._rest + ended).split(b"\n")
            self._rest.clear()
        self._rest += rest
        cut = complete and not content and bool(self._rest)  # perhaps
        if complete and self._rest:
            lines.append(bytes(self._rest))
            self._rest.clear()
        elif len(self._rest) > MAX_LINE:
            self._rest.clear()
            self._overlong = True
        if lines and self._overlong:  # the end of a line whose beginning was discarded
            self._overlong = False
            del lines[0]
            yield Notice(f"ignored a line of more than {MAX_LINE} bytes")
        texts = [plain(_decoded(line) + "\n") for line in lines]
        if cut and lines and tables.is_short([*self._last, *texts]):
            yield Notice(f"ignored the last line, which is cut: {quote(texts.pop())}")
        self._last = [*self._last, *texts][-_COMPARED:]
        yield from self._read(texts)

    def wait(self) -> Iterator[Item]:
        """Parse the buffered lines, if no lines have followed for long."""
        yield from self._read([])

    def end(self) -> Iterator[Item]:
        """Parse the buffered lines."""
        yield from self._read([], ended=True)

    def _read(self, lines: Sequence[str], *, ended: bool = False) -> Iterator[Item]:
        try:
            with file_errors(_WHERE):
                yield from self._items(lines, ended=ended)
                while self._reader and self._reader.others:
                    yield from self._items([], ended=ended)
        except FileError as error:
            self._reader, self._held, self._n_filled = None, [], 0
            yield Notice(f"ignored lines without a frame: {error}")

    def _items(self, lines: Sequence[str], *, ended: bool) -> Iterator[Item]:
        if self._reader:
            yield from self._reader.read(lines, ended=ended)
            if not (lines := self._reader.others):
                return
            self._reader, self._n_filled = None, 0  # a board that restarted with other names
            shown = quote(lines[0].strip())
            yield Notice(f"lines of another kind begin: {shown}")
        self._since = self._since if self._n_filled else time.monotonic()
        self._held += lines
        self._n_filled += sum(not tables.is_apart(line) for line in lines)
        waited = time.monotonic() - self._since
        if self._held and (ended or self._n_filled >= _LOOKED_AT or waited > LOOKED_AT_S):
            yield from self._found(waited, ended=ended)

    def _found(self, waited: float, *, ended: bool) -> Iterator[Item]:
        """Detect the layout of the buffered lines, and parse them."""
        problem, held = "", self._held
        # The first lines may differ: they may be cut off, or from the start of a board.
        for start in dict.fromkeys((0, 1, len(held) // 2)):
            try:
                with said_here() as said, file_errors(_WHERE):
                    self._reader = _Reader(held[start:], self._options)
            except FileError as error:
                problem = problem or error.problem
                if isinstance(error, RefusedError):
                    break
                continue
            if start > 1:
                yield Notice(f"skipped the first {start} lines: {problem}")
            self._reader.told = [text for _, text, _ in said]
            yield from map(Notice, self._reader.told)
            self._held = []
            yield from self._reader.begin(waited, ended=ended)
            return
        del held[_LOOKED_AT : max(_LOOKED_AT, len(held) - _MAX_HELD)]
        self._n_filled = 0
        yield Notice(f"no frame yet: {shortened(problem, MAX_CHARACTERS)}")


class _Reader:
    """Reads successive lines in the layout of the first lines.

    others: The lines from the first one with another layout.
    told: Warnings about the first lines.
    """

    def __init__(self, lines: Sequence[str], options: ReadOptions) -> None:
        self._table = table = layout_of(_WHERE, lines, {}, options)
        self._pending = [*tables.numbered_from(lines, table)]
        self._numbers = itertools.count(len(lines) + 1)
        self._left = left = tables.LeftOut()
        start = _parsed([*tables.frame_lines(self._pending, table)], table, left)
        if not len(start) or left.n_left > max(1, _MAX_BAD * left.n_lines):
            raise left.first or InputError("no line of numbers")
        self._left, self._n_told, self._bad = tables.LeftOut(), 0, ""
        self._seen, self._n_seen = list[NDArray[np.floating]](), 0
        self._is_late, self._ended, self._has_grid = False, False, options.grid is not None
        self._unread, self.others, self.told = list[str](), list[str](), list[str]()
        stream = stream_of(table, lines, start, self._rows, options)
        self._is_named = bool(stream.names)
        stream = in_grid(sensors_of(stream, options), options.grid)
        self._stream, self._blocks, self._names = stream, stream.blocks, stream.names
        if options.grid:
            self._names = grid_names(*options.grid)
            if len(self._names) != stream.n_sensors:
                size = f"{options.grid[0]} x {options.grid[1]}"
                raise InputError(f"lines of {stream.n_sensors} readings do not fill a {size} grid")
        if stream.n_sensors < MIN_SENSORS:
            raise InputError("no line has two readings or more")

    def begin(self, waited: float, *, ended: bool = False) -> Iterator[Item]:
        """Parse the first lines, which arrived within `waited` seconds."""
        if self._names:
            yield Names(self._names)
        for item in self.read([], ended=ended):
            if isinstance(item, Batch) and item.times is None and waited > 0:
                yield Batch(item.readings, np.linspace(0, waited, len(item.readings)))
            else:
                yield item

    def read(self, lines: Sequence[str], *, ended: bool = False) -> Iterator[Item]:
        """Parse lines; those that do not fit are left out with a notice."""
        self._ended = ended
        self._pending += zip(self._numbers, lines, strict=False)
        with said_here() as said:
            block = next(self._blocks)
        yield from (Notice(text) for _, text, _ in said)
        if len(block.readings):
            times = block.times
            is_known = times is not None and bool(np.isfinite(times).all())
            yield Batch(block.readings.astype(np.float64), times if is_known else None)
            if times is not None and not self._is_late and (np.diff(times) <= 0).any():
                self._is_late = True
                yield Notice("times do not increase; times of arrival are used instead")
        yield from self._look_again(block.readings)
        if ended and (doubt := doubt_of_rows(self._stream, self._n_seen)):
            yield Notice(doubt)
        if self._left.n_left > self._n_told and not self.others:
            self._n_told = self._left.n_left
            yield Notice(f"ignored lines without a frame: {self._n_told}, such as {self._bad}")

    def _look_again(self, readings: NDArray[np.floating]) -> Iterator[Notice]:
        """Yield notices about lines and columns, once there are enough with contacts."""
        if self._n_seen >= ROWS_LOOKED_AT:
            return
        self._seen, self._n_seen = [*self._seen, readings], self._n_seen + len(readings)
        if self._ended or self._n_seen >= ROWS_LOOKED_AT:
            rows, self._seen = np.concatenate(self._seen), []
            if height := lines_per_frame(rows):
                size = f"--grid {height}x{rows.shape[1]}"
                yield Notice(f"{height} lines seem to be a frame: start again with {size}")
            names, numbers = self._stream.names * self._is_named, self._stream.columns
            others, doubts = ({}, {}) if self._has_grid else find_others(names, rows)
            text = said_of(names, others | doubts, UNLIKE, numbers)
            if text and text not in self.told:
                yield Notice(text)

    def _rows(self, *, repeats: bool = False) -> Iterator[tuple[NDArray[np.float64], float]]:
        """Yield the rows of received lines, possibly none, indefinitely."""
        table, left = self._table, self._left
        left.repeats = repeats and self._has_grid  # of rows; others may be missing
        while True:
            lines = self._whole_frames()
            rows = _parsed(lines, table, left)
            self._unread = [] if len(rows) else [*self._unread[-_MAX_HELD:], *(s for _, s in lines)]
            if left.first:
                self._bad = quote(dict(lines)[left.first.line].strip())
                is_header = isinstance(left.first, tables.HeaderError) and not left.headers
                unread = [line for number, line in lines if number >= left.first.line]
                if is_header or sum(not tables.is_apart(s) for s in self._unread) >= _MOST_UNREAD:
                    self.others = unread if is_header else self._unread
                left.first = None
            yield rows, 0.0

    def _whole_frames(self) -> list[tables.Numbered]:
        """Take the lines of complete frames, each as one line."""
        lines, table, n_whole, depth = self._pending, self._table, 0, 0
        for i, (_, line) in enumerate(lines):
            depth += tables.depth_of(line) if table.nested else 0
            ends = tables.divides(line) if table.block and not table.nested else depth <= 0
            if self._ended or ends:
                n_whole = i + 1
        self._pending = lines[n_whole:]
        return [*tables.frame_lines(lines[:n_whole], table)]


def _decoded(line: bytes) -> str:
    """Decode UTF-8, or else Latin-1, which has a character for every byte."""
    try:
        return line.decode("utf-8-sig")
    except UnicodeDecodeError:
        return line.decode("latin-1")


def _parsed(
    lines: list[tables.Numbered], table: tables.Table, left: tables.LeftOut
) -> NDArray[np.float64]:
    """Return the rows, (t, n_columns), of lines before a header, without those that do not fit."""
    held = [np.empty((0, table.n_columns))]
    left.headers = table.n_columns < _LEAST_NAMES
    try:
        held += tables.parsed(lines, table, left) if lines else ()
    except tables.HeaderError as error:
        left.n_left, left.first = left.n_left + 1, error
    return np.concatenate(held)
