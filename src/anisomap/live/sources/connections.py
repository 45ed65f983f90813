"""Sources that other programs send: lines of text, and the protocols of robots and laboratories."""

from __future__ import annotations

import json
import math
import os
import queue
import re
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field
from itertools import groupby
from threading import Event
from types import SimpleNamespace
from typing import Any, TypeAlias

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

READ_BYTES = 1 << 16
"""Number of bytes that are read at once."""

MAX_LINE = 1 << 22
"""Bytes; a longer line is no frame. A frame of 100,000 sensors in JSON has fewer."""

_MIN_SENSORS = 2
_MISSING = frozenset({"", "nan", "null", "none", "na", "-"})
_TIMES = frozenset({"t", "time", "time_s", "timestamp", "stamp"})
_SHOWN = 40  # characters of a line in a notice
_RECEIVE_BUFFER = 1 << 22  # of datagrams, which the system drops when it is full
_BAUD = "115200"

_RESOLVE_S = 1.0  # for one search for an LSL stream; it is repeated
_BUFFER_S = 60  # that the library of LSL keeps if we are slow

_MAX_MESSAGE = 1 << 24  # bytes of a message of rosbridge
_MAX_WAITING = 4096  # messages; Zenoh holds back the sender when the queue is full
_DEFAULT_TYPE = "std_msgs/msg/Float32MultiArray"
_DDS = "::dds_::"

_ANSWER_S = 2.0  # for an answer of the name server of YARP
_OURS = b"CONNECT anisomap\n"
_REGISTRATION = re.compile(rb"registration name (\S+) ip (\S+) port (\d{1,5}) type")
_END = b"*** end of message"
_DATA = re.compile(r"do?(?:\s+\d+\s+(\d+(?:\.\d*)?))?")
_BRACKETS = str.maketrans("()", "  ")

_Frame: TypeAlias = tuple[float | None, list[float]]


@dataclass
class LineParser:
    """Splits bytes into lines and parses each as a frame.

    A line is numbers separated by commas, semicolons or white space, a JSON array of numbers, or a
    JSON object with a list of numbers, or with one number per sensor. An object may have a time in
    seconds (``t``, ``time`` or ``timestamp``). A first line of text names the sensors; a column
    ``time`` among them holds the times. Empty fields, ``nan`` and ``null`` are missing readings.

    translate: Turns a line of another format into one of these; empty if it holds no frame.
    """

    translate: Callable[[str], str] = str
    _rest: bytearray = field(default_factory=bytearray)
    _names: tuple[str, ...] = ()
    _time_column: int | None = None
    _overlong: bool = False
    _width: int = 0

    def feed(self, content: bytes, *, complete: bool = False) -> Iterator[Item]:
        """Parse the next bytes."""
        frames: list[_Frame] = []
        for found in self._frames(content, complete):
            if isinstance(found, tuple):
                frames.append(found)
            else:
                yield found
        # Consecutive frames of one width, with times or without, are a batch.
        for _, alike in groupby(frames, lambda frame: (frame[0] is None, len(frame[1]))):
            times, rows = zip(*alike, strict=True)
            yield Batch(np.array(rows), None if times[0] is None else np.array(times))

    def _frames(self, content: bytes, complete: bool) -> Iterator[_Frame | Names | Notice]:
        """Parse whole lines, and keep the rest."""
        # The rest is only added to while no line ends: a line may come byte by byte.
        ended, end, rest = content.rpartition(b"\n")
        lines: list[bytes] = []
        if end:
            lines = bytes(self._rest + ended).split(b"\n")
            self._rest.clear()
        self._rest += rest
        if complete:
            lines.append(bytes(self._rest))
            self._rest.clear()
        elif len(self._rest) > MAX_LINE:
            self._rest.clear()
            self._overlong = True
        for line in lines:
            if self._overlong:  # the end of a line of which the beginning was discarded
                self._overlong = False
                yield _rejected(f"a line of more than {MAX_LINE} bytes")
                continue
            text = self.translate(line.decode("utf-8", "replace").strip())
            if not text or text.startswith("#"):
                continue
            try:
                yield from self._parse(text)
            except (ValueError, OverflowError, RecursionError):
                yield _rejected(repr(text[:_SHOWN]))

    def _parse(self, text: str) -> Iterator[_Frame | Names]:
        """Yield the names that a line gives, if they are new, and its frame."""
        if text[0] in "[{":
            yield from self._parse_json(text)
            return
        fields = _split(text)
        if len(fields) > 1 and not fields[-1] and len(fields) != self._width:
            fields.pop()  # every line ends with a separator
        self._width = self._width or len(fields)
        try:
            row = [math.nan if one.lower() in _MISSING else float(one) for one in fields]
        except ValueError:
            if self._names or not _are_names(fields):
                raise
            clock = next((i for i, name in enumerate(fields) if name.lower() in _TIMES), None)
            self._time_column = clock
            self._names = tuple(name for i, name in enumerate(fields) if i != clock)
            yield Names(self._names)
            return
        moment = None
        if self._time_column is not None and len(row) == len(self._names) + 1:
            moment = row.pop(self._time_column)
        yield _checked(moment, row)

    def _parse_json(self, text: str) -> Iterator[_Frame | Names]:
        value: Any = json.loads(text)
        moment: Any = None
        if isinstance(value, dict):
            for key in [key for key in value if key.lower() in _TIMES]:
                moment = value.pop(key)
            lists = [item for item in value.values() if isinstance(item, list)]
            if lists:
                value = max(lists, key=len)
            else:
                known = {k: item for k, item in value.items() if item is None or _is_real(item)}
                if not self._names and len(known) >= _MIN_SENSORS:
                    self._names = tuple(known)
                    yield Names(self._names)
                # In the order of the first object.
                value = [known.pop(name, None) for name in self._names] + list(known.values())
        if not all(item is None or _is_real(item) for item in value):
            raise ValueError("no list of numbers")
        row = [math.nan if item is None else float(item) for item in value]
        yield _checked(float(moment) if _is_real(moment) else None, row)


def _rejected(what: str) -> Notice:
    return Notice(f"ignored a line that holds no frame of numbers: {what}")


def _split(text: str) -> list[str]:
    for mark in (",", ";", "\t"):
        if mark in text:
            return [field.strip().strip('"') for field in text.split(mark)]
    return text.split()


def _is_real(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _checked(moment: float | None, row: list[float]) -> _Frame:
    if len(row) < _MIN_SENSORS:
        raise ValueError("fewer than two numbers")
    return (moment if moment is not None and math.isfinite(moment) else None), row


def _are_names(fields: list[str]) -> bool:
    """Return whether fields are a header: distinct printable texts, none of which is a number."""
    return (
        len(set(fields)) == len(fields) >= _MIN_SENSORS
        and all(text and text.isprintable() for text in fields)
        and not any(re.fullmatch(r"[-+]?[\d.]+(e[-+]?\d+)?", text.lower()) for text in fields)
    )


def standard_input(_: Address) -> Source:
    """Lines from standard input, until its end."""
    held: queue.Queue[bytes] = queue.Queue(maxsize=16)

    def read() -> None:
        content = b"-"
        while content:
            content = os.read(sys.stdin.fileno(), READ_BYTES)
            held.put(content)

    def items(stop: Event) -> Iterator[Item]:
        # The thread ends with the process: not all systems can wait for standard input.
        threading.Thread(target=read, daemon=True).start()
        parser = LineParser()
        for content in polled(stop, lambda: held.get(timeout=WAIT_S), queue.Empty):
            yield from parser.feed(content, complete=not content)
            if not content:
                yield Notice("standard input has ended")
                return

    return Source("standard input", items)


def received(
    connection: socket.socket, stop: Event, translate: Callable[[str], str] = str
) -> Iterator[Item]:
    """Parse what a socket receives, until its end; a cut last line is dropped."""
    connection.settimeout(WAIT_S)
    parser = LineParser(translate)
    for content in polled(stop, lambda: connection.recv(READ_BYTES)):
        if not content:
            return
        yield from parser.feed(content)


def tcp(address: Address) -> Source:
    """Lines from a server."""
    endpoint = (address.host, address.port)
    return connected(
        f"tcp://{address.endpoint}", lambda: socket.create_connection(endpoint, RETRY_S), received
    )


def tcp_listen(address: Address) -> Source:
    """Lines from one client at a time, which connects to us."""
    listener, port = _listening(socket.SOCK_STREAM, address)

    def items(stop: Event) -> Iterator[Item]:
        with closing(listener):
            yield Notice(f"waiting for a connection on port {port}")
            for connection, peer in polled(stop, listener.accept):
                yield Notice(f"{peer[0]} connected")
                with closing(connection), suppress(OSError):
                    yield from received(connection, stop)
                if not stop.is_set():
                    yield Notice(f"{peer[0]} closed the connection; waiting for the next")

    return Source(f"tcp-listen://{address.endpoint}", items, port=port)


def udp(address: Address) -> Source:
    """Datagrams, each with one or several whole lines."""
    receiver, port = _listening(socket.SOCK_DGRAM, address)

    def receive() -> bytes:
        try:
            return receiver.recv(READ_BYTES)
        except ConnectionError as error:  # on Windows, of a datagram that was sent
            raise TimeoutError from error

    def items(stop: Event) -> Iterator[Item]:
        parser = LineParser()
        with closing(receiver):
            with suppress(OSError):
                receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            yield Notice(f"waiting for datagrams on port {port}")
            for content in polled(stop, receive):
                yield from parser.feed(content, complete=True)

    return Source(f"udp://{address.endpoint}", items, port=port)


def _listening(kind: socket.SocketKind, address: Address) -> tuple[socket.socket, int]:
    """Open a port, so that one in use is reported before the session starts; return its number."""
    host, port = address.host, address.port
    made = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET, kind)
    try:
        if kind == socket.SOCK_STREAM and os.name == "posix":
            made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        made.bind((host, port))
        if kind == socket.SOCK_STREAM:  # until a socket listens, others can be bound to its port
            made.listen(1)
    except (OSError, OverflowError) as error:
        made.close()
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"cannot listen on {host}:{port}: {reason}") from error
    made.settimeout(WAIT_S)
    return made, int(made.getsockname()[1])


def serial_port(address: Address) -> Source:
    """Lines from a serial port, which is opened again when it was unplugged.

    The option ``baud`` is the number of symbols per second.
    """
    device = address.parts.netloc or address.parts.path
    library = import_extra("serial", "reading a serial port", "serial")
    baud = address.query.get("baud", _BAUD)
    if not baud.isdecimal() or int(baud) < 1:
        raise InputError(f"baud must be a number of symbols per second, got {baud!r}")

    def connect() -> Any:
        return first.pop() if first else library.Serial(device, int(baud), timeout=WAIT_S)

    first: list[Any] = []
    try:
        first.append(connect())
    except (OSError, ValueError) as error:  # SerialException is an OSError
        raise InputError(f"cannot open serial port {device}: {error}") from error

    def receive(port: Any, stop: Event) -> Iterator[Item]:
        parser = LineParser()
        for content in polled(stop, lambda: port.read(max(1, min(port.in_waiting, READ_BYTES)))):
            yield from parser.feed(content)

    # TypeError: pyserial, if the port is closed meanwhile
    return connected(f"serial port {device}", connect, receive, (OSError, TypeError))


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
