"""A topic of ROS 2 through Zenoh, without ROS on this computer; rosbags decodes its messages."""

from __future__ import annotations

import json
import queue
from collections.abc import Iterator, Mapping
from contextlib import suppress
from threading import Event
from typing import Any

import numpy as np

from anisomap.errors import InputError, import_extra
from anisomap.live.batches import WAIT_S, Batch, Item, Notice
from anisomap.live.sources.messages import readings_of, time_of
from anisomap.sensor_map import SensorMap

EXTRA = "zenoh"

_DEFAULT_TYPE = "std_msgs/msg/Float32MultiArray"
_DDS = "::dds_::"
_MAX_WAITING = 4096  # messages; Zenoh holds back the sender when the queue is full


class ZenohTopic:
    """A key expression of Zenoh, of which the samples are messages of ROS 2 in CDR.

    key: That of zenoh-bridge-ros2dds is the topic, such as ``skin``; that of rmw_zenoh is
        ``0/skin/**``, from which the type is known.
    query: ``connect``: endpoint of a router or peer, such as ``tcp/192.168.0.5:7447``; by default
        peers are searched for. ``type``: type of the messages, Float32MultiArray by default.
        ``field``: path of the readings.
    """

    def __init__(self, key: str, query: Mapping[str, str]) -> None:
        if not key:
            raise InputError("Zenoh needs a key, as in zenoh://skin?connect=tcp/HOST:7447")
        self.description = f"Zenoh key {key}"
        self.names: tuple[str, ...] = ()
        self.truth: SensorMap | None = None
        self._key, self._query = key, query
        self._zenoh = import_extra("zenoh", "reading Zenoh", EXTRA)
        typesys = import_extra("rosbags.typesys", "reading Zenoh", EXTRA)
        self._store = typesys.get_typestore(typesys.Stores.LATEST)
        self._type = query.get("type", "")
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

        try:
            session = self._zenoh.open(self._config())
            session.declare_subscriber(self._key, receive)
        except self._zenoh.ZError as error:
            raise InputError(f"cannot subscribe to {self.description}: {error}") from error
        yield Notice(f"waiting for {self.description}")
        with session:
            while not stop.is_set():
                with suppress(queue.Empty):
                    yield self._frame(*waiting.get(timeout=WAIT_S))

    def _config(self) -> Any:
        config = self._zenoh.Config()
        if endpoint := self._query.get("connect"):
            config.insert_json5("connect/endpoints", json.dumps([endpoint]))
            config.insert_json5("scouting/multicast/enabled", "false")
        return config

    def _frame(self, key: str, content: bytes) -> Item:
        kind = self._type or _type_in(key) or _DEFAULT_TYPE
        try:
            message = self._store.deserialize_cdr(content, kind)
        except Exception as error:  # what rosbags raises for damaged messages is undocumented
            return Notice(f"ignored a message that is no {kind}: {type(error).__name__}")
        row = readings_of(message, kind, self._query.get("field", ""))
        if row is None:
            return Notice(f"ignored a message without a list of numbers: {kind}")
        moment = time_of(message)
        return Batch(row[None], None if moment is None else np.array([moment]))


def _type_in(key: str) -> str:
    """Return the type in a key of rmw_zenoh: ``std_msgs::msg::dds_::Float32MultiArray_``."""
    for part in key.split("/"):
        if _DDS in part:
            package, _, name = part.partition(_DDS)
            return f"{package.replace('::', '/')}/{name.removesuffix('_')}"
    return ""
