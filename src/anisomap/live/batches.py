"""Interface of the sources of live sessions, and the items that they yield."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from threading import Event
from typing import Any, TypeAlias
from urllib.parse import SplitResult, parse_qs, unquote

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError
from anisomap.sensor_map import SensorMap

WAIT_S = 0.1
"""Maximum time in seconds for which a source waits before it checks for the end."""

_MAX_READING = float(np.finfo(np.float32).max)  # quick maps use float32

RETRY_S = 1.0
"""Time in seconds between two attempts to connect."""


@dataclass(frozen=True, eq=False)
class Batch:
    """Consecutive frames of one width.

    readings (t, N): One row per frame; NaN where a reading is missing, or out of range.
    times (t,): Seconds of the clock of the source; by default the time of arrival is recorded.
    """

    readings: NDArray[np.float64]
    times: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        in_range = np.abs(self.readings) <= _MAX_READING
        object.__setattr__(self, "readings", np.where(in_range, self.readings, np.nan))


@dataclass(frozen=True)
class Names:
    """Names of all sensors, if a source receives them while it runs."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class Notice:
    """A sentence about an event for the user, such as a lost connection."""

    text: str


Item: TypeAlias = Batch | Names | Notice


@dataclass(frozen=True)
class Address:
    """An address of a source, such as ``tcp://HOST:PORT``, and its parts."""

    parts: SplitResult

    @property
    def host(self) -> str:
        """Name or number of a computer; this computer by default."""
        return self.parts.hostname or "127.0.0.1"

    @property
    def port(self) -> int:
        """Port; required."""
        if self.parts.port is None:
            url, scheme = self.parts.geturl(), self.parts.scheme
            raise InputError(f"{url} needs a port, as in {scheme}://HOST:PORT")
        return self.parts.port

    @property
    def endpoint(self) -> str:
        """Host and port as in a URL: an IPv6 address is in brackets."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    @property
    def name(self) -> str:
        """The part before the query, without enclosing slashes."""
        return unquote(self.parts.netloc + self.parts.path).strip("/")

    @property
    def query(self) -> dict[str, str]:
        """Options by name."""
        return {key: values[-1] for key, values in parse_qs(self.parts.query).items()}


class Source(ABC):
    """A source of readings; it is reopened when the connection is lost.

    description: Origin, for the recording and the page.
    greeting: Notice when the source is open, followed by the description.
    names, truth: Names and true positions of the sensors, if known before the first frame.
    grid: Rows and columns of the sensors, if given.
    ends: Whether the session ends with the source, instead of waiting for another connection.
    can_wait: Whether a later start loses nothing, as for a replay: the source then starts after the
        processes that make maps.
    lost: Errors that indicate a lost connection.
    is_open: Whether there is a connection.
    """

    description = ""
    greeting = "connected to {}"
    names: tuple[str, ...] = ()
    truth: SensorMap | None = None
    grid: tuple[int, int] | None = None
    ends = can_wait = is_open = False
    lost: tuple[type[Exception], ...] = (OSError, EOFError)

    @abstractmethod
    def open(self) -> AbstractContextManager[None]:
        """Connect, until the end of the context."""

    @abstractmethod
    def receive(self) -> Any:
        """Receive within `WAIT_S`; raise TimeoutError without content, EOFError at the end."""

    @abstractmethod
    def parse(self, content: Any) -> Iterable[Item]:
        """Find the frames in received content."""

    def wait(self) -> Iterable[Item]:
        """Find frames in buffered content, when nothing was received."""
        return ()

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over received items, until the source ends or an event is set."""
        told = False
        while not stop.is_set():
            try:
                with self.open():
                    self.is_open, told = True, False
                    if self.greeting:
                        yield Notice(self.greeting.format(self.description))
                    while not stop.is_set():
                        try:
                            content = self.receive()
                        except TimeoutError:
                            yield from self.wait()
                        else:
                            yield from self.parse(content)
            except self.lost as error:
                was_open, self.is_open = self.is_open, False
                if self.ends:
                    yield Notice(f"{self.description} has ended")
                    return
                if was_open:
                    yield Notice(f"lost the connection to {self.description}; trying again")
                elif not told:
                    reason = getattr(error, "strerror", None) or error
                    yield Notice(f"cannot connect to {self.description} ({reason}); still trying")
                    told = True
                stop.wait(WAIT_S if was_open else RETRY_S)
