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
from threading import Event

from anisomap.errors import InputError
from anisomap.live.batches import WAIT_S, Item, Notice
from anisomap.live.sources.text_lines import LineParser
from anisomap.sensor_map import SensorMap

_READ_BYTES = 1 << 16
_RETRY_S = 1.0  # between two attempts to connect
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
        told = False
        while not stop.is_set():
            try:
                connection = socket.create_connection(self._address, timeout=_RETRY_S)
            except OSError as error:
                if not told:
                    reason = error.strerror or str(error)
                    yield Notice(f"cannot connect to {self.description} ({reason}); still trying")
                told = True
                stop.wait(_RETRY_S)
                continue
            told = False
            yield Notice(f"connected to {self.description}")
            with closing(connection):
                yield from _received(connection, stop)
            if not stop.is_set():
                yield Notice(f"lost the connection to {self.description}; connecting again")
                stop.wait(WAIT_S)


class TcpServer(_Lines):
    """Lines from one client at a time, which connects to us.

    Parameters
    ----------
    host : str
    port : int
        0 for any free port; the notice names it.
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"tcp-listen://{host}:{port}")
        self._server = _bound(socket.SOCK_STREAM, host, port)
        self.port = int(self._server.getsockname()[1])

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames, of one client after another."""
        with closing(self._server) as server:
            server.listen(1)
            server.settimeout(WAIT_S)
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


class Udp(_Lines):
    """Datagrams, each with one or several whole lines.

    Parameters
    ----------
    host : str
    port : int
        0 for any free port; the notice names it.
    """

    def __init__(self, host: str, port: int) -> None:
        super().__init__(f"udp://{host}:{port}")
        self._socket = _bound(socket.SOCK_DGRAM, host, port)
        self.port = int(self._socket.getsockname()[1])

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames."""
        parser = LineParser()
        with closing(self._socket) as receiver:
            with suppress(OSError):
                receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            receiver.settimeout(WAIT_S)
            yield Notice(f"waiting for datagrams on port {self.port}")
            while not stop.is_set():
                with suppress(TimeoutError, ConnectionError):
                    yield from parser.feed(receiver.recv(_READ_BYTES), complete=True)


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
    connection.settimeout(WAIT_S)
    while not stop.is_set():
        try:
            content = connection.recv(_READ_BYTES)
        except TimeoutError:
            continue
        except OSError:
            return
        if not content:
            return
        yield from parser.feed(content)


def _chunks_of_stdin(stop: Event) -> Iterator[bytes]:
    """Read standard input without waiting longer than `WAIT_S` before `stop` is looked at."""
    descriptor = sys.stdin.fileno()
    if os.name == "posix":
        while not stop.is_set():
            if select.select([descriptor], [], [], WAIT_S)[0]:
                content = os.read(descriptor, _READ_BYTES)
                if not content:
                    return
                yield content
        return
    # Windows cannot wait for a pipe: a thread reads it, and ends with the process.
    held: queue.Queue[bytes] = queue.Queue(maxsize=16)

    def read() -> None:
        content = b"-"
        while content:
            content = os.read(descriptor, _READ_BYTES)
            held.put(content)

    threading.Thread(target=read, daemon=True).start()
    while not stop.is_set():
        with suppress(queue.Empty):
            content = held.get(timeout=WAIT_S)
            if not content:
                return
            yield content
