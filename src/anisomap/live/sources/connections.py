"""Sources that other programs send: lines of text, and the protocols of robots and laboratories."""

from __future__ import annotations

import json
import os
import queue
import re
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
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
    Found,
    Frame,
    Names,
    Notice,
    Source,
    connected,
    polled,
)
from anisomap.live.sources.lines import MIN_SENSORS, LineParser

READ_BYTES = 1 << 16
"""Number of bytes that are read at once."""

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


def _lines(
    translate: Callable[[str], str] = str, complete: Callable[[bytes], bool] = lambda _: False
) -> Callable[[bytes], Iterator[Found]]:
    """Return a function that parses what is received; it ends the connection at the end of it.

    complete: Returns whether the last line of what was received is whole without an end of line.
    """
    parser = LineParser(translate)

    def parse(content: bytes) -> Iterator[Found]:
        yield from parser.feed(content, complete=complete(content))
        if not content:
            raise EOFError

    return parse


def _from_socket(connection: socket.socket) -> bytes:
    return connection.recv(READ_BYTES)


def _from_queue(waiting: queue.Queue[Any]) -> Any:
    try:
        return waiting.get(timeout=WAIT_S)
    except queue.Empty:
        raise TimeoutError from None


def standard_input(_: Address) -> Source:
    """Lines from standard input, until its end."""

    @contextmanager
    def connect(_: Event) -> Iterator[queue.Queue[bytes]]:
        held: queue.Queue[bytes] = queue.Queue(maxsize=16)

        def read() -> None:
            content = b"-"
            while content:
                content = os.read(sys.stdin.fileno(), READ_BYTES)
                held.put(content)

        # The thread ends with the process: not all systems can wait for standard input.
        threading.Thread(target=read, daemon=True).start()
        yield held

    def parser(_: object) -> Callable[[bytes], Iterator[Found]]:
        return _lines(complete=lambda content: not content)

    return connected("standard input", connect, _from_queue, parser, greeting="", again=False)


def tcp(address: Address) -> Source:
    """Lines from a server; a line that is cut by the end of a connection is dropped."""

    @contextmanager
    def connect(_: Event) -> Iterator[socket.socket]:
        with socket.create_connection((address.host, address.port), RETRY_S) as connection:
            connection.settimeout(WAIT_S)
            yield connection

    return connected(f"tcp://{address.endpoint}", connect, _from_socket, lambda _: _lines())


def tcp_listen(address: Address) -> Source:
    """Lines from one client at a time, which connects to us."""
    listener, port = _listening(socket.SOCK_STREAM, address)
    listener.settimeout(WAIT_S)

    @contextmanager
    def connect(stop: Event) -> Iterator[socket.socket]:
        found = next(polled(stop, listener.accept), None)
        if found is None:
            raise TimeoutError
        with found[0] as connection:
            connection.settimeout(WAIT_S)
            yield connection

    made = connected(
        f"tcp-listen://{address.endpoint}",
        connect,
        _from_socket,
        lambda _: _lines(),
        peer=f"a client of port {port}",
        waiting=f"waiting for a connection on port {port}",
        held=listener,
    )
    made.port = port
    return made


def udp(address: Address) -> Source:
    """Datagrams, each with one or several whole lines."""
    receiver, port = _listening(socket.SOCK_DGRAM, address)
    receiver.settimeout(WAIT_S)

    @contextmanager
    def connect(_: Event) -> Iterator[socket.socket]:
        with receiver:
            with suppress(OSError):
                receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            yield receiver

    def receive(_: socket.socket) -> bytes:
        try:
            return receiver.recv(READ_BYTES) or b"\n"
        except ConnectionError as error:  # on Windows, of a datagram that was sent
            raise TimeoutError from error

    def parser(_: object) -> Callable[[bytes], Iterator[Found]]:
        return _lines(complete=lambda _: True)

    greeting = f"waiting for datagrams on port {port}"
    made = connected(f"udp://{address.endpoint}", connect, receive, parser, greeting=greeting)
    made.port = port
    return made


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

    def connect(_: Event) -> Any:
        return first.pop() if first else library.Serial(device, int(baud), timeout=WAIT_S)

    def receive(port: Any) -> bytes:
        content: bytes = port.read(max(1, min(port.in_waiting, READ_BYTES)))
        if not content:
            raise TimeoutError
        return content

    first: list[Any] = []
    try:
        first.append(library.Serial(device, int(baud), timeout=WAIT_S))
    except (OSError, ValueError) as error:  # SerialException is an OSError
        raise InputError(f"cannot open serial port {device}: {error}") from error
    # TypeError: pyserial, if the port is closed meanwhile
    description, lost = f"serial port {device}", (TypeError,)
    return connected(description, connect, receive, lambda _: _lines(), lost=lost)


def lsl(address: Address) -> Source:
    """Return a stream of numbers, found by its name; the library recovers lost connections."""
    name = address.name
    if not name:
        raise InputError("an LSL stream needs a name, as in lsl://NAME")
    description = f"LSL stream {name}"
    library = import_extra("pylsl", "reading an LSL stream", "lsl")

    @contextmanager
    def connect(_: Event) -> Iterator[Any]:
        found = library.resolve_byprop("name", name, 1, _RESOLVE_S)
        if not found:
            raise OSError("not found")
        if found[0].channel_format() == library.cf_string:
            raise InputError(f"{description} holds text; a stream of numbers is needed")
        inlet = library.StreamInlet(found[0], _BUFFER_S, recover=True)
        try:
            yield inlet
        finally:
            inlet.close_stream()

    def receive(inlet: Any) -> tuple[list[list[float]], list[float]]:
        samples, stamps = inlet.pull_chunk(timeout=WAIT_S)
        return samples, stamps

    def parser(inlet: Any) -> Callable[[Any], Iterator[Found]]:
        info = inlet.info()
        labels = [str(label) for label in info.get_channel_labels() or () if label]
        named = [Names(tuple(labels))] if len(labels) == info.channel_count() else []
        last = -np.inf

        def parse(chunk: tuple[list[list[float]], list[float]]) -> Iterator[Found]:
            nonlocal last
            while named:
                yield named.pop()
            samples, stamps = chunk
            known = bool(stamps) and stamps[0] > last
            for stamp, sample in zip(stamps, samples, strict=True):
                last = stamp
                yield (stamp if known else None, sample)

        return parse

    return connected(description, connect, receive, parser)


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

    @contextmanager
    def connect(_: Event) -> Iterator[Any]:
        options = {"open_timeout": RETRY_S, "max_size": _MAX_MESSAGE, "compression": None}
        with client.connect(f"ws://{address.endpoint}", **options) as connection:
            request = {"op": "subscribe", "topic": topic} | ({"type": kind} if kind else {})
            connection.send(json.dumps(request))
            yield connection

    def parse(text: str) -> Iterator[Found]:
        try:
            packet = json.loads(text, object_hook=lambda fields: SimpleNamespace(**fields))
        except (ValueError, RecursionError):
            packet = None
        operation = getattr(packet, "op", "")
        if operation == "status":
            yield Notice(f"rosbridge says: {getattr(packet, 'msg', '')}")
        ours = getattr(packet, "topic", topic) == topic
        if not operation or (operation == "publish" and ours):
            yield frame_of(getattr(packet, "msg", None), kind, field)

    return connected(
        f"topic {topic} of rosbridge {address.endpoint}",
        connect,
        lambda connection: connection.recv(timeout=WAIT_S),
        lambda _: parse,
        lost=(errors.WebSocketException,),
    )


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

    @contextmanager
    def connect(stop: Event) -> Iterator[queue.Queue[tuple[str, bytes]]]:
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
        with session:
            yield waiting

    def parse(sample: tuple[str, bytes]) -> Iterator[Found]:
        name, content = sample
        kind = given or _type_in(name) or _DEFAULT_TYPE
        try:
            message = store.deserialize_cdr(content, kind)
        except Exception as error:  # what rosbags raises for damaged messages is undocumented
            yield Notice(f"ignored a message that is no {kind}: {type(error).__name__}")
            return
        yield frame_of(message, kind, field)

    greeting = f"waiting for {description}"
    return connected(description, connect, _from_queue, lambda _: parse, greeting=greeting)


def _type_in(key: str) -> str:
    """Return the type in a key of rmw_zenoh: ``std_msgs::msg::dds_::Float32MultiArray_``."""
    for part in key.split("/"):
        if _DDS in part:
            package, _, name = part.partition(_DDS)
            return f"{package.replace('::', '/')}/{name.removesuffix('_')}"
    return ""


def frame_of(message: Any, message_type: str, field: str) -> Frame | Notice:
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
    if row.ndim != 1 or row.size < MIN_SENSORS:
        shown = f" {message_type}" if message_type else ""
        return Notice(f"ignored a message{shown} that holds no list of numbers")
    return (_time_of(message), row)


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


def _time_of(message: Any) -> float | None:
    """Return the stamp of a message in seconds; None if it has none."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    whole = getattr(stamp, "sec", getattr(stamp, "secs", None))
    parts = getattr(stamp, "nanosec", getattr(stamp, "nsecs", None))
    if not isinstance(whole, int) or not isinstance(parts, int) or not (whole or parts):
        return None
    return whole + parts / 1e9


def yarp(address: Address) -> Source:
    """Return an output port of YARP in its text protocol, without YARP on this computer.

    The name server at the address is asked for the address of the port; the connection to the port
    is then reversed (``r``), so that the port sends what it writes: a line ``do``, with a count and
    a stamp if it has them, and a line of values (YARP documentation, "YARP without YARP").
    """
    name, server = address.path, (address.host, address.port)
    if not name:
        raise InputError("YARP needs a port, as in yarp://HOST:10000/icub/skin/torso_comp")

    @contextmanager
    def connect(_: Event) -> Iterator[socket.socket]:
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
        with socket.create_connection(place, _ANSWER_S) as connection:
            connection.sendall(_OURS + b"r\n")
            connection.settimeout(WAIT_S)
            yield connection

    return connected(
        f"YARP port {name}", connect, _from_socket, lambda _: _lines(yarp_translation())
    )


def yarp_translation() -> Callable[[str], str]:
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
