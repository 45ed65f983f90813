"""Sources that speak the protocols of robots and laboratories: LSL, rosbridge, Zenoh and YARP."""

from __future__ import annotations

import json
import queue
import re
import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from threading import Event
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError, import_extra
from anisomap.io.ros.bags import kind_of, values_at
from anisomap.live.batches import (
    RETRY_S,
    WAIT_S,
    Address,
    Batch,
    ConnectedSource,
    Item,
    Names,
    Notice,
    Source,
)
from anisomap.live.sources.lines import READ_BYTES, LineParser, received

_RESOLVE_S = 1.0  # for one search for an LSL stream; it is repeated
_BUFFER_S = 60  # that the library of LSL keeps if we are slow

_MAX_MESSAGE = 1 << 24  # bytes of a message of rosbridge
_MAX_WAITING = 4096  # messages; Zenoh holds back the sender when the queue is full
_DEFAULT_TYPE = "std_msgs/msg/Float32MultiArray"
_DDS = "::dds_::"
_MIN_SENSORS = 2

_ANSWER_S = 2.0  # for an answer of the name server of YARP
_OURS = b"CONNECT anisomap\n"
_REGISTRATION = re.compile(rb"registration name (\S+) ip (\S+) port (\d{1,5}) type")
_END = b"*** end of message"
_DATA = re.compile(r"do?(?:\s+\d+\s+(\d+(?:\.\d*)?))?")
_BRACKETS = str.maketrans("()", "  ")


class LslStream(Source):
    """A stream of numbers, found by its name. The library recovers lost connections itself."""

    def __init__(self, address: Address) -> None:
        if not address.name:
            raise InputError("an LSL stream needs a name, as in lsl://NAME")
        super().__init__(f"LSL stream {address.name}")
        self._name = address.name
        self._lsl = import_extra("pylsl", "reading an LSL stream", "lsl")

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames."""
        found = self._lsl.resolve_byprop("name", self._name, 1, 0.0)
        if not found:
            yield Notice(f"looking for {self.description}")
        while not found and not stop.is_set():
            found = self._lsl.resolve_byprop("name", self._name, 1, _RESOLVE_S)
        if stop.is_set():
            return
        if found[0].channel_format() == self._lsl.cf_string:
            raise InputError(f"{self.description} holds text; a stream of numbers is needed")
        inlet = self._lsl.StreamInlet(found[0], _BUFFER_S, recover=True)
        yield Notice(f"found {self.description}")
        info = inlet.info()
        labels = [str(label) for label in info.get_channel_labels() or () if label]
        if len(labels) == info.channel_count():
            yield Names(tuple(labels))
        last = -np.inf
        while not stop.is_set():
            samples, stamps = inlet.pull_chunk(timeout=WAIT_S)
            if len(stamps):
                times = np.asarray(stamps, dtype=np.float64)
                increase, last = times[0] > last, times[-1]
                yield Batch(np.asarray(samples, dtype=np.float64), times if increase else None)
        inlet.close_stream()


class Rosbridge(ConnectedSource):
    """A topic of ROS as JSON over a websocket, without ROS on this computer.

    The option ``type`` is the type of the messages, ``field`` the path of the readings in them, as
    in ``data``. The protocol is rosbridge 2.0: ``{"op": "subscribe", "topic": ...}`` is answered
    with ``{"op": "publish", "topic": ..., "msg": ...}``. It is spoken directly over the library
    websockets: roslibpy needs the reactor of Twisted, which can be started once per process, and
    holds what arrives in memory without a limit.
    """

    def __init__(self, address: Address) -> None:
        if not address.path:
            raise InputError("rosbridge needs a topic, as in rosbridge://HOST:9090/skin")
        self._url, self._topic = f"ws://{address.endpoint}", address.path
        super().__init__(f"topic {self._topic} of rosbridge {address.endpoint}")
        self._type, self._field = address.query.get("type", ""), address.query.get("field", "")
        self._client = import_extra("websockets.sync.client", "reading rosbridge", "rosbridge")
        errors = import_extra("websockets.exceptions", "reading rosbridge", "rosbridge")
        self.lost = (OSError, errors.WebSocketException)

    def connect(self) -> Any:
        """Connect to rosbridge."""
        return self._client.connect(
            self._url, open_timeout=RETRY_S, max_size=_MAX_MESSAGE, compression=None
        )

    def receive(self, connection: Any, stop: Event) -> Iterator[Item]:
        """Subscribe, and iterate over the frames."""
        request = {"op": "subscribe", "topic": self._topic}
        if self._type:
            request["type"] = self._type
        connection.send(json.dumps(request))
        while not stop.is_set():
            with suppress(TimeoutError):
                text = connection.recv(timeout=WAIT_S)
                yield from self._items_in(text)

    def _items_in(self, text: str | bytes) -> Iterator[Item]:
        try:
            packet = json.loads(text, object_hook=lambda fields: SimpleNamespace(**fields))
        except (ValueError, RecursionError):
            packet = None
        operation = getattr(packet, "op", "")
        if operation == "status":
            yield Notice(f"rosbridge says: {getattr(packet, 'msg', '')}")
        ours = getattr(packet, "topic", self._topic) == self._topic
        if not operation or (operation == "publish" and ours):
            yield item_of(getattr(packet, "msg", None), self._type, self._field)


class ZenohTopic(Source):
    """A key expression of Zenoh, of which the samples are messages of ROS 2 in CDR.

    The key of zenoh-bridge-ros2dds is the topic, such as ``skin``; that of rmw_zenoh is
    ``0/skin/**``, from which the type is known. The option ``connect`` is the endpoint of a router
    or peer, such as ``tcp/192.168.0.5:7447``; by default peers are searched for. ``type`` is the
    type of the messages, Float32MultiArray by default, ``field`` the path of the readings.
    """

    def __init__(self, address: Address) -> None:
        if not address.name:
            raise InputError("Zenoh needs a key, as in zenoh://skin?connect=tcp/HOST:7447")
        super().__init__(f"Zenoh key {address.name}")
        self._key, self._query = address.name, address.query
        self._zenoh = import_extra("zenoh", "reading Zenoh", "zenoh")
        typesys = import_extra("rosbags.typesys", "reading Zenoh", "zenoh")
        self._store = typesys.get_typestore(typesys.Stores.LATEST)
        self._type = self._query.get("type", "")
        if self._type and self._type not in self._store.fielddefs:
            raise InputError(f"there is no message type {self._type}, as in {_DEFAULT_TYPE}")

    def items(self, stop: Event) -> Iterator[Item]:
        """Iterate over the frames."""
        waiting: queue.Queue[tuple[str, bytes]] = queue.Queue(_MAX_WAITING)

        def receive(sample: Any) -> None:
            while not stop.is_set():
                with suppress(queue.Full):
                    waiting.put((str(sample.key_expr), sample.payload.to_bytes()), timeout=WAIT_S)
                    return

        config = self._zenoh.Config()
        if endpoint := self._query.get("connect"):
            config.insert_json5("connect/endpoints", json.dumps([endpoint]))
            config.insert_json5("scouting/multicast/enabled", "false")
        try:
            session = self._zenoh.open(config)
            session.declare_subscriber(self._key, receive)
        except self._zenoh.ZError as error:
            raise InputError(f"cannot subscribe to {self.description}: {error}") from error
        yield Notice(f"waiting for {self.description}")
        with session:
            while not stop.is_set():
                with suppress(queue.Empty):
                    yield self._decoded(*waiting.get(timeout=WAIT_S))

    def _decoded(self, key: str, content: bytes) -> Item:
        kind = self._type or _type_in(key) or _DEFAULT_TYPE
        try:
            message = self._store.deserialize_cdr(content, kind)
        except Exception as error:  # what rosbags raises for damaged messages is undocumented
            return Notice(f"ignored a message that is no {kind}: {type(error).__name__}")
        return item_of(message, kind, self._query.get("field", ""))


def _type_in(key: str) -> str:
    """Return the type in a key of rmw_zenoh: ``std_msgs::msg::dds_::Float32MultiArray_``."""
    for part in key.split("/"):
        if _DDS in part:
            package, _, name = part.partition(_DDS)
            return f"{package.replace('::', '/')}/{name.removesuffix('_')}"
    return ""


def item_of(message: Any, message_type: str, field: str) -> Batch | Notice:
    """Return the frame in a message of ROS: objects of JSON, or those of a decoder."""
    kind = kind_of(message_type, []) if message_type else None
    try:
        if field:
            values = values_at(message, field)
        elif kind is not None:
            values = kind.values(message, kind.field)
        else:
            values = max(_lists_in(message), key=len, default=np.empty(0))
        row = np.asarray(values, dtype=np.float64)
    except (AttributeError, TypeError, ValueError):
        row = np.empty(0)
    if row.ndim != 1 or row.size < _MIN_SENSORS:
        shown = f" {message_type}" if message_type else ""
        return Notice(f"ignored a message{shown} that holds no list of numbers")
    return Batch(row[None], _time_of(message))


def _lists_in(message: Any) -> Iterator[NDArray[Any]]:
    """Iterate over all lists of numbers in a message."""
    if isinstance(message, list | tuple | np.ndarray):
        try:
            array = np.asarray(message)
        except ValueError:
            array = np.empty(0)
        if array.dtype.kind in "iuf":
            yield array.ravel()
            return
        for item in message:
            yield from _lists_in(item)
    elif hasattr(message, "__dict__"):
        for item in vars(message).values():
            yield from _lists_in(item)


def _time_of(message: Any) -> NDArray[np.float64] | None:
    """Return the stamp of a message in seconds, shape (1,); None if it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    whole = getattr(stamp, "sec", getattr(stamp, "secs", None))
    parts = getattr(stamp, "nanosec", getattr(stamp, "nsecs", None))
    if not isinstance(whole, int) or not isinstance(parts, int) or not (whole or parts):
        return None
    return np.array([whole + parts / 1e9])


class YarpPort(ConnectedSource):
    """An output port of YARP in its text protocol, without YARP on this computer.

    The name server at the address is asked for the address of the port; the connection to the port
    is then reversed (``r``), so that the port sends what it writes: a line ``do``, with a count and
    a stamp if it has them, and a line of values (YARP documentation, "YARP without YARP").
    """

    def __init__(self, address: Address) -> None:
        if not address.path:
            raise InputError("YARP needs a port, as in yarp://HOST:10000/icub/skin/torso_comp")
        super().__init__(f"YARP port {address.path}")
        self._server, self._name = (address.host, address.port), address.path

    def connect(self) -> socket.socket:
        """Ask the name server for the address of the port, and connect to the port."""
        with socket.create_connection(self._server, _ANSWER_S) as connection:
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
        place = found[2].decode("ascii", "replace"), int(found[3])
        return socket.create_connection(place, _ANSWER_S)

    def receive(self, connection: socket.socket, stop: Event) -> Iterator[Item]:
        """Iterate over the frames."""
        connection.sendall(_OURS + b"r\n")
        yield from received(connection, LineParser(_yarp_translation()), stop)


def _yarp_translation() -> Callable[[str], str]:
    """Return a function that joins the values of a frame with the stamp in the line before."""
    stamp = ""

    def translate(line: str) -> str:
        nonlocal stamp
        if found := _DATA.fullmatch(line):
            stamp = found[1] or ""
            return ""
        if line.startswith("Welcome"):
            return ""
        values = ",".join(line.translate(_BRACKETS).split())
        return f'{{"t":{stamp},"values":[{values}]}}' if stamp else values

    return translate
