"""ROS 2 launch files that publish a static transform a sensor.

``ros2 launch skin.launch.xml`` runs them. Each transform is a process of its own, so this is for
tens of sensors; URDF and ``robot_state_publisher`` serve hundreds.
"""

from __future__ import annotations

from pathlib import Path

from anisomap.io.parsing import xml_files
from anisomap.io.parsing.xml_files import tag
from anisomap.placement import taxels
from anisomap.sensor_map import SensorMap


def recognises(path: Path, head: bytes) -> bool:
    """Tell a launch file by its first element."""
    return xml_files.root_is(head, "launch")


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as a launch file.

    Parameters
    ----------
    sensor_map : SensorMap
        With a scale, in one piece. See `anisomap.placement.taxels`.
    path : pathlib.Path

    Raises
    ------
    InputError
        If the map has no scale, or is in pieces.
    FileError
        If XML cannot hold a name.
    """
    skin = taxels(sensor_map, "a static transform")
    xml_files.check_names((*skin.names, skin.frame), path)
    lines = [
        "<launch>",
        "<!-- metres, right-handed; z of each frame is the estimated normal; the map may be a "
        "mirror image of the skin -->",
    ]
    quaternions = skin.rotations.as_quat()
    for index, name, place, turn in zip(
        skin.indices, skin.names, skin.positions, quaternions, strict=True
    ):
        options = dict(zip(("x", "y", "z", "qx", "qy", "qz", "qw"), (*place, *turn), strict=True))
        words = " ".join(f"--{key} {float(value)!r}" for key, value in options.items())
        # A name may hold blanks, which would be another argument.
        ends = f"--frame-id '{_shell(skin.frame)}' --child-frame-id '{_shell(name)}'"
        node = {
            "pkg": "tf2_ros",
            "exec": "static_transform_publisher",
            "name": f"taxel_{index}",
            "args": f"{words} {ends}",
        }
        lines.append(tag("node", node))
    path.write_text("\n".join([*lines, "</launch>", ""]), encoding="utf-8")


def _shell(name: str) -> str:
    return name.replace("'", "'\\''")
