"""Sources of live sessions: where the frames come from.

To add a source, add a class of `anisomap.live.batches.Source` that is made from an `Address`, and
one line to `SOURCES`.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple
from urllib.parse import urlsplit

from anisomap import io
from anisomap.errors import InputError
from anisomap.live.batches import Address, Source
from anisomap.live.sources.replay import Replay


class Entry(NamedTuple):
    """A kind of source; its module is imported on first use, since many sources need an extra."""

    example: str
    summary: str
    module: str
    name: str

    def open(self, address: Address) -> Source:
        """Open the source at an address."""
        kind = getattr(import_module(f"anisomap.live.sources.{self.module}"), self.name)
        opened: Source = kind(address)
        return opened


# fmt: off
SOURCES: Mapping[str, Entry] = MappingProxyType({
    "-": Entry("-", "lines on standard input", "lines", "StandardInput"),
    "tcp": Entry("tcp://HOST:PORT", "lines from a TCP server", "lines", "TcpClient"),
    "tcp-listen": Entry("tcp-listen://HOST:PORT", "lines from a TCP client that connects to us",
                        "lines", "TcpServer"),
    "udp": Entry("udp://HOST:PORT", "lines in UDP datagrams", "lines", "Udp"),
    "serial": Entry("serial:///dev/ttyUSB0?baud=115200", "lines from a serial port",
                    "lines", "SerialPort"),
    "lsl": Entry("lsl://NAME", "stream of the Lab Streaming Layer", "middleware", "LslStream"),
    "rosbridge": Entry("rosbridge://HOST:9090/TOPIC", "topic of ROS through rosbridge",
                       "middleware", "Rosbridge"),
    "zenoh": Entry("zenoh://KEY?connect=tcp/HOST:7447", "topic of ROS 2 through Zenoh",
                   "middleware", "ZenohTopic"),
    "yarp": Entry("yarp://HOST:10000/PORT", "port of YARP", "middleware", "YarpPort"),
})
# fmt: on
"""Kinds of sources by the scheme of their addresses."""


def open_source(text: str, *, speed: float = 1.0, options: io.ReadOptions | None = None) -> Source:
    """Open a source."""
    scheme, colon, _ = text.partition("://")
    if text == "-" or (colon and scheme in SOURCES):
        try:
            return SOURCES[scheme].open(Address(urlsplit(text)))
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{text} is not an address: {error}") from error
    if Path(text).exists():
        return Replay(Path(text), speed, options)
    known = ", ".join(entry.example for entry in SOURCES.values())
    raise InputError(f"there is no file {text}, and it is no address: {known}")
