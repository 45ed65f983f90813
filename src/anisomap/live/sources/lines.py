"""Frames as lines of text: from standard input, TCP, UDP and serial ports."""

from __future__ import annotations

import json
import math
import os
import queue
import re
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field
from threading import Event
from typing import Any, ClassVar, TypeAlias

import numpy as np

from anisomap.errors import InputError, import_extra
from anisomap.live.batches import (
    RETRY_S,
    WAIT_S,
    Address,
    Batch,
    ConnectedSource,
    Item,
    Names,
    Notice,
    Source,
)

READ_BYTES = 1 << 16
"""Number of bytes that are read at once."""

MAX_LINE = 1 << 22
"""Bytes; a longer line is no frame. A frame of 100,000 sensors in JSON has fewer."""

_MIN_SENSORS = 2
_MISSING = frozenset({"", "nan", "null", "none", "na", "-"})
_TIMES = frozenset({"t", "time", "time_s", "timestamp", "stamp"})
_SHOWN = 40  # characters of a line in a notice
_RECEIVE_BUFFER = 1 << 22  # of datagrams, which the system drops when it is full
_BAUD = "115200"

_Frame: TypeAlias = tuple[float | None, list[float]]


@dataclass
class LineParser:
    """Splits bytes into lines and parses each as a frame.

    A line is numbers separated by commas, semicolons or white space, a JSON array of numbers, or a
    JSON object with a list of numbers, or with one number per sensor. An object may have a time in
    seconds (``t``, ``time`` or ``timestamp``). A first line of text names the sensors; a column
    ``time`` among them holds the times. Empty fields, ``nan`` and ``null`` are missing readings.

    translate: Turns a line of another format into one of these; empty if it holds no frame.
    """

    translate: Callable[[str], str] = str
    _rest: bytearray = field(default_factory=bytearray)
    _names: tuple[str, ...] = ()
    _time_column: int | None = None
    _overlong: bool = False
    _untold: bool = False
    _width: int = 0

    def feed(self, content: bytes, *, complete: bool = False) -> Iterator[Item]:
        """Parse the next bytes."""
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
                yield _rejected(f"a line of more than {MAX_LINE} bytes")
                continue
            text = self.translate(line.decode("utf-8", "replace").strip())
            if not text or text.startswith("#"):
                continue
            try:
                found = self._parse(text)
            except (ValueError, OverflowError, RecursionError):
                yield _rejected(repr(text[:_SHOWN]))
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


def _rejected(what: str) -> Notice:
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


class StandardInput(Source):
    """Lines from standard input, until its end."""

    def __init__(self, _: Address) -> None:
        super().__init__("standard input")

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames."""
        parser = LineParser()
        for content in _read_input(stop):
            yield from parser.feed(content)
        yield from parser.feed(b"", complete=True)
        if not stop.is_set():
            yield Notice("standard input has ended")


class TcpClient(ConnectedSource):
    """Lines from a server."""

    def __init__(self, address: Address) -> None:
        super().__init__(f"tcp://{address.endpoint}")
        self._endpoint = (address.host, address.port)

    def connect(self) -> socket.socket:
        """Connect to the server."""
        return socket.create_connection(self._endpoint, RETRY_S)

    def receive(self, connection: socket.socket, stop: Event) -> Iterator[Item]:
        """Iterate over the frames; a cut last line is dropped."""
        yield from received(connection, LineParser(), stop)


class _Listener(Source):
    """A port of this computer, opened when the source is made; for port 0, the notice names it."""

    _scheme: ClassVar[str]
    _kind: ClassVar[socket.SocketKind]

    def __init__(self, address: Address) -> None:
        super().__init__(f"{self._scheme}://{address.endpoint}")
        self._socket = _listening(self._kind, address.host, address.port)
        self._socket.settimeout(WAIT_S)
        self.port = int(self._socket.getsockname()[1])


class TcpServer(_Listener):
    """Lines from one client at a time, which connects to us."""

    _scheme, _kind = "tcp-listen", socket.SOCK_STREAM

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames, of one client after another."""
        with closing(self._socket) as server:
            yield Notice(f"waiting for a connection on port {self.port}")
            while not stop.is_set():
                try:
                    connection, peer = server.accept()
                except TimeoutError:
                    continue
                yield Notice(f"{peer[0]} connected")
                with closing(connection):
                    yield from received(connection, LineParser(), stop)
                if not stop.is_set():
                    yield Notice(f"{peer[0]} closed the connection; waiting for the next")


class Udp(_Listener):
    """Datagrams, each with one or several whole lines."""

    _scheme, _kind = "udp", socket.SOCK_DGRAM

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames."""
        parser = LineParser()
        with closing(self._socket) as receiver:
            with suppress(OSError):
                receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            yield Notice(f"waiting for datagrams on port {self.port}")
            while not stop.is_set():
                with suppress(TimeoutError, ConnectionError):
                    yield from parser.feed(receiver.recv(READ_BYTES), complete=True)


class SerialPort(ConnectedSource):
    """A serial port, which is opened again when it was unplugged.

    Its option ``baud`` is the number of symbols per second.
    """

    lost = (OSError, TypeError)  # TypeError: pyserial, if the port is closed meanwhile

    def __init__(self, address: Address) -> None:
        self._device = address.parts.netloc or address.parts.path
        super().__init__(f"serial port {self._device}")
        self._serial = import_extra("serial", "reading a serial port", "serial")
        baud = address.query.get("baud", _BAUD)
        if not baud.isdecimal() or int(baud) < 1:
            raise InputError(f"baud must be a number of symbols per second, got {baud!r}")
        self._baud = int(baud)
        self._opened: Any = None
        try:
            self._opened = self.connect()
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise InputError(f"cannot open {self.description}: {error}") from error

    def connect(self) -> Any:
        """Open the port, unless it was opened when the source was made."""
        opened, self._opened = self._opened, None
        return opened or self._serial.Serial(self._device, self._baud, timeout=WAIT_S)

    def receive(self, connection: Any, stop: Event) -> Iterator[Item]:
        """Iterate over the frames."""
        parser = LineParser()
        while not stop.is_set():
            n_bytes = max(1, min(connection.in_waiting, READ_BYTES))
            yield from parser.feed(connection.read(n_bytes))


def received(connection: socket.socket, parser: LineParser, stop: Event) -> Iterator[Item]:
    """Parse what a socket receives, until its end or until `stop` is set."""
    connection.settimeout(WAIT_S)
    while not stop.is_set():
        try:
            content = connection.recv(READ_BYTES)
        except TimeoutError:
            continue
        except OSError:
            return
        if not content:
            return
        yield from parser.feed(content)


def _listening(kind: socket.SocketKind, host: str, port: int) -> socket.socket:
    """Open a port, so that one in use is reported before the session starts."""
    made = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, kind)
    try:
        if kind == socket.SOCK_STREAM and os.name == "posix":
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((host, port))
        if kind == socket.SOCK_STREAM:  # until a socket listens, others can be bound to its port
            made.listen(1)
    except (OSError, OverflowError) as error:
        made.close()
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot listen on {host}:{port}: {reason}") from error
    return made


def _read_input(stop: Event) -> Iterator[bytes]:
    """Read standard input in a thread, which ends with the process: not all systems can wait."""
    held: queue.Queue[bytes] = queue.Queue(maxsize=16)

    def read() -> None:
        content = b"-"
        while content:
            content = os.read(sys.stdin.fileno(), READ_BYTES)
            held.put(content)

    threading.Thread(target=read, daemon=True).start()
    while not stop.is_set():
        with suppress(queue.Empty):
            content = held.get(timeout=WAIT_S)
            if not content:
                return
            yield content
