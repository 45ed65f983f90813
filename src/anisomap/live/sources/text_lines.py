"""Frames as lines of text: numbers, delimited text, or JSON."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from anisomap.live.batches import Batch, Item, Names, Notice

MAX_LINE = 1 << 22
"""Bytes; a longer line is no frame. A frame of 100,000 sensors in JSON has fewer."""

_MIN_SENSORS = 2
_MISSING = frozenset({"", "nan", "null", "none", "na", "-"})
_TIMES = frozenset({"t", "time", "time_s", "timestamp", "stamp"})
_SHOWN = 40  # characters of a line in a notice

_Frame: TypeAlias = tuple[float | None, list[float]]


@dataclass
class LineParser:
    """Splits bytes into lines and parses each as a frame.

    A line is numbers separated by commas, semicolons or white space, a JSON array of numbers, or a
    JSON object with a list of numbers, or with one number per sensor. An object may have a time in
    seconds (``t``, ``time`` or ``timestamp``). A first line of text names the sensors; a column
    ``time`` among them holds the times. Empty fields, ``nan`` and ``null`` are missing readings.

    Attributes
    ----------
    n_rejected : int
        Number of lines that are no frame.
    """

    n_rejected: int = 0
    _rest: bytearray = field(default_factory=bytearray)
    _names: tuple[str, ...] = ()
    _time_column: int | None = None
    _overlong: bool = False
    _untold: bool = False
    _width: int = 0

    def feed(self, content: bytes, *, complete: bool = False) -> Iterator[Item]:
        """Parse the next bytes.

        Parameters
        ----------
        content : bytes
        complete : bool
            Whether the bytes end with a whole line, as in a datagram.

        Yields
        ------
        Batch, Names or Notice
        """
        rows: list[list[float]] = []
        times: list[float] = []
        for found in self._frames(content, complete):
            if not isinstance(found, tuple):
                yield found
                continue
            moment, row = found
            if rows and (len(row) != len(rows[0]) or (moment is None) != (not times)):
                yield _batch(rows, times)
                rows, times = [], []
            rows.append(row)
            if moment is not None:
                times.append(moment)
        if rows:
            yield _batch(rows, times)

    def _frames(self, content: bytes, complete: bool) -> Iterator[_Frame | Names | Notice]:
        """Parse whole lines, and keep the rest."""
        # The rest is only added to while no line ends: a line may come byte by byte.
        ended, end, rest = content.rpartition(b"\n")
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
        for line in lines:
            if self._overlong:  # the end of a line of which the beginning was discarded
                self._overlong = False
                yield self._reject(f"a line of more than {MAX_LINE} bytes")
                continue
            text = line.decode("utf-8", "replace").strip()
            if not text or text.startswith("#"):
                continue
            try:
                found = self._parse(text)
            except (ValueError, OverflowError, RecursionError):
                yield self._reject(repr(text[:_SHOWN]))
                continue
            if self._untold:
                self._untold = False
                yield Names(self._names)
            if found is not None:
                yield found

    def _parse(self, text: str) -> _Frame | None:
        """Return the time and the readings of a frame; None for a header."""
        if text[0] in "[{":
            return self._parse_json(text)
        fields = _split(text)
        if len(fields) > 1 and not fields[-1] and len(fields) != self._width:
            fields.pop()  # every line ends with a separator
        self._width = self._width or len(fields)
        try:
            row = [_number(field) for field in fields]
        except ValueError:
            if self._names or not _are_names(fields):
                raise
            self._learn(fields)
            return None
        moment = None
        if self._time_column is not None and len(row) == len(self._names) + 1:
            moment = row.pop(self._time_column)
        return _checked(moment, row)

    def _parse_json(self, text: str) -> _Frame:
        value: Any = json.loads(text)
        moment: Any = None
        if isinstance(value, dict):
            for key in [key for key in value if key.lower() in _TIMES]:
                moment = value.pop(key)
            lists = [item for item in value.values() if isinstance(item, list)]
            value = max(lists, key=len) if lists else self._in_order(value)
        if not all(item is None or _is_real(item) for item in value):
            raise ValueError("no list of numbers")
        row = [math.nan if item is None else float(item) for item in value]
        return _checked(float(moment) if _is_real(moment) else None, row)

    def _in_order(self, values: dict[str, Any]) -> list[Any]:
        """Return the values of an object, in the order of the first object."""
        known = {key: item for key, item in values.items() if item is None or _is_real(item)}
        if not self._names and len(known) >= _MIN_SENSORS:
            self._names, self._untold = tuple(known), True
        ordered = [known.pop(name, None) for name in self._names]
        return ordered + list(known.values())

    def _learn(self, fields: list[str]) -> None:
        clock = next((i for i, name in enumerate(fields) if name.lower() in _TIMES), None)
        self._time_column, self._untold = clock, True
        self._names = tuple(name for i, name in enumerate(fields) if i != clock)

    def _reject(self, what: str) -> Notice:
        self.n_rejected += 1
        return Notice(f"ignored a line that holds no frame of numbers: {what}")


def _split(text: str) -> list[str]:
    for mark in (",", ";", "\t"):
        if mark in text:
            return [field.strip().strip('"') for field in text.split(mark)]
    return text.split()


def _number(text: str) -> float:
    return math.nan if text.lower() in _MISSING else float(text)


def _is_real(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _checked(moment: float | None, row: list[float]) -> _Frame:
    if len(row) < _MIN_SENSORS:
        raise ValueError("fewer than two numbers")
    return (moment if moment is not None and math.isfinite(moment) else None), row


def _are_names(fields: list[str]) -> bool:
    """Return whether fields are a header: distinct printable texts, none of which is a number."""
    texts = [text for text in fields if text and text.isprintable()]
    if len(texts) != len(fields) or len(set(fields)) != len(fields) or len(fields) < _MIN_SENSORS:
        return False
    return not any(re.fullmatch(r"[-+]?[\d.]+(e[-+]?\d+)?", text.lower()) for text in texts)


def _batch(rows: list[list[float]], times: list[float]) -> Batch:
    return Batch(np.array(rows), np.array(times) if times else None)
