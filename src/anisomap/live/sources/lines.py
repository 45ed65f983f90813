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
from itertools import groupby
from threading import Event
from typing import Any, TypeAlias

import numpy as np

from anisomap.errors import InputError, import_extra
from anisomap.live.batches import (
    RETRY_S,
    WAIT_S,
    Address,
    Batch,
    Item,
    Names,
    Notice,
    Source,
    connected,
    polled,
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
    _width: int = 0

    def feed(self, content: bytes, *, complete: bool = False) -> Iterator[Item]:
        """Parse the next bytes."""
        frames: list[_Frame] = []
        for found in self._frames(content, complete):
            if isinstance(found, tuple):
                frames.append(found)
            else:
                yield found
        # Consecutive frames of one width, with times or without, are a batch.
        for _, alike in groupby(frames, lambda frame: (frame[0] is None, len(frame[1]))):
            times, rows = zip(*alike, strict=True)
            yield Batch(np.array(rows), None if times[0] is None else np.array(times))

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
                yield from self._parse(text)
            except (ValueError, OverflowError, RecursionError):
                yield _rejected(repr(text[:_SHOWN]))

    def _parse(self, text: str) -> Iterator[_Frame | Names]:
        """Yield the names that a line gives, if they are new, and its frame."""
        if text[0] in "[{":
            yield from self._parse_json(text)
            return
        fields = _split(text)
        if len(fields) > 1 and not fields[-1] and len(fields) != self._width:
            fields.pop()  # every line ends with a separator
        self._width = self._width or len(fields)
        try:
            row = [math.nan if one.lower() in _MISSING else float(one) for one in fields]
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

    def _parse_json(self, text: str) -> Iterator[_Frame | Names]:
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
                if not self._names and len(known) >= _MIN_SENSORS:
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


def _is_real(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _checked(moment: float | None, row: list[float]) -> _Frame:
    if len(row) < _MIN_SENSORS:
        raise ValueError("fewer than two numbers")
    return (moment if moment is not None and math.isfinite(moment) else None), row


def _are_names(fields: list[str]) -> bool:
    """Return whether fields are a header: distinct printable texts, none of which is a number."""
    return (
        len(set(fields)) == len(fields) >= _MIN_SENSORS
        and all(text and text.isprintable() for text in fields)
        and not any(re.fullmatch(r"[-+]?[\d.]+(e[-+]?\d+)?", text.lower()) for text in fields)
    )


def standard_input(_: Address) -> Source:
    """Lines from standard input, until its end."""
    held: queue.Queue[bytes] = queue.Queue(maxsize=16)

    def read() -> None:
        content = b"-"
        while content:
            content = os.read(sys.stdin.fileno(), READ_BYTES)
            held.put(content)

    def items(stop: Event) -> Iterator[Item]:
        # The thread ends with the process: not all systems can wait for standard input.
        threading.Thread(target=read, daemon=True).start()
        parser = LineParser()
        for content in polled(stop, lambda: held.get(timeout=WAIT_S), queue.Empty):
            yield from parser.feed(content, complete=not content)
            if not content:
                yield Notice("standard input has ended")
                return

    return Source("standard input", items)


def received(
    connection: socket.socket, stop: Event, translate: Callable[[str], str] = str
) -> Iterator[Item]:
    """Parse what a socket receives, until its end; a cut last line is dropped."""
    connection.settimeout(WAIT_S)
    parser = LineParser(translate)
    for content in polled(stop, lambda: connection.recv(READ_BYTES)):
        if not content:
            return
        yield from parser.feed(content)


def tcp(address: Address) -> Source:
    """Lines from a server."""
    endpoint = (address.host, address.port)
    return connected(
        f"tcp://{address.endpoint}", lambda: socket.create_connection(endpoint, RETRY_S), received
    )


def tcp_listen(address: Address) -> Source:
    """Lines from one client at a time, which connects to us."""
    listener, port = _listening(socket.SOCK_STREAM, address)

    def items(stop: Event) -> Iterator[Item]:
        with closing(listener):
            yield Notice(f"waiting for a connection on port {port}")
            for connection, peer in polled(stop, listener.accept):
                yield Notice(f"{peer[0]} connected")
                with closing(connection), suppress(OSError):
                    yield from received(connection, stop)
                if not stop.is_set():
                    yield Notice(f"{peer[0]} closed the connection; waiting for the next")

    return Source(f"tcp-listen://{address.endpoint}", items, port=port)


def udp(address: Address) -> Source:
    """Datagrams, each with one or several whole lines."""
    receiver, port = _listening(socket.SOCK_DGRAM, address)

    def receive() -> bytes:
        try:
            return receiver.recv(READ_BYTES)
        except ConnectionError as error:  # on Windows, of a datagram that was sent
            raise TimeoutError from error

    def items(stop: Event) -> Iterator[Item]:
        parser = LineParser()
        with closing(receiver):
            with suppress(OSError):
                receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            yield Notice(f"waiting for datagrams on port {port}")
            for content in polled(stop, receive):
                yield from parser.feed(content, complete=True)

    return Source(f"udp://{address.endpoint}", items, port=port)


def _listening(kind: socket.SocketKind, address: Address) -> tuple[socket.socket, int]:
    """Open a port, so that one in use is reported before the session starts; return its number."""
    host, port = address.host, address.port
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
    made.settimeout(WAIT_S)
    return made, int(made.getsockname()[1])


def serial_port(address: Address) -> Source:
    """Lines from a serial port, which is opened again when it was unplugged.

    The option ``baud`` is the number of symbols per second.
    """
    device = address.parts.netloc or address.parts.path
    library = import_extra("serial", "reading a serial port", "serial")
    baud = address.query.get("baud", _BAUD)
    if not baud.isdecimal() or int(baud) < 1:
        raise InputError(f"baud must be a number of symbols per second, got {baud!r}")

    def connect() -> Any:
        return first.pop() if first else library.Serial(device, int(baud), timeout=WAIT_S)

    first: list[Any] = []
    try:
        first.append(connect())
    except (OSError, ValueError) as error:  # SerialException is an OSError
        raise InputError(f"cannot open serial port {device}: {error}") from error

    def receive(port: Any, stop: Event) -> Iterator[Item]:
        parser = LineParser()
        for content in polled(stop, lambda: port.read(max(1, min(port.in_waiting, READ_BYTES)))):
            yield from parser.feed(content)

    # TypeError: pyserial, if the port is closed meanwhile
    return connected(f"serial port {device}", connect, receive, (OSError, TypeError))
