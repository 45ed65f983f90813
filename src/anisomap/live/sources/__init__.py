"""Sources of live sessions: where the frames come from.

To add a source, add a function from an `Address` to a `Source`, both of `anisomap.live.batches`,
and one line to `SOURCES`.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple
from urllib.parse import urlsplit

from anisomap.errors import InputError
from anisomap.live.batches import Address, Source
from anisomap.live.sources.replay import replay


class Entry(NamedTuple):
    """A kind of source; its module is imported on first use, since many sources need an extra."""

    example: str
    summary: str
    module: str
    function: str

    def open(self, address: Address) -> Source:
        """Open the source at an address."""
        module = import_module(f"anisomap.live.sources.{self.module}")
        opened: Source = getattr(module, self.function)(address)
        return opened


# fmt: off
SOURCES: Mapping[str, Entry] = MappingProxyType({
    "-": Entry("-", "lines on standard input", "lines", "standard_input"),
    "tcp": Entry("tcp://HOST:PORT", "lines from a TCP server", "lines", "tcp"),
    "tcp-listen": Entry("tcp-listen://HOST:PORT", "lines from a TCP client that connects to us",
                        "lines", "tcp_listen"),
    "udp": Entry("udp://HOST:PORT", "lines in UDP datagrams", "lines", "udp"),
    "serial": Entry("serial:///dev/ttyUSB0?baud=115200", "lines from a serial port",
                    "lines", "serial_port"),
    "lsl": Entry("lsl://NAME", "stream of the Lab Streaming Layer", "middleware", "lsl"),
    "rosbridge": Entry("rosbridge://HOST:9090/TOPIC", "topic of ROS through rosbridge",
                       "middleware", "rosbridge"),
    "zenoh": Entry("zenoh://KEY?connect=tcp/HOST:7447", "topic of ROS 2 through Zenoh",
                   "middleware", "zenoh"),
    "yarp": Entry("yarp://HOST:10000/PORT", "port of YARP", "middleware", "yarp"),
})
# fmt: on
"""Kinds of sources by the scheme of their addresses."""


def open_source(text: str, *, speed: float = 1.0) -> Source:
    """Open a source."""
    scheme, colon, _ = text.partition("://")
    if text == "-" or (colon and scheme in SOURCES):
        try:
            return SOURCES[scheme].open(Address(urlsplit(text)))
        except InputError:
            raise
        except ValueError as error:
            raise InputError(f"{text} is not an address: {error}") from error
    if Path(text).exists():
        return replay(Path(text), speed)
    known = ", ".join(entry.example for entry in SOURCES.values())
    raise InputError(f"there is no file {text}, and it is no address: {known}")
