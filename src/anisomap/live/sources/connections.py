"""Sources that other programs and devices send: lines of text, and the Lab Streaming Layer."""

from __future__ import annotations

import os
import queue
import socket
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from anisomap.errors import InputError, import_extra
from anisomap.live.batches import RETRY_S, WAIT_S, Address, Batch, Item, Names, Source
from anisomap.live.sources.lines import LineParser

READ_BYTES = 1 << 16
"""Number of bytes read at once."""

_RECEIVE_BUFFER = 1 << 22  # bytes; the system drops datagrams when the buffer is full
_BAUD = "115200"

_RESOLVE_S = 1.0  # for one search for an LSL stream; searches are repeated
_BUFFER_S = 60  # seconds of data that the LSL library buffers


class _Lines(Source):
    """Bytes in which each line is a frame.

    whole: Whether received bytes end with a whole line, even without an end of line.
    """

    whole = False
    _parser: LineParser

    def parse(self, content: bytes) -> Iterable[Item]:
        yield from self._parser.feed(content, complete=self.whole or (not content and self.ends))
        if not content:
            yield from self._parser.end()

    def wait(self) -> Iterable[Item]:
        yield from self._parser.wait()


class StandardInput(_Lines):
    """Lines from standard input, until its end."""

    description, greeting = "standard input", ""
    ends = True

    def __init__(self, _: Address) -> None:
        self._held: queue.Queue[bytes | None] = queue.Queue(maxsize=16)

    @contextmanager
    def open(self) -> Iterator[None]:
        # The thread ends with the process, since some systems cannot wait for standard input.
        threading.Thread(target=self._read, daemon=True).start()
        self._parser = LineParser(self.grid)
        yield

    def _read(self) -> None:
        content = b"-"
        while content:
            content = os.read(sys.stdin.fileno(), READ_BYTES)
            self._held.put(content)
        self._held.put(None)

    def receive(self) -> bytes:
        try:
            content = self._held.get(timeout=WAIT_S)
        except queue.Empty:
            raise TimeoutError from None
        if content is None:
            raise EOFError
        return content


class Tcp(_Lines):
    """Lines from a server; a line cut off by the end of a connection is dropped."""

    def __init__(self, address: Address) -> None:
        self._place = address.host, address.port
        self.description = f"tcp://{address.endpoint}"

    @contextmanager
    def open(self) -> Iterator[None]:
        with socket.create_connection(self._place, RETRY_S) as self._connection:
            self._connection.settimeout(WAIT_S)
            self._parser, self._is_closed = LineParser(self.grid), False
            yield

    def receive(self) -> bytes:
        if self._is_closed:
            raise EOFError
        content = self._connection.recv(READ_BYTES)
        self._is_closed = not content
        return content


class Udp(_Lines):
    """Datagrams, each with one or several whole lines; a port in use is reported immediately."""

    whole = True

    def __init__(self, address: Address) -> None:
        host, port = address.host, address.port
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"cannot listen on {host}:{port}: {reason}") from error
        self._socket.settimeout(WAIT_S)
        self.port = int(self._socket.getsockname()[1])
        self.description = f"udp://{address.endpoint}"
        self.greeting = f"waiting for datagrams on port {self.port}"

    @contextmanager
    def open(self) -> Iterator[None]:
        with self._socket:
            with suppress(OSError):
                self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            self._parser = LineParser(self.grid)
            yield

    def receive(self) -> bytes:
        try:
            return self._socket.recv(READ_BYTES) or b"\n"
        except ConnectionError as error:  # on Windows, caused by a sent datagram
            raise TimeoutError from error


class SerialPort(_Lines):
    """Lines from a serial port, which is reopened after it was unplugged.

    The option ``baud`` is the number of symbols per second.
    """

    lost = (OSError, TypeError)  # TypeError: pyserial, if the port is closed meanwhile

    def __init__(self, address: Address) -> None:
        device, baud = address.parts.netloc or address.parts.path, address.query.get("baud", _BAUD)
        self._library = import_extra("serial", "reading a serial port", "serial")
        if not baud.isdecimal() or int(baud) < 1:
            raise InputError(f"baud must be a number of symbols per second, got {baud!r}")
        self._device, self._baud = device, int(baud)
        self.description = f"serial port {device}"
        try:
            self._port: Any = self._opened()
        except (OSError, ValueError) as error:  # SerialException is an OSError
            raise InputError(f"cannot open serial port {device}: {error}") from error

    def _opened(self) -> Any:
        return self._library.Serial(self._device, self._baud, timeout=WAIT_S)

    @contextmanager
    def open(self) -> Iterator[None]:
        if not self._port.is_open:
            self._port = self._opened()
        with self._port:
            self._parser = LineParser(self.grid)
            yield

    def receive(self) -> bytes:
        content: bytes = self._port.read(max(1, min(self._port.in_waiting, READ_BYTES)))
        if not content:
            raise TimeoutError
        return content


class Lsl(Source):
    """A stream of numbers, found by its name; the library recovers lost connections."""

    def __init__(self, address: Address) -> None:
        self._name = address.name
        if not self._name:
            raise InputError("an LSL stream needs a name, as in lsl://NAME")
        self.description = f"LSL stream {self._name}"
        self._library = import_extra("pylsl", "reading an LSL stream", "lsl")

    @contextmanager
    def open(self) -> Iterator[None]:
        found = self._library.resolve_byprop("name", self._name, 1, _RESOLVE_S)
        if not found:
            raise OSError("not found")
        if found[0].channel_format() == self._library.cf_string:
            raise InputError(f"{self.description} holds text; a stream of numbers is needed")
        self._inlet = self._library.StreamInlet(found[0], _BUFFER_S, recover=True)
        info = self._inlet.info()
        labels = [str(label) for label in info.get_channel_labels() or () if label]
        self._labels = labels if len(labels) == info.channel_count() else []
        self._last = float("-inf")
        try:
            yield
        finally:
            self._inlet.close_stream()

    def receive(self) -> tuple[list[list[float]], list[float]]:
        samples, stamps = self._inlet.pull_chunk(timeout=WAIT_S)
        return samples, stamps

    def parse(self, content: tuple[list[list[float]], list[float]]) -> Iterable[Item]:
        samples, stamps = content
        if self._labels:
            yield Names(tuple(self._labels))
            self._labels = []
        known = bool(stamps) and stamps[0] > self._last
        if stamps:
            self._last = stamps[-1]
            yield Batch(np.array(samples, dtype=np.float64), np.array(stamps) if known else None)
