"""What a source of a live session is, and what it yields."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from threading import Event
from typing import Any, TypeAlias, TypeVar
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

_Received = TypeVar("_Received")


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
    def path(self) -> str:
        """What follows the host, with its first slash; empty for a slash alone."""
        path = unquote(self.parts.path)
        return path if path.strip("/") else ""

    @property
    def name(self) -> str:
        """Everything before the query, without slashes around it."""
        return unquote(self.parts.netloc + self.parts.path).strip("/")

    @property
    def query(self) -> dict[str, str]:
        """Options by name."""
        return {key: values[-1] for key, values in parse_qs(self.parts.query).items()}


@dataclass
class Source:
    """A source of frames.

    description: Origin, for the recording and the page.
    items: Iterates over what arrives, until the source ends or an event is set.
    names, truth: Names and true positions of the sensors, if they are known before the first frame.
    can_wait: Whether nothing is lost if it begins later, as in a replay: it begins when the
        processes that make maps have started.
    port: On which it listens; 0 for none.
    """

    description: str
    items: Callable[[Event], Iterator[Item]]
    names: tuple[str, ...] = ()
    truth: SensorMap | None = None
    can_wait: bool = False
    port: int = 0


def polled(
    stop: Event, receive: Callable[[], _Received], idle: type[Exception] = TimeoutError
) -> Iterator[_Received]:
    """Yield what is received until `stop` is set; `idle` is raised when nothing came in time."""
    while not stop.is_set():
        try:
            received = receive()
        except idle:
            continue
        yield received


def connected(
    description: str,
    connect: Callable[[], AbstractContextManager[Any]],
    receive: Callable[[Any, Event], Iterator[Item]],
    lost: tuple[type[Exception], ...] = (OSError,),
) -> Source:
    """Return a source with a connection, which is made again when it is lost.

    receive: Iterates over what a connection sends, until it ends or an event is set.
    lost: Errors that mean that there is no connection.
    """

    def items(stop: Event) -> Iterator[Item]:
        told = False
        while not stop.is_set():
            try:
                opened = connect()
            except lost as error:
                if not told:
                    reason = getattr(error, "strerror", None) or error
                    yield Notice(f"cannot connect to {description} ({reason}); still trying")
                told = True
                stop.wait(RETRY_S)
                continue
            told = False
            yield Notice(f"connected to {description}")
            with opened as connection:
                received = receive(connection, stop)
                while True:
                    # Only errors of the source are caught, not those of the code that takes items.
                    try:
                        item = next(received)
                    except (StopIteration, *lost):  # type: ignore[misc]
                        break
                    yield item
            if not stop.is_set():
                yield Notice(f"lost the connection to {description}; connecting again")
                stop.wait(WAIT_S)

    return Source(description, items)
