"""Lines of text from standard input, TCP and UDP."""

from __future__ import annotations

import os
import queue
import select
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import closing, suppress
from functools import partial
from threading import Event
from typing import ClassVar

from anisomap.errors import InputError
from anisomap.live.batches import WAIT_S, Item, Notice
from anisomap.live.sources.connections import READ_BYTES, RETRY_S, chunks_of, stay_connected
from anisomap.live.sources.text_lines import LineParser
from anisomap.sensor_map import SensorMap

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
    """Lines from a server, to which the connection is made again when it is lost.

    Parameters
    ----------
    host : str
    port : int
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"tcp://{host}:{port}")
        self._address = (host, port)

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames, of one connection after another."""
        connect = partial(socket.create_connection, self._address, timeout=RETRY_S)
        yield from stay_connected(self.description, connect, _received, stop)


class _Listener(_Lines):
    """A port of this computer, bound when the source is made.

    Parameters
    ----------
    host : str
    port : int
        0 for any free port; the notice names it.

    Raises
    ------
    InputError
        If the port cannot be used.
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
