"""Sources of live sessions: where the frames come from.

To add a source, add a class with the attributes and the method of `anisomap.live.batches.Source`,
and one line to `SOURCES`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from urllib.parse import SplitResult, parse_qs, unquote, urlsplit

from anisomap import io
from anisomap.errors import InputError
from anisomap.live.batches import Source
from anisomap.live.sources.replay import Replay

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class Entry:
    """A kind of source.

    example: An address, for help and messages.
    summary: What it is.
    make: ``make(address)`` opens the source at a split address.
    """

    example: str
    summary: str
    make: Callable[[SplitResult], Source]


def _made(module: str, name: str, *needs: str) -> Callable[[SplitResult], Source]:
    """Return a function that makes a source with some parts of an address.

    The module is imported when the function is called, since many sources need an extra.
    """

    def make(address: SplitResult) -> Source:
        found = import_module(f"anisomap.live.sources.{module}")
        parts: dict[str, Callable[[], object]] = {
            "host": lambda: address.hostname or LOOPBACK,
            "port": lambda: _port(address),
            "path": lambda: unquote(address.path),
            "device": lambda: address.netloc or address.path,
            "name": lambda: unquote(address.netloc + address.path).strip("/"),
            "query": lambda: {key: value[-1] for key, value in parse_qs(address.query).items()},
        }
        made: Source = getattr(found, name)(*(parts[need]() for need in needs))
        return made

    return make


# fmt: off
SOURCES: Mapping[str, Entry] = MappingProxyType({
    "-": Entry("-", "lines on standard input", _made("sockets", "StandardInput")),
    "tcp": Entry("tcp://HOST:PORT", "lines from a TCP server",
                 _made("sockets", "TcpClient", "host", "port")),
    "tcp-listen": Entry("tcp-listen://HOST:PORT", "lines from a TCP client that connects to us",
                        _made("sockets", "TcpServer", "host", "port")),
    "udp": Entry("udp://HOST:PORT", "lines in UDP datagrams",
                 _made("sockets", "Udp", "host", "port")),
    "serial": Entry("serial:///dev/ttyUSB0?baud=115200", "lines from a serial port",
                    _made("serial_port", "SerialPort", "device", "query")),
    "lsl": Entry("lsl://NAME", "stream of the Lab Streaming Layer",
                 _made("lsl", "LslStream", "name")),
    "rosbridge": Entry("rosbridge://HOST:9090/TOPIC", "topic of ROS through rosbridge",
                       _made("rosbridge", "Rosbridge", "host", "port", "path", "query")),
    "zenoh": Entry("zenoh://KEY?connect=tcp/HOST:7447", "topic of ROS 2 through Zenoh",
                   _made("zenoh", "ZenohTopic", "name", "query")),
    "yarp": Entry("yarp://HOST:10000/PORT", "port of YARP",
                  _made("yarp_port", "YarpPort", "host", "port", "path")),
})
# fmt: on
"""Kinds of sources by the scheme of their addresses."""


def open_source(text: str, *, speed: float = 1.0, options: io.ReadOptions | None = None) -> Source:
    """Open a source."""
    scheme, colon, _ = text.partition("://")
    if text == "-" or (colon and scheme in SOURCES):
        try:
            return SOURCES["-" if text == "-" else scheme].make(urlsplit(text))
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{text} is not an address: {error}") from error
    if Path(text).exists():
        return Replay(Path(text), speed, options)
    known = ", ".join(entry.example for entry in SOURCES.values())
    raise InputError(f"there is no file {text}, and it is no address: {known}")


def _port(address: SplitResult) -> int:
    if address.port is None:
        raise InputError(f"{address.geturl()} needs a port, as in {address.scheme}://HOST:PORT")
    return address.port
