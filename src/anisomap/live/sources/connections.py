"""Connections of sources: made again when they are lost, and read in chunks."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from threading import Event
from typing import TypeVar

from anisomap.live.batches import WAIT_S, Item, Notice

RETRY_S = 1.0
"""Time in seconds between two attempts to connect."""

READ_BYTES = 1 << 16
"""Number of bytes that are read at once."""

_Connection = TypeVar("_Connection")


def stay_connected(
    description: str,
    connect: Callable[[], AbstractContextManager[_Connection]],
    receive: Callable[[_Connection, Event], Iterator[Item]],
    stop: Event,
    lost: tuple[type[Exception], ...] = (OSError,),
) -> Iterator[Item]:
    """Iterate over the items of one connection after another until `stop` is set.

    Parameters
    ----------
    description : str
        Of the source, for notices.
    connect : callable
        Opens a connection. An attempt that fails is repeated after `RETRY_S`.
    receive : callable
        ``receive(connection, stop)`` iterates over the items of a connection until it ends.
    stop : threading.Event
    lost : tuple of exception types
        What `connect` and `receive` raise if there is no connection, or no longer.
    """
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
            items = receive(connection, stop)
            while True:
                # Only errors of the source are caught, not those of the code that takes its items.
                try:
                    item = next(items)
                except (StopIteration, *lost):  # type: ignore[misc]
                    break
                yield item
        if not stop.is_set():
            yield Notice(f"lost the connection to {description}; connecting again")
            stop.wait(WAIT_S)


def chunks_of(connection: socket.socket, stop: Event) -> Iterator[bytes]:
    """Iterate over what a socket receives, until its end or until `stop` is set."""
    connection.settimeout(WAIT_S)
    while not stop.is_set():
        try:
            content = connection.recv(READ_BYTES)
        except TimeoutError:
            continue
        except OSError:
            return
        if not content:
            return
        yield content
