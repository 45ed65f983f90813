"""Lines of text as frames."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from anisomap.live.batches import Found, Frame, Names, Notice

MAX_LINE = 1 << 22
"""Bytes; a longer line is no frame. A frame of 100,000 sensors in JSON has fewer."""

MIN_SENSORS = 2
"""Fewer numbers are no frame."""

_MISSING = frozenset({"", "nan", "null", "none", "na", "-"})
_TIMES = frozenset({"t", "time", "time_s", "timestamp", "stamp"})
_SHOWN = 40  # characters of a line in a notice


@dataclass
class LineParser:
    """Splits bytes into lines and parses each as a frame.

    A line is numbers separated by commas, semicolons or white space, a JSON array of numbers, or a
    JSON object with a list of numbers, or with one number per sensor. An object may have a time in
    seconds (``t``, ``time`` or ``timestamp``). A first line of text names the sensors; a column
    ``time`` among them holds the times. Empty fields, ``nan`` and ``null`` are missing readings.
    """

    _rest: bytearray = field(default_factory=bytearray)
    _names: tuple[str, ...] = ()
    _time_column: int | None = None
    _overlong: bool = False
    _width: int = 0

    def feed(self, content: bytes, *, complete: bool = False) -> Iterator[Found]:
        """Parse the whole lines of the next bytes, and keep the rest."""
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
                yield _rejected(f"a line of more than {MAX_LINE} bytes")
                continue
            text = line.decode("utf-8", "replace").strip()
            if not text or text.startswith("#"):
                continue
            try:
                yield from self._parse(text)
            except (ValueError, OverflowError, RecursionError):
                yield _rejected(repr(text[:_SHOWN]))

    def _parse(self, text: str) -> Iterator[Frame | Names]:
        """Yield the names that a line gives, if they are new, and its frame."""
        if text[0] in "[{":
            yield from self._parse_json(text)
            return
        fields = _split(text)
        if len(fields) > 1 and not fields[-1] and len(fields) != self._width:
            fields.pop()  # every line ends with a separator
        self._width = self._width or len(fields)
        try:
            row = [math.nan if one.lower() in _MISSING else _number(one) for one in fields]
        except ValueError:
            if self._names or not _are_names(fields):
                raise
            clock = next((i for i, name in enumerate(fields) if name.lower() in _TIMES), None)
            self._time_column = clock
            self._names = tuple(name for i, name in enumerate(fields) if i != clock)
            yield Names(self._names)
            return
        moment = None
        if self._time_column is not None and len(row) == len(self._names) + 1:
            moment = row.pop(self._time_column)
        yield _checked(moment, row)

    def _parse_json(self, text: str) -> Iterator[Frame | Names]:
        value: Any = json.loads(text)
        moment: Any = None
        if isinstance(value, dict):
            for key in [key for key in value if key.lower() in _TIMES]:
                moment = value.pop(key)
            lists = [item for item in value.values() if isinstance(item, list)]
            if lists:
                value = max(lists, key=len)
            else:
                known = {k: item for k, item in value.items() if item is None or _is_real(item)}
                if not self._names and len(known) >= MIN_SENSORS:
                    self._names = tuple(known)
                    yield Names(self._names)
                # In the order of the first object.
                value = [known.pop(name, None) for name in self._names] + list(known.values())
        if not all(item is None or _is_real(item) for item in value):
            raise ValueError("no list of numbers")
        row = [math.nan if item is None else float(item) for item in value]
        yield _checked(float(moment) if _is_real(moment) else None, row)


def _rejected(what: str) -> Notice:
    return Notice(f"ignored a line that holds no frame of numbers: {what}")


def _split(text: str) -> list[str]:
    for mark in (",", ";", "\t"):
        if mark in text:
            return [field.strip().strip('"') for field in text.split(mark)]
    return text.split()


def _number(text: str) -> float:
    if "_" in text:  # which Python takes as a separator of digits
        raise ValueError(text)
    return float(text)


def _is_real(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _checked(moment: float | None, row: list[float]) -> Frame:
    if len(row) < MIN_SENSORS:
        raise ValueError("fewer than two numbers")
    return (moment if moment is not None and math.isfinite(moment) else None), row


def _are_names(fields: list[str]) -> bool:
    """Return whether fields are a header: distinct printable texts, none of which is a number."""
    return (
        len(set(fields)) == len(fields) >= MIN_SENSORS
        and all(text and text.isprintable() for text in fields)
        and not any(re.fullmatch(r"[-+]?[\d.]+(e[-+]?\d+)?", text.lower()) for text in fields)
    )
