"""ROS 2 launch files with one static transform per sensor, for ``ros2 launch skin.launch.xml``.

Each transform is a process, so this format suits tens of sensors. For hundreds, use URDF with
``robot_state_publisher``.
"""

from __future__ import annotations

import shlex
from pathlib import Path

from anisomap.io.maps import xml_files
from anisomap.io.maps.xml_files import tag
from anisomap.sensor_map import SensorMap


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map with a scale and one component as static transforms."""
    skin = xml_files.named_taxels(sensor_map, "a static transform")
    lines = ["<launch>", *xml_files.map_comments(sensor_map, "frame")]
    quaternions = skin.rotations.as_quat()
    for index, name, position, turn in zip(
        skin.indices, skin.names, skin.positions, quaternions, strict=True
    ):
        pose = zip(("x", "y", "z", "qx", "qy", "qz", "qw"), (*position, *turn), strict=True)
        words = " ".join(f"--{key} {float(value)!r}" for key, value in pose)
        frames = f"--frame-id {_quote(skin.frame)} --child-frame-id {_quote(name)}"
        node = {
            "pkg": "tf2_ros",
            "exec": "static_transform_publisher",
            "name": f"taxel_{index}",
            "args": f"{words} {frames}",
        }
        lines.append(tag("node", node))
    path.write_text("\n".join([*lines, "</launch>", ""]), encoding="utf-8")


def _quote(name: str) -> str:
    r"""Quote a name for the launch system, which substitutes in `args` and then splits it.

    Substitutions start with ``$(``; a backslash makes the next character literal.
    """
    return shlex.quote(name).replace("\\", "\\\\").replace("$", "\\$")
