"""A port of YARP in its text protocol, without YARP on this computer.

The name server is asked for the address of the port; the connection to the port is then reversed
(``r``), so that the port sends what it writes: a line ``do``, with a count and a stamp if it has
them, and a line of values (YARP documentation, "YARP without YARP").
"""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from threading import Event

from anisomap.errors import InputError
from anisomap.live.batches import Item
from anisomap.live.sources.lines import READ_BYTES, LineParser, chunks_of, stay_connected
from anisomap.sensor_map import SensorMap

_OURS = b"CONNECT anisomap\n"
_REGISTRATION = re.compile(rb"registration name (\S+) ip (\S+) port (\d{1,5}) type")
_DATA = re.compile(rb"do?(?:\s+\d+\s+(\d+(?:\.\d*)?))?\s*")
_BRACKETS = bytes.maketrans(b"()", b"  ")
_END = b"*** end of message"
_WAIT_S = 2.0  # for an answer of the name server
_MAX_LINE = 1 << 22


class YarpPort:
    """An output port of YARP, connected to again when the connection is lost.

    host: Of the name server.
    port: Of the name server, usually 10000.
    name: Of the output port, such as ``/icub/skin/torso_comp``.
    """

    def __init__(self, host: str, port: int, name: str) -> None:
        if not name.strip("/"):
            raise InputError("YARP needs a port, as in yarp://HOST:10000/icub/skin/torso_comp")
        self.description = f"YARP port {name}"
        self.names: tuple[str, ...] = ()
        self.truth: SensorMap | None = None
        self._server, self._name = (host, port), name

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames, of one connection after another."""
        yield from stay_connected(self.description, self._connected, _received, stop)

    def _connected(self) -> socket.socket:
        return socket.create_connection(self._address(), _WAIT_S)

    def _address(self) -> tuple[str, int]:
        """Ask the name server for the address of the port."""
        with socket.create_connection(self._server, _WAIT_S) as connection:
            connection.sendall(_OURS + f"d\nquery {self._name}\n".encode())
            answer = b""
            while _END not in answer and len(answer) < READ_BYTES:
                content = connection.recv(READ_BYTES)
                if not content:
                    break
                answer += content
        found = _REGISTRATION.search(answer)
        if found is None:
            raise OSError("the name server does not know it")
        return found[2].decode("ascii", "replace"), int(found[3])


def _received(connection: socket.socket, stop: Event) -> Iterator[Item]:
    """Read values, each line after the line that announces it."""
    connection.sendall(_OURS + b"r\n")
    parser, rest, stamp = LineParser(), bytearray(), b""
    for content in chunks_of(connection, stop):
        # The rest is only added to while no line ends: a line may come byte by byte.
        ended, end, begun = content.rpartition(b"\n")
        lines = bytes(rest + ended).split(b"\n") if end else []
        if end or len(rest) > _MAX_LINE:
            rest.clear()
        rest += begun
        for line in lines:
            if found := _DATA.fullmatch(line):
                stamp = found[1] or b""
            elif not line.startswith(b"Welcome"):
                values = b",".join(line.translate(_BRACKETS).split())
                yield from parser.feed(_with_time(stamp, values), complete=True)


def _with_time(stamp: bytes, values: bytes) -> bytes:
    """Return a frame in JSON if it has a stamp, else as delimited text."""
    return b'{"t":%s,"values":[%s]}' % (stamp, values) if stamp else values
