"""What a source of a live session is, and what it yields."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from itertools import groupby
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

Frame: TypeAlias = tuple[float | None, Sequence[float] | NDArray[np.float64]]
"""A time in seconds of the clock of the source, if it is known, and readings."""

Found: TypeAlias = Frame | Names | Notice

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


def batched(found: Iterable[Found]) -> Iterator[Item]:
    """Join consecutive frames of one width, with times or without, to batches."""
    for kind, alike in groupby(found, _kind):
        if kind is None:
            yield from (one for one in alike if not isinstance(one, tuple))
        else:
            times, rows = zip(*(one for one in alike if isinstance(one, tuple)), strict=True)
            known = None if times[0] is None else np.array(times)
            yield Batch(np.array(rows, dtype=np.float64), known)


def _kind(one: Found) -> tuple[bool, int] | None:
    return (one[0] is None, len(one[1])) if isinstance(one, tuple) else None


def polled(stop: Event, receive: Callable[[], _Received]) -> Iterator[_Received]:
    """Yield what is received until `stop` is set; a TimeoutError says that nothing came."""
    while not stop.is_set():
        try:
            received = receive()
        except TimeoutError:
            continue
        yield received


def connected(
    description: str,
    connect: Callable[[Event], AbstractContextManager[Any]],
    receive: Callable[[Any], Any],
    parser: Callable[[Any], Callable[[Any], Iterator[Found]]],
    *,
    peer: str = "",
    waiting: str = "",
    greeting: str | None = None,
    lost: tuple[type[Exception], ...] = (),
    again: bool = True,
    held: AbstractContextManager[Any] | None = None,
) -> Source:
    """Return a source with a connection, which is made again when it is lost.

    receive: Waits for something from the connection, or raises a TimeoutError.
    parser: Returns a function that finds the frames in what was received; an EOFError ends the
        connection.
    peer: The other side, in notices; by default the description.
    waiting, greeting: Notices at the beginning, and when there is a connection.
    lost: Errors besides OSError and EOFError that mean that there is no connection.
    again: Whether there may be another connection.
    held: What is open as long as the source, such as a port.
    """
    peer = peer or description
    greeting = f"connected to {peer}" if greeting is None else greeting
    ends: tuple[type[Exception], ...] = (OSError, EOFError, *lost)

    def items(stop: Event) -> Iterator[Item]:
        with held or nullcontext():
            yield from opened(stop)

    def opened(stop: Event) -> Iterator[Item]:
        told = False
        if waiting:
            yield Notice(waiting)
        while not stop.is_set():
            is_open = False
            try:
                with connect(stop) as connection:
                    is_open = True
                    if greeting:
                        yield Notice(greeting)
                    parse = parser(connection)
                    for content in polled(stop, lambda: receive(connection)):
                        yield from batched(parse(content))
            except ends as error:
                if not again:
                    yield Notice(f"{description} has ended")
                    return
                if is_open or not told:
                    yield _lost(peer, error, is_open=is_open)
                told = not is_open
                stop.wait(WAIT_S if is_open else RETRY_S)

    return Source(description, items)


def _lost(peer: str, error: Exception, *, is_open: bool) -> Notice:
    if is_open:
        return Notice(f"lost the connection to {peer}; waiting for another")
    reason = getattr(error, "strerror", None) or error
    return Notice(f"cannot connect to {peer} ({reason}); still trying")
