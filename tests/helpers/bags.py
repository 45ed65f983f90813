"""ROS bags with every kind of tactile message, written with rosbags."""

import functools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rosbag1 = pytest.importorskip("rosbags.rosbag1")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")

DEFINITIONS = {
    "tactile_msgs/msg/TactileState": "std_msgs/Header header\nsensor_msgs/ChannelFloat32[] sensors",
    "xela_server_ros2/msg/Taxel": "int16 x\nint16 y\nint16 z",
    "xela_server_ros2/msg/SensorFull": "uint8 sensor_pos\nTaxel[] taxels",
    "xela_server_ros2/msg/SensStream": "SensorFull[] sensors",
    "sr_robot_msgs/msg/Biotac": "int16 pdc\nint16[19] electrodes",
    "sr_robot_msgs/msg/BiotacAll": "std_msgs/Header header\nBiotac[5] tactiles",
    "tum_ics_skin_msgs/msg/SkinCellData": "int32 cellId\nfloat32[] prox\nfloat32[] force",
    "m3skin_ros/msg/TaxelArray": "std_msgs/Header header\n"
    + "\n".join(f"float64[] {part}_{axis}" for part in ("centers", "values") for axis in "xyz"),
    "lab_msgs/msg/TaxelArray": "float64[] values_x\nfloat64[] values_y\nfloat64[] values_z",
    "lab_msgs/msg/SkinCellData": "float32[] force",
    "lab_msgs/msg/Mixed": "float32[] skin\nfloat32[] joints\nfloat32 temperature",
}
START = 1_700_000_000 * 10**9


@functools.cache
def _store(version: str) -> Any:
    store = typesys.get_typestore(typesys.Stores[version])
    for name, text in DEFINITIONS.items():
        store.register(typesys.get_types_from_msg(text, name))
    return store


class Bag:
    """A bag under construction: messages of one type store."""

    def __init__(self, kind: str) -> None:
        self.kind = kind
        self.store = _store("ROS1_NOETIC" if kind == "bag" else "ROS2_HUMBLE")
        self.messages: list[tuple[str, Any, int]] = []

    def make(self, name: str, /, *values: Any, **fields: Any) -> Any:
        package, _, short = name.partition("/")
        return self.store.types[f"{package}/msg/{short}"](*values, **fields)

    def header(self, frame: int, rate: float = 50.0) -> Any:
        stamp = START + round(frame / rate * 1e9)
        time = self.make("builtin_interfaces/Time", sec=stamp // 10**9, nanosec=stamp % 10**9)
        sequence = {"seq": frame} if self.kind == "bag" else {}
        return self.make("std_msgs/Header", stamp=time, frame_id="skin", **sequence)

    def array(self, values: np.ndarray) -> Any:
        layout = self.make("std_msgs/MultiArrayLayout", dim=[], data_offset=0)
        return self.make("std_msgs/Float64MultiArray", layout=layout, data=values)

    def add(self, topic: str, message: Any, frame: int, rate: float = 50.0) -> None:
        # Received 1 to 3 ms after being sent.
        received = START + round(frame / rate * 1e9) + 10**6 * (1 + frame % 3)
        self.messages.append((topic, message, received))

    def write(self, path: Path, packed: str = "", **options: Any) -> Path:
        """Write all messages to a file; for ROS 2, the file inside the bag's folder."""
        if self.kind == "bag":
            writer = rosbag1.Writer(path)
            if packed:
                writer.set_compression(rosbag1.Writer.CompressionFormat[packed])
            with writer:
                self.fill(writer, self.store.serialize_ros1)
            return path
        plugin = (
            rosbag2.StoragePlugin.MCAP if self.kind == "mcap" else rosbag2.StoragePlugin.SQLITE3
        )
        folder = path.with_suffix("")
        with rosbag2.Writer(folder, version=9, storage_plugin=plugin, **options) as writer:
            self.fill(writer, self.store.serialize_cdr)
        (inner,) = folder.glob(f"*.{self.kind}")
        return inner.replace(path)

    def fill(self, writer: Any, serialize: Any) -> None:
        connections: dict[str, Any] = {}
        for topic, message, received in self.messages:
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=self.store)
            writer.write(connections[topic], received, serialize(message, kind))
