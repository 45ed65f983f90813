"""What a source of a live session is, and what it yields."""

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
"""Longest time in seconds for which a source waits before it looks whether it must stop."""

_MAX_READING = float(np.finfo(np.float32).max)  # quick maps are of float32

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
    """Names of all sensors, which a source learns while it runs."""

    names: tuple[str, ...]


@dataclass(frozen=True)
class Notice:
    """An event that users should know of, such as a lost connection, in one sentence."""

    text: str


Item: TypeAlias = Batch | Names | Notice


@dataclass(frozen=True)
class Address:
    """An address of a source, such as ``tcp://HOST:PORT``, and what sources need of it."""

    parts: SplitResult

    @property
    def host(self) -> str:
        """Name or number of a computer; this one by default."""
        return self.parts.hostname or "127.0.0.1"

    @property
    def port(self) -> int:
        """Port, which must be given."""
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
        """Everything before the query, without slashes around it."""
        return unquote(self.parts.netloc + self.parts.path).strip("/")

    @property
    def query(self) -> dict[str, str]:
        """Options by name."""
        return {key: values[-1] for key, values in parse_qs(self.parts.query).items()}


class Source(ABC):
    """A source of readings, which is opened again when its connection is lost.

    description: Origin, for the recording and the page.
    greeting: Said when it is open, with its description.
    names, truth: Names and true positions of the sensors, if they are known before the first frame.
    grid: Rows and columns of the sensors, if they are given.
    ends: Whether the session ends with it, instead of waiting for another connection.
    can_wait: Whether nothing is lost if it begins later, as in a replay: it begins when the
        processes that make maps have started.
    lost: Errors that mean that there is no connection.
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
        """Wait for `WAIT_S` at most: a TimeoutError says that nothing came, an EOFError the end."""

    @abstractmethod
    def parse(self, content: Any) -> Iterable[Item]:
        """Find the frames in what was received."""

    def wait(self) -> Iterable[Item]:
        """Find frames in what is held, when nothing has come."""
        return ()

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over what arrives, until the source ends or an event is set."""
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
