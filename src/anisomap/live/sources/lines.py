"""Lines of text as frames, which are read as files are: in the layout that the first lines have."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.base.clocks import continued
from anisomap.base.columns import find_others, without_units
from anisomap.base.wording import join_items
from anisomap.errors import FileError, InputError
from anisomap.io.parsing.detection import find_table
from anisomap.io.parsing.refusals import refuse_turned
from anisomap.io.parsing.source import COLOURS, quote
from anisomap.io.parsing.tables import LeftOut, LineError, is_apart, parsed
from anisomap.io.recordings.delimited_text import detected_roles, find_matrix
from anisomap.live.batches import Batch, Item, Names, Notice

MAX_LINE = 1 << 22
"""Bytes; a longer line is no frame. A frame of 100,000 sensors in JSON has fewer."""

MIN_SENSORS = 2
"""Fewer numbers are no frame."""

_LOOKED_AT, _LOOKED_AT_S = 20, 2.0  # lines, or time, from which the layout is found
_MAX_ROWS = 100  # lines that show which are a frame
_MAX_HELD = 1000  # lines without a frame
_WHERE = Path("lines")  # in errors of readers of files


class LineParser:
    """Splits bytes into lines, and reads those by `anisomap.io.parsing`.

    Some lines are held until their layout is known: a header, a time, text around the numbers.
    """

    def __init__(self) -> None:
        self._rest = bytearray()
        self._overlong = False
        self._held: list[str] = []
        self._since, self._sample = 0.0, 0
        self._layout: _Layout | None = None

    def feed(self, content: bytes, *, complete: bool = False) -> Iterator[Item]:
        """Parse the whole lines of the next bytes, and keep the rest."""
        # The rest is only added to while no line ends: a line may come byte by byte.
        ended, end, rest = content.replace(b"\r", b"\n").rpartition(b"\n")
        lines: list[bytes] = []
        if end:
            lines = bytes(self._rest + ended).split(b"\n")
            self._rest.clear()
        self._rest += rest
        if complete:
            lines.append(bytes(self._rest))
            self._rest.clear()
        elif len(self._rest) > MAX_LINE:
            self._rest.clear()
            self._overlong = True
        if lines and self._overlong:  # the end of a line of which the beginning was discarded
            self._overlong = False
            del lines[0]
            yield Notice(f"ignored a line that holds no frame: it has more than {MAX_LINE} bytes")
        texts = [COLOURS.sub("", line.decode("utf-8-sig", "replace")).strip() for line in lines]
        yield from self._read([f"{text}\n" for text in texts if not is_apart(text)])

    def end(self) -> Iterator[Item]:
        """Parse the lines that are held."""
        yield from self._read([], ended=True)

    def _read(self, lines: Sequence[str], *, ended: bool = False) -> Iterator[Item]:
        n_read = 0
        while self._layout is None and n_read < len(lines):
            self._since = self._since if self._held else time.monotonic()
            self._held.append(lines[n_read])
            n_read += 1
            if len(self._held) % _LOOKED_AT == 0 or time.monotonic() - self._since > _LOOKED_AT_S:
                yield from self._found()
        if ended and self._held:
            yield from self._found(_MAX_ROWS)
        if self._layout is not None and n_read < len(lines):
            yield from self._layout.read(lines[n_read:])

    def _found(self, n_enough: int = 0) -> Iterator[Item]:
        """Find the layout of the lines that are held, and parse them."""
        layouts, problem, held = list[_Layout](), "", self._held
        self._since, sample = time.monotonic(), self._sample or len(held)
        for start in (1, 0):  # the first line may be cut: a port is opened while a board sends
            try:
                layouts.insert(0, _Layout(held[start:], sample - start))
            except (InputError, ValueError) as error:
                problem = str(error).partition(";")[0]
        if any(each.is_sawtooth for each in layouts) and len(held) + n_enough < _MAX_ROWS:
            self._sample = sample
            return
        layout = min(layouts, key=lambda layout: layout.n_left) if layouts else None
        try:
            if layout:
                layout.refuse(held)
        except FileError as error:
            layout, problem = None, str(error).partition(";")[0]
            del held[_MAX_ROWS:]
        if not layout:
            del held[: max(0, len(held) - _MAX_HELD)]
            yield Notice(f"no frame yet: {problem}")
            return
        self._layout, self._held = layout, []
        yield from layout.begin(held)


class _Layout:
    """How lines are read, by the first `n_sample` of them.

    n_left: How many of those do not fit.
    is_sawtooth: Whether a column may number the lines of a frame.
    """

    def __init__(self, lines: Sequence[str], n_sample: int) -> None:
        self._table = table = find_table(_WHERE, lines[:n_sample])
        self._body, left = lines[table.first_line - 1 :], LeftOut()
        if table.n_columns < MIN_SENSORS or table.block or table.nested:
            raise InputError("no line of two numbers or more")
        rows = list(parsed([*enumerate(lines[table.first_line - 1 : n_sample], 1)], table, left))
        left.check()
        names, start = tuple(map(str.strip, table.names)), np.concatenate(rows)
        roles = detected_roles(table, names, start)
        steps, again = np.diff(start, axis=0) == 1, start[1:] == start.min(axis=0)
        saws = (steps | again).all(axis=0) & steps.any(axis=0) & again.any(axis=0)
        self.is_sawtooth = bool(saws.any())
        if self.is_sawtooth:
            start = np.concatenate([*parsed([*enumerate(self._body, 1)], table, LeftOut())])
        self._matrix = find_matrix(table, names, roles, start)
        if self._matrix:
            others = [*self._matrix.columns]
        else:
            rest = [i for i in range(table.n_columns) if i not in roles.non_sensors]
            shown = start[:, rest] if self.is_sawtooth else start[:0, rest]
            others = [rest[i] for i in find_others([names[i] for i in rest if names], shown)]
        self._others = others
        roles = replace(roles, non_sensors=(*roles.non_sensors, *others))
        self._roles, self.n_left, self._before = roles, left.n_left, -math.inf
        self._n_ignored = 0
        kept = tuple(name for i, name in enumerate(names) if i not in roles.non_sensors)
        self._names = without_units(kept) if all(kept) and not self._matrix else ()
        if table.n_columns - len(roles.non_sensors) < MIN_SENSORS:
            raise InputError("no line of two readings or more")

    def refuse(self, lines: Sequence[str]) -> None:
        """Raise FileError if several lines are a frame, and nothing tells how they are joined."""
        if not self._matrix:
            known = {*self._roles.non_sensors} - {*self._table.text_columns, *self._others}
            refuse_turned(self._table, lines, known)

    def begin(self, lines: Sequence[str]) -> Iterator[Item]:
        """Say what is skipped above the first frame, and parse the rest."""
        n_skipped = len(lines) - len(self._body) - bool(self._names)
        if n_skipped > 0:
            first = join_items([quote(line.strip()) for line in lines[:n_skipped]], 1)
            yield Notice(f"skipped lines at the start: {first}")
        if self._others:
            own = self._table.names
            labels = [own[i].strip() if own else f"column {i + 1}" for i in self._others]
            yield Notice(f"left out, since they are not sensors: {join_items(labels, 3)}")
        if self._names:
            yield Names(self._names)
        yield from self.read(self._body)

    def read(self, lines: Sequence[str]) -> Iterator[Item]:
        """Parse lines; those that do not fit are left out with a notice."""
        table, left = self._table, LeftOut()
        fresh = [line for line in lines if line.strip() not in table.above]
        try:
            for rows in parsed([*enumerate(fresh)], table, left):
                if len(rows):
                    yield from self._batch(rows)
        except LineError as error:
            left.first = left.first or error
        if left.first is not None:
            self._n_ignored += max(left.n_left, 1)
            shown = quote(fresh[left.first.line].strip())
            yield Notice(f"ignored lines that hold no frame: {self._n_ignored}, such as {shown}")

    def _batch(self, rows: NDArray[np.float64]) -> Iterator[Batch]:
        readings = np.delete(rows, self._roles.non_sensors, axis=1)
        times = self._roles.times_in(rows)
        if times is not None and self._roles.time in self._table.clocks:
            times = continued(times, self._before)
            self._before = float(times[-1])
        if self._matrix:
            readings, times = self._matrix.join(rows[:, self._matrix.columns[0]], readings, times)
        if len(readings):
            is_known = times is not None and bool(np.isfinite(times).all())
            yield Batch(readings, times if is_known else None)
