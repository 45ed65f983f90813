"""Read topics of tactile sensors from ROS 1 and ROS 2 bags and MCAP files.

A message is a tree of fields. Readings are addressed by a path, and each list of messages on the
path contributes a part of the sensor names. A new message type is usually one line in `KINDS`.

Layouts: MCAP specification, and "Bag File Format, version 2.0" (ROS 1).
"""

from __future__ import annotations

import fnmatch
import io
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.base.columns import XYZ
from anisomap.base.wording import join_items
from anisomap.errors import DamagedError, FileError, import_extra
from anisomap.files.paths import check_regular, read_small
from anisomap.io.presets import grid_names, grid_positions
from anisomap.io.stream import (
    Content,
    Frame,
    ReadOptions,
    Stream,
    choose,
    join_streams,
    stack_frames,
)

EXTRA = "ros"

_MCAP, _ROS1 = b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n"

MAGICS = {_ROS1: ".bag", _MCAP: ".mcap", b"SQLite format 3\0": ".db3"}
"""Magic numbers, and the suffixes that rosbags expects."""

METADATA = "metadata.yaml"
"""The file that identifies a folder as a ROS 2 bag."""

_MAX_DEFINITION = 1 << 17  # thousands of fields; rosbags reads 0.2 MB/s

_HEADER_BYTES, _INDEX_AT = 4096, b"index_pos="  # header of a ROS 1 bag, and key of its index

_CELLS = ("cellId", "cell_id")
_LABELS = ("name", "sensor_pos", *_CELLS)
_CHANNELS = {"mono": 1, "rgb": 3, "bgr": 3, "rgba": 4, "bgra": 4}
_DEPTHS = {"U": "u", "S": "i", "F": "f"}
_WRAP = 1 << 16
_TAXELS = "sensors.taxels"  # XELA taxels, with three axes each


def values_at(message: Any, path: str) -> NDArray[Any]:
    """Return all numbers at a path, in order."""
    parts = [np.atleast_1d(np.asarray(value)).ravel() for _, value in _walk(message, path)]
    return np.concatenate(parts) if parts else np.empty(0)


def names_at(message: Any, path: str) -> tuple[str, ...]:
    """Name the numbers at a path by the enclosing list items; empty without unique names."""
    names = []
    for label, value in _walk(message, path):
        names += [f"{label}.{i}" for i in range(np.size(value))] if np.ndim(value) else [label]
        if not label:
            return ()
    return tuple(names) if len(set(names)) == len(names) else ()


@dataclass(frozen=True)
class Kind:
    """Extraction of readings, names and positions in metres of the sensors of a message.

    field: Default path of the readings, such as ``"sensors.taxels.z"``.
    wraps: Whether readings are 16-bit counters that overflow.
    cell: Whether each message contains a single skin cell.
    """

    field: str
    values: Callable[[Any, str], NDArray[Any]] = values_at
    names: Callable[[Any, str], tuple[str, ...]] = names_at
    positions: Callable[[Any], NDArray[np.float64] | None] | None = None
    wraps: bool = False
    cell: bool = False


def unwrap_counters(values: NDArray[Any], first: NDArray[Any]) -> NDArray[np.float64]:
    """Return 16-bit counters, signed or not, as differences from the first, without overflow."""
    steps = values.astype(np.int64) - first.astype(np.int64)
    return np.asarray((steps + _WRAP // 2) % _WRAP - _WRAP // 2, dtype=np.float64)


def cell_of(message: Any) -> str:
    """Return the skin cell of a message."""
    return _label(message, _CELLS, "", "")


def kind_of(message_type: str, fields: list[str]) -> Kind | None:
    """Return the `Kind` of a message type with arrays of numbers in some fields."""
    package, _, name = message_type.partition("/msg/")
    known = KINDS.get(f"{package}/{name}") or KINDS.get(name)
    if known or not fields:
        return known
    only = fields[0] if len(fields) == 1 else ""
    return Kind("data" if "data" in fields and "Array" in name else only)


def is_tactile(message_type: str) -> bool:
    """Return whether a message type is intended for arrays of sensors."""
    return kind_of(message_type, []) is not None or message_type.endswith("MultiArray")


def _walk(value: Any, path: str, label: str = "", part: str = "") -> Iterator[tuple[str, Any]]:
    if isinstance(value, list | tuple):
        for index, item in enumerate(value):
            own = _label(item, _LABELS, "" if label else part, index)
            yield from _walk(item, path, f"{label}.{own}" if label else own)
    elif path:
        field, _, rest = path.partition(".")
        yield from _walk(getattr(value, field), rest, label, field.removesuffix("s"))
    else:
        yield label, value


def _label(message: Any, names: Iterable[str], part: str, index: object) -> str:
    """Return the first existing field of a message among `names`, else its index in a list.

    A number is appended to the name of the part, since links and frames of robots require names.
    """
    name = next((name for name in names if hasattr(message, name)), "")
    label = str(getattr(message, name) if name else index)
    return f"{'cell' if name in _CELLS else part}{label}" if label.isdecimal() else label


def _pixels(message: Any, _: str) -> NDArray[Any]:
    """Return the pixels of an image in row-major order; colour channels are averaged."""
    height, width, encoding = message.height, message.width, message.encoding
    kind, channels = _encoding(encoding)
    if message.is_bigendian:
        kind = kind.newbyteorder(">")
    used = width * channels * kind.itemsize
    if message.step < used or len(message.data) < height * message.step:
        raise ValueError(f"the image of {height} x {width} pixels ({encoding}) is truncated")
    rows = np.asarray(message.data)[: height * message.step].reshape(height, message.step)
    pixels = np.ascontiguousarray(rows[:, :used]).view(kind).reshape(height * width, channels)
    return pixels[:, 0] if channels == 1 else pixels[:, :3].mean(axis=1)


def _encoding(encoding: str) -> tuple[np.dtype[Any], int]:
    """Parse an encoding such as mono8, bgr8, 16UC1 or 32FC3 into dtype and channels."""
    colours = encoding.rstrip("0123456789")
    if colours in _CHANNELS:
        return np.dtype(f"u{int(encoding[len(colours) :] or 8) // 8}"), _CHANNELS[colours]
    bits, _, channels = encoding.partition("C")
    if bits[-1:] not in _DEPTHS or not bits[:-1].isdecimal() or not (channels or "1").isdecimal():
        raise ValueError(f"unsupported image encoding {encoding!r}; use mono, rgb, bgr or 32FC1")
    return np.dtype(f"{_DEPTHS[bits[-1]]}{int(bits[:-1]) // 8}"), int(channels or 1)


def _lengths(message: Any, path: str) -> NDArray[np.float64]:
    """Return the lengths of vectors that are stored as ``values_x``, ``values_y``, ``values_z``."""
    if path != "values":
        return values_at(message, path)
    parts = [np.asarray(getattr(message, f"values_{axis}"), np.float64) for axis in "xyz"]
    return np.asarray(np.sqrt(sum(part**2 for part in parts)))


def _vectors(message: Any, path: str) -> NDArray[Any]:
    """Return x, y and z of each taxel, or a single axis if the path contains it."""
    if path != _TAXELS:
        return values_at(message, path)
    return np.stack([values_at(message, f"{path}.{axis}") for axis in XYZ], axis=1).ravel()


def _names_of_vectors(message: Any, path: str) -> tuple[str, ...]:
    if path != _TAXELS:
        return names_at(message, path)
    count = values_at(message, f"{path}.x").size
    names = names_at(message, f"{path}.x") or tuple(f"taxel{i}" for i in range(count))
    return tuple(f"{name}_{axis}" for name in names for axis in XYZ)


def _centres(message: Any) -> NDArray[np.float64] | None:
    parts = [np.asarray(getattr(message, f"centers_{axis}"), np.float64) for axis in "xyz"]
    return np.column_stack(parts) if len({part.size for part in parts}) == 1 else None


KINDS: Mapping[str, Kind] = MappingProxyType(
    {
        "TactileState": Kind("sensors.values"),
        "SensStream": Kind(_TAXELS, _vectors, _names_of_vectors, wraps=True),
        "BiotacAll": Kind("tactiles.electrodes"),
        "SkinCellData": Kind("force", cell=True),
        "SkinCellDataArray": Kind("data.force"),
        "TaxelArray": Kind("values", _lengths, lambda *_: (), positions=_centres),
        "sensor_msgs/Range": Kind("range", names=lambda *_: ("range",)),
        "sensor_msgs/Image": Kind(
            "data",
            _pixels,
            lambda message, _: grid_names(message.height, message.width),
            positions=lambda message: grid_positions(message.height, message.width),
        ),
    }
)
"""Known message types by name, or by package and name if the name is ambiguous."""


_NUMBERS = {
    *("bool", "byte", "char", "float32", "float64"),
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
}
_MAX_DEPTH = 4
_NANOSECONDS = 1e9

_Times: TypeAlias = tuple[float, float]
"""Times at which a message was sent and received, in seconds from the start of the bag."""


def recognises(path: Path, head: bytes) -> bool:
    """Recognise a ROS 2 folder by its metadata.yaml."""
    return (path / METADATA).is_file()


def contents(path: Path, options: ReadOptions) -> tuple[Content, ...]:
    """List the topics of a bag."""
    with _open(path, options) as bag:
        return bag.contents()


@contextmanager
def open_recording(path: Path, options: ReadOptions) -> Iterator[Stream]:
    """Open the selected topics (``/xela:sensors.taxels.x``, ``/a,/b``, ``/range/*``) of a bag.

    Times are the stamps of the messages, or the times of receipt if the stamps do not increase.
    """
    with _open(path, options) as bag:
        streams = {topic: bag.stream(topic, field) for topic, field in bag.select(options.select)}
        yield replace(join_streams(streams), source=f"{path.name}:{', '.join(streams)}")


@contextmanager
def _open(path: Path, options: ReadOptions) -> Iterator[_Bag]:
    highlevel = import_extra("rosbags.highlevel", "reading bags", EXTRA)
    typesys = import_extra("rosbags.typesys", "reading bags", EXTRA)
    bag_path = prepare(path)
    store = typesys.get_typestore(typesys.Stores.LATEST)
    register_definitions(store, options.definitions)
    with highlevel.AnyReader([bag_path], default_typestore=store) as reader:
        register_definitions(reader.typestore, options.definitions)
        yield _Bag(path, reader)


@dataclass(frozen=True)
class _Bag:
    """An open bag."""

    path: Path
    reader: Any

    def contents(self) -> tuple[Content, ...]:
        """List the topics; if any is tactile, only tactile topics are usable."""
        topics = dict(self.reader.topics)
        types = {topic: str(info.msgtype or "") for topic, info in topics.items()}
        tactile = any(map(is_tactile, types.values()))
        fits = is_tactile if tactile else self.array_fields
        usable = {topic: bool(fits(types[topic]) and topics[topic].msgcount) for topic in topics}
        return tuple(
            Content(str(topic), f"{info.msgtype}, messages: {info.msgcount}", usable[topic])
            for topic, info in topics.items()
        )

    def select(self, select: str) -> list[tuple[str, str]]:
        """Return the selected topics, each with the requested field, which may be empty."""
        topics = self.contents()
        found = []
        for part in select.split(","):
            topic, _, field = part.strip().partition(":")
            named = [each.name for each in topics if fnmatch.fnmatchcase(each.name, topic)]
            if not ("*" in topic and named):
                named = [choose(self.path, topics, topic, "topic").name]
            found += [(name, field) for name in named]
        return found

    def stream(self, topic: str, field: str) -> Stream:
        """Create a stream of a topic."""
        message_type = str(self.reader.topics[topic].msgtype)
        fields = self.array_fields(message_type) or self.array_fields(message_type, in_lists=True)
        if message_type not in self.reader.typestore.fielddefs:
            lacked = f"the definition of message type {message_type} of {topic}"
            raise FileError(f"{self.path} lacks {lacked}; give it (--msg FILE)")
        kind = kind_of(message_type, fields)
        field = field or (kind.field if kind else "")
        if kind is None or not field:
            problem = "has no array of numbers"
            if fields:
                problem = f"needs a field, --select TOPIC:FIELD; fields: {join_items(fields)}"
            raise FileError(f"{self.path}: {topic} ({message_type}) {problem}")
        return _Topic(self, topic, message_type, field, kind).stream()

    def messages(self, topic: str) -> Iterator[tuple[Any, int]]:
        """Yield the messages of a topic with their time of receipt in nanoseconds."""
        connections = [each for each in self.reader.connections if each.topic == topic]
        for connection, stamp, raw in self.reader.messages(connections):
            if not isinstance(stamp, int):  # a database may contain any type
                raise DamagedError(f"{self.path}: the stamp of a message is not a whole number")
            yield self.reader.deserialize(raw, connection.msgtype), stamp

    def array_fields(
        self, message_type: str, depth: int = 0, *, in_lists: bool = False, inside: bool = False
    ) -> list[str]:
        """List the paths of all arrays of numbers in a message type, or numbers in its lists.

        inside: Whether the type is that of the messages of a list.
        """
        if depth > _MAX_DEPTH or message_type not in self.reader.typestore.fielddefs:
            return []
        found = []
        for name, (node, description) in self.reader.typestore.fielddefs[message_type][1]:
            listed = node.name in ("ARRAY", "SEQUENCE")
            inner, what = description[0] if listed else (node, description)
            if inner.name == "NAME":
                within = self.array_fields(
                    str(what), depth + 1, in_lists=in_lists, inside=inside or (listed and in_lists)
                )
                found += [f"{name}.{rest}" for rest in within]
            elif (listed or inside) and what[0] in _NUMBERS:
                found.append(name)
        return found


@dataclass(frozen=True)
class _Topic:
    """A topic of a bag; a frame is a message, or a round of messages of all skin cells."""

    bag: _Bag
    name: str
    message_type: str
    field: str
    kind: Kind

    def stream(self) -> Stream:
        """Create a stream of the sensors in the first message, or of all cells."""
        first = next(((m, values) for m, values, _ in self._messages() if values.size), None)
        if first is None:
            raise FileError(f"{self.bag.path}: no message of {self.name} holds a reading")
        message, values = first
        positions = None
        if self.kind.cell:
            sizes, leader = self._cells()
            names = tuple(f"{cell}.{i}" for cell, size in sizes.items() for i in range(size))
            n_sensors, frames = len(names), self._rounds(sizes, leader)
        else:
            n_sensors, frames = values.size, self._frames(values)
            try:
                names = self.kind.names(message, self.field)
                positions = self.kind.positions(message) if self.kind.positions else None
            except (AttributeError, TypeError) as error:
                what = f"{self.name} lacks a field of its type"
                raise FileError(f"{self.bag.path}: {what} ({error})") from error
        if positions is not None and len(positions) != n_sensors:
            positions = None
        total = max(int(self.bag.reader.topics[self.name].msgcount), 1)
        return Stream(
            self.bag.path,
            n_sensors,
            stack_frames(
                Frame(readings, min(number / total, 1.0), *times)
                for number, (readings, times) in enumerate(frames, start=1)
            ),
            names=names if len(names) == n_sensors else (),
            positions=positions,
            units="" if positions is None else "m" if positions.shape[1] == 3 else "pixels",
            metadata={
                "format": "ROS bag",
                "topic": self.name,
                "message": self.message_type,
                "field": self.field,
            },
            from_zero=True,
            raw_columns=self.field == _TAXELS,
        )

    def _messages(self) -> Iterator[tuple[Any, NDArray[Any], _Times]]:
        """Yield the messages with readings and times."""
        start = int(self.bag.reader.start_time)
        for message, received in self.bag.messages(self.name):
            stamp = getattr(getattr(message, "header", None), "stamp", None)
            sent = 0 if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)
            times = ((sent or received) - start) / _NANOSECONDS, (received - start) / _NANOSECONDS
            yield message, self._values(message), times

    def _values(self, message: Any) -> NDArray[Any]:
        try:
            values = self.kind.values(message, self.field)
        except AttributeError as error:
            known = join_items(self.bag.array_fields(self.message_type))
            problem = f"{self.name} has no field {self.field!r}; fields: {known}"
            raise FileError(f"{self.bag.path}: {problem}") from error
        except (ValueError, TypeError) as error:
            raise FileError(f"{self.bag.path}: {self.name}: {error}") from error
        if values.dtype.kind not in "biuf":
            problem = f"field {self.field} of {self.name} does not hold numbers"
            raise FileError(f"{self.bag.path}: {problem}")
        return values

    def _frames(self, first: NDArray[Any]) -> Iterator[tuple[NDArray[Any], _Times]]:
        convert = partial(unwrap_counters, first=first) if self.kind.wraps else np.asarray
        for number, (_, values, times) in enumerate(self._messages()):
            if values.size:
                self._check_size(f"message {number}", values, first.size)
                yield convert(values), times

    def _cells(self) -> tuple[dict[str, int], str]:
        """Return the number of readings of each skin cell, and the cell with most messages."""
        sizes, counts = dict[str, int](), Counter[str]()
        with suppress(Exception):  # errors are raised again when the frames are read
            for message, values, _ in self._messages():
                cell = cell_of(message)
                sizes.setdefault(cell, values.size)
                counts[cell] += 1
        return sizes, max(sizes, key=counts.__getitem__)

    def _rounds(self, sizes: dict[str, int], leader: str) -> Iterator[tuple[NDArray[Any], _Times]]:
        """Yield the latest readings of all cells before each message of the `leader`."""
        starts = dict(zip(sizes, np.cumsum([0, *sizes.values()]).tolist(), strict=False))
        state = np.full(sum(sizes.values()), np.nan)
        known, latest = set[str](), (0.0, 0.0)
        for message, values, times in self._messages():
            cell = cell_of(message)
            if cell == leader and len(known) == len(sizes):
                yield state.copy(), latest
            self._check_size(f"a message of cell {cell}", values, sizes[cell])
            state[starts[cell] : starts[cell] + values.size] = values
            latest = times
            known.add(cell)
        if len(known) == len(sizes):
            yield state.copy(), latest

    def _check_size(self, what: str, values: NDArray[Any], expected: int) -> None:
        if values.size != expected:
            problem = f"has {values.size} readings instead of {expected}, as the first"
            raise FileError(f"{self.bag.path}: {what} of {self.name} {problem}")


def prepare(path: Path) -> Path:
    """Return the path to open with rosbags, which requires a suffix and a closed bag."""
    if path.is_dir():
        for each in path.iterdir():
            check_regular(each)
        return path
    with _BagFile(path) as file:
        start = file.read(_HEADER_BYTES)
        suffix = next((s for magic, s in MAGICS.items() if start.startswith(magic)), path.suffix)
        if suffix == ".mcap":
            file.seek(max(file.size - len(_MCAP), 0))
            _check_closed(path, file.read() == _MCAP, "mcap recover {0} -o whole.mcap")
        elif suffix == ".bag":
            _, _, after = start.partition(_INDEX_AT)
            index = int.from_bytes(after[:8], "little")
            _check_closed(path, 0 < index < file.size, "rosbag reindex {0}")
    opens = {"suffix": suffix, "open": lambda self, *_, **__: _BagFile(path)}
    opened: Path = type("BagPath", (type(path),), opens)(path)
    return opened


def _check_closed(path: Path, closed: bool, repair: str) -> None:
    if not closed:
        raise FileError(f"{path} was not closed; repair it first: {repair.format(path.name)}")


def register_definitions(store: Any, files: Iterable[Path]) -> None:
    """Register message definitions from files in a type store."""
    typesys = import_extra("rosbags.typesys", "reading bags", EXTRA)
    for file in files:
        text = read_small(file, _MAX_DEFINITION, "a message definition")
        store.register(typesys.get_types_from_msg(text, _type_name(file)))


def _type_name(file: Path) -> str:
    package, _, name = file.stem.rpartition(".")
    if not package and file.parent.name == "msg":
        package = file.absolute().parent.parent.name
    if not package:
        raise FileError(f"the package of {file} is unknown; name the file PACKAGE.NAME.msg")
    return f"{package}/msg/{name}"


class _BagFile(io.BufferedReader):
    """A file that limits reads to its size, since Python allocates memory before reading."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path, "r"))
        self.size = self.seek(0, io.SEEK_END)
        self.seek(0)

    def read(self, size: int | None = -1) -> bytes:
        """Read at most `size` bytes."""
        left = max(self.size - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))
