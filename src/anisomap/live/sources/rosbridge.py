"""A topic of ROS through rosbridge: JSON over a websocket, without ROS on this computer.

The protocol is that of rosbridge 2.0: ``{"op": "subscribe", "topic": ...}`` is answered with
``{"op": "publish", "topic": ..., "msg": ...}``. It is spoken directly over the library websockets:
roslibpy needs the reactor of Twisted, which can be started once per process, and holds what arrives
in memory without a limit.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from threading import Event
from types import SimpleNamespace
from typing import Any

import numpy as np

from anisomap.errors import InputError, import_extra
from anisomap.live.batches import WAIT_S, Batch, Item, Notice
from anisomap.live.sources.lines import RETRY_S, stay_connected
from anisomap.live.sources.messages import readings_of, time_of
from anisomap.sensor_map import SensorMap

EXTRA = "rosbridge"

_MAX_MESSAGE = 1 << 24


class Rosbridge:
    """A topic, subscribed to again when the connection is lost.

    query: ``type``: type of the messages; ``field``: path of the readings, as in ``data``.
    """

    def __init__(self, host: str, port: int, topic: str, query: Mapping[str, str]) -> None:
        if not topic.strip("/"):
            raise InputError("rosbridge needs a topic, as in rosbridge://HOST:9090/skin")
        shown = f"[{host}]" if ":" in host else host
        self._url, self._topic = f"ws://{shown}:{port}", topic
        self.description = f"topic {topic} of rosbridge {host}:{port}"
        self.names: tuple[str, ...] = ()
        self.truth: SensorMap | None = None
        self._type, self._field = query.get("type", ""), query.get("field", "")
        self._client = import_extra("websockets.sync.client", "reading rosbridge", EXTRA)
        self._errors = import_extra("websockets.exceptions", "reading rosbridge", EXTRA)

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames, of one connection after another."""
        lost = (OSError, self._errors.WebSocketException)
        yield from stay_connected(self._url, self._connected, self._received, stop, lost)

    def _connected(self) -> Any:
        return self._client.connect(
            self._url, open_timeout=RETRY_S, max_size=_MAX_MESSAGE, compression=None
        )

    def _received(self, connection: Any, stop: Event) -> Iterator[Item]:
        request = {"op": "subscribe", "topic": self._topic}
        if self._type:
            request["type"] = self._type
        connection.send(json.dumps(request))
        while not stop.is_set():
            try:
                text = connection.recv(timeout=WAIT_S)
            except TimeoutError:
                continue
            yield from self._frame(text)

    def _frame(self, text: str | bytes) -> Iterator[Item]:
        try:
            packet = json.loads(text, object_hook=lambda fields: SimpleNamespace(**fields))
        except (ValueError, RecursionError):
            packet = None
        operation = getattr(packet, "op", "")
        if operation == "status":
            yield Notice(f"rosbridge says: {getattr(packet, 'msg', '')}")
        if operation not in ("publish", ""):
            return
        if operation and getattr(packet, "topic", self._topic) != self._topic:
            return
        message = getattr(packet, "msg", None)
        row = readings_of(message, self._type, self._field)
        if row is None:
            yield Notice("ignored a message that holds no list of numbers")
            return
        moment = time_of(message)
        yield Batch(row[None], None if moment is None else np.array([moment]))
