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
from anisomap.io.recordings.bags import kind_of, values_at
from anisomap.live.batches import (
    RETRY_S,
    WAIT_S,
    Address,
    Batch,
    Item,
    Names,
    Notice,
    Source,
    connected,
    polled,
)
from anisomap.live.sources.lines import READ_BYTES, received

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


def lsl(address: Address) -> Source:
    """Return a stream of numbers, found by its name; the library recovers lost connections."""
    name = address.name
    if not name:
        raise InputError("an LSL stream needs a name, as in lsl://NAME")
    description = f"LSL stream {name}"
    library = import_extra("pylsl", "reading an LSL stream", "lsl")

    def items(stop: Event) -> Iterator[Item]:
        found = library.resolve_byprop("name", name, 1, 0.0)
        if not found:
            yield Notice(f"looking for {description}")
        while not found and not stop.is_set():
            found = library.resolve_byprop("name", name, 1, _RESOLVE_S)
        if stop.is_set():
            return
        if found[0].channel_format() == library.cf_string:
            raise InputError(f"{description} holds text; a stream of numbers is needed")
        inlet = library.StreamInlet(found[0], _BUFFER_S, recover=True)
        yield Notice(f"found {description}")
        info = inlet.info()
        labels = [str(label) for label in info.get_channel_labels() or () if label]
        if len(labels) == info.channel_count():
            yield Names(tuple(labels))
        last = -np.inf
        for samples, stamps in polled(stop, lambda: inlet.pull_chunk(timeout=WAIT_S)):
            if len(stamps):
                times = np.asarray(stamps, dtype=np.float64)
                increase, last = times[0] > last, times[-1]
                yield Batch(np.asarray(samples, dtype=np.float64), times if increase else None)
        inlet.close_stream()

    return Source(description, items)


def rosbridge(address: Address) -> Source:
    """Return a topic of ROS as JSON over a websocket, without ROS on this computer.

    The option ``type`` is the type of the messages, ``field`` the path of the readings in them, as
    in ``data``. The protocol is rosbridge 2.0: ``{"op": "subscribe", "topic": ...}`` is answered
    with ``{"op": "publish", "topic": ..., "msg": ...}``.
    """
    topic = address.path
    if not topic:
        raise InputError("rosbridge needs a topic, as in rosbridge://HOST:9090/skin")
    kind, field = address.query.get("type", ""), address.query.get("field", "")
    client = import_extra("websockets.sync.client", "reading rosbridge", "rosbridge")
    errors = import_extra("websockets.exceptions", "reading rosbridge", "rosbridge")

    def connect() -> Any:
        url = f"ws://{address.endpoint}"
        return client.connect(url, open_timeout=RETRY_S, max_size=_MAX_MESSAGE, compression=None)

    def receive(connection: Any, stop: Event) -> Iterator[Item]:
        request = {"op": "subscribe", "topic": topic} | ({"type": kind} if kind else {})
        connection.send(json.dumps(request))
        for text in polled(stop, lambda: connection.recv(timeout=WAIT_S)):
            try:
                packet = json.loads(text, object_hook=lambda fields: SimpleNamespace(**fields))
            except (ValueError, RecursionError):
                packet = None
            operation = getattr(packet, "op", "")
            if operation == "status":
                yield Notice(f"rosbridge says: {getattr(packet, 'msg', '')}")
            ours = getattr(packet, "topic", topic) == topic
            if not operation or (operation == "publish" and ours):
                yield item_of(getattr(packet, "msg", None), kind, field)

    description = f"topic {topic} of rosbridge {address.endpoint}"
    return connected(description, connect, receive, (OSError, errors.WebSocketException))


def zenoh(address: Address) -> Source:
    """Return a key expression of Zenoh, of which the samples are messages of ROS 2 in CDR.

    The key of zenoh-bridge-ros2dds is the topic, such as ``skin``; that of rmw_zenoh is
    ``0/skin/**``, from which the type is known. The option ``connect`` is the endpoint of a router
    or peer, such as ``tcp/192.168.0.5:7447``; by default peers are searched for. ``type`` is the
    type of the messages, Float32MultiArray by default, ``field`` the path of the readings.
    """
    key, query = address.name, address.query
    if not key:
        raise InputError("Zenoh needs a key, as in zenoh://skin?connect=tcp/HOST:7447")
    description = f"Zenoh key {key}"
    library = import_extra("zenoh", "reading Zenoh", "zenoh")
    typesys = import_extra("rosbags.typesys", "reading Zenoh", "zenoh")
    store = typesys.get_typestore(typesys.Stores.LATEST)
    given, field = query.get("type", ""), query.get("field", "")
    if given and given not in store.fielddefs:
        raise InputError(f"there is no message type {given}, as in {_DEFAULT_TYPE}")

    def items(stop: Event) -> Iterator[Item]:
        waiting: queue.Queue[tuple[str, bytes]] = queue.Queue(_MAX_WAITING)

        def receive(sample: Any) -> None:
            while not stop.is_set():
                with suppress(queue.Full):
                    waiting.put((str(sample.key_expr), sample.payload.to_bytes()), timeout=WAIT_S)
                    return

        config = library.Config()
        if endpoint := query.get("connect"):
            config.insert_json5("connect/endpoints", json.dumps([endpoint]))
            config.insert_json5("scouting/multicast/enabled", "false")
        try:
            session = library.open(config)
            session.declare_subscriber(key, receive)
        except library.ZError as error:
            raise InputError(f"cannot subscribe to {description}: {error}") from error
        yield Notice(f"waiting for {description}")
        with session:
            for name, content in polled(stop, lambda: waiting.get(timeout=WAIT_S), queue.Empty):
                yield _decoded(store, given or _type_in(name) or _DEFAULT_TYPE, content, field)

    return Source(description, items)


def _decoded(store: Any, kind: str, content: bytes, field: str) -> Item:
    try:
        message = store.deserialize_cdr(content, kind)
    except Exception as error:  # what rosbags raises for damaged messages is undocumented
        return Notice(f"ignored a message that is no {kind}: {type(error).__name__}")
    return item_of(message, kind, field)


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


def yarp(address: Address) -> Source:
    """Return an output port of YARP in its text protocol, without YARP on this computer.

    The name server at the address is asked for the address of the port; the connection to the port
    is then reversed (``r``), so that the port sends what it writes: a line ``do``, with a count and
    a stamp if it has them, and a line of values (YARP documentation, "YARP without YARP").
    """
    name, server = address.path, (address.host, address.port)
    if not name:
        raise InputError("YARP needs a port, as in yarp://HOST:10000/icub/skin/torso_comp")

    def connect() -> socket.socket:
        with socket.create_connection(server, _ANSWER_S) as connection:
            connection.sendall(_OURS + f"d\nquery {name}\n".encode())
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

    def receive(connection: socket.socket, stop: Event) -> Iterator[Item]:
        connection.sendall(_OURS + b"r\n")
        yield from received(connection, stop, _yarp_translation())

    return connected(f"YARP port {name}", connect, receive)


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
