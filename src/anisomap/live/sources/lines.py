"""Connections of sources: made again when they are lost, and read in chunks.

Frames as lines of text: numbers, delimited text, or JSON.

Lines of text from standard input, TCP and UDP.

Lines of text from a serial port, with pyserial.
"""

from __future__ import annotations

import json
import math
import os
import queue
import re
import select
import socket
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, suppress
from dataclasses import dataclass, field
from functools import partial
from threading import Event
from typing import Any, ClassVar, TypeAlias, TypeVar

import numpy as np

from anisomap.errors import InputError, import_extra
from anisomap.live.batches import WAIT_S, Batch, Item, Names, Notice
from anisomap.sensor_map import SensorMap

RETRY_S = 1.0
"""Time in seconds between two attempts to connect."""

READ_BYTES = 1 << 16
"""Number of bytes that are read at once."""

_Connection = TypeVar("_Connection")


def stay_connected(
    description: str,
    connect: Callable[[], AbstractContextManager[_Connection]],
    receive: Callable[[_Connection, Event], Iterator[Item]],
    stop: Event,
    lost: tuple[type[Exception], ...] = (OSError,),
) -> Iterator[Item]:
    """Iterate over the items of one connection after another until `stop` is set."""
    told = False
    while not stop.is_set():
        try:
            opened = connect()
        except lost as error:
            if not told:
                reason = getattr(error, "strerror", None) or error
                yield Notice(f"cannot connect to {description} ({reason}); still trying")
            told = True
            stop.wait(RETRY_S)
            continue
        told = False
        yield Notice(f"connected to {description}")
        with opened as connection:
            items = receive(connection, stop)
            while True:
                # Only errors of the source are caught, not those of the code that takes its items.
                try:
                    item = next(items)
                except (StopIteration, *lost):  # type: ignore[misc]
                    break
                yield item
        if not stop.is_set():
            yield Notice(f"lost the connection to {description}; connecting again")
            stop.wait(WAIT_S)


def chunks_of(connection: socket.socket, stop: Event) -> Iterator[bytes]:
    """Iterate over what a socket receives, until its end or until `stop` is set."""
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
        yield content


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

    n_rejected: Number of lines that are no frame.
    """

    n_rejected: int = 0
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


_RECEIVE_BUFFER = 1 << 22  # of datagrams, which the system drops when it is full


class _Lines:
    """Common attributes of sources of lines."""

    def __init__(self, description: str) -> None:
        self.description = description
        self.names: tuple[str, ...] = ()
        self.truth: SensorMap | None = None


class StandardInput(_Lines):
    """Lines from standard input, until its end."""

    def __init__(self) -> None:
        super().__init__("standard input")

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames."""
        parser = LineParser()
        for content in _chunks_of_stdin(stop):
            yield from parser.feed(content)
        yield from parser.feed(b"", complete=True)
        if not stop.is_set():
            yield Notice("standard input has ended")


class TcpClient(_Lines):
    """Lines from a server, to which the connection is made again when it is lost."""

    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"tcp://{host}:{port}")
        self._address = (host, port)

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames, of one connection after another."""
        connect = partial(socket.create_connection, self._address, timeout=RETRY_S)
        yield from stay_connected(self.description, connect, _received, stop)


class _Listener(_Lines):
    """A port of this computer, bound when the source is made.

    port: 0 for any free port; the notice names it.
    """

    _scheme: ClassVar[str]
    _kind: ClassVar[socket.SocketKind]

    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"{self._scheme}://{host}:{port}")
        self._socket = _bound(self._kind, host, port)
        self._socket.settimeout(WAIT_S)
        self.port = int(self._socket.getsockname()[1])


class TcpServer(_Listener):
    """Lines from one client at a time, which connects to us."""

    _scheme, _kind = "tcp-listen", socket.SOCK_STREAM

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames, of one client after another."""
        with closing(self._socket) as server:
            server.listen(1)
            yield Notice(f"waiting for a connection on port {self.port}")
            while not stop.is_set():
                try:
                    connection, peer = server.accept()
                except TimeoutError:
                    continue
                yield Notice(f"{peer[0]} connected")
                with closing(connection):
                    yield from _received(connection, stop)
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


def _bound(kind: socket.SocketKind, host: str, port: int) -> socket.socket:
    """Bind a socket, so that a port in use is reported before the session starts."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    made = socket.socket(family, kind)
    try:
        if kind == socket.SOCK_STREAM and os.name == "posix":
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((host, port))
    except (OSError, OverflowError) as error:
        made.close()
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot listen on {host}:{port}: {reason}") from error
    return made


def _received(connection: socket.socket, stop: Event) -> Iterator[Item]:
    """Parse what a connection sends until it ends; a cut last line is dropped."""
    parser = LineParser()
    for content in chunks_of(connection, stop):
        yield from parser.feed(content)


def _chunks_of_stdin(stop: Event) -> Iterator[bytes]:
    """Read standard input without waiting longer than `WAIT_S` before `stop` is looked at."""
    descriptor = sys.stdin.fileno()
    if os.name == "posix":
        while not stop.is_set():
            if select.select([descriptor], [], [], WAIT_S)[0]:
                content = os.read(descriptor, READ_BYTES)
                if not content:
                    return
                yield content
        return
    # Windows cannot wait for a pipe: a thread reads it, and ends with the process.
    held: queue.Queue[bytes] = queue.Queue(maxsize=16)

    def read() -> None:
        content = b"-"
        while content:
            content = os.read(descriptor, READ_BYTES)
            held.put(content)

    threading.Thread(target=read, daemon=True).start()
    while not stop.is_set():
        with suppress(queue.Empty):
            content = held.get(timeout=WAIT_S)
            if not content:
                return
            yield content


EXTRA = "serial"

_BAUD = 115_200
_RETRY_S = 1.0  # between two attempts to open a port that was unplugged
_READ_BYTES = 1 << 16


class SerialPort:
    """A serial port, which is opened again when it was unplugged.

    device: Such as ``/dev/ttyUSB0``; on Windows ``COM3``.
    query: ``baud``: symbols per second, 115200 by default.
    """

    def __init__(self, device: str, query: Mapping[str, str]) -> None:
        self.description = f"serial port {device}"
        self.names: tuple[str, ...] = ()
        self.truth: SensorMap | None = None
        self._serial = import_extra("serial", "reading a serial port", EXTRA)
        self._device, baud = device, query.get("baud", str(_BAUD))
        if not baud.isdecimal() or int(baud) < 1:
            raise InputError(f"baud must be a number of symbols per second, got {baud!r}")
        self._baud = int(baud)
        try:
            self._port = self._open()
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise InputError(f"cannot open {self.description}: {error}") from error

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames."""
        port, parser = self._port, LineParser()
        while not stop.is_set():
            try:
                if port is None:
                    port = self._open()
                    parser = LineParser()
                    yield Notice(f"{self.description} is open again")
                content = port.read(max(1, min(port.in_waiting, _READ_BYTES)))
            except (OSError, TypeError):  # TypeError: pyserial, if the port is closed meanwhile
                if port is not None:
                    port.close()
                    port = None
                    yield Notice(f"lost {self.description}; opening it again")
                stop.wait(_RETRY_S)
                continue
            yield from parser.feed(content)
        if port is not None:
            port.close()

    def _open(self) -> Any:
        return self._serial.Serial(self._device, self._baud, timeout=WAIT_S)
