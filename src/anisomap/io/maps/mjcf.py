"""MJCF models for MuJoCo: sensors are sites of one body, in metres, with z along the normal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from anisomap.errors import FileError
from anisomap.io.maps import xml_files
from anisomap.io.maps.xml_files import format_numbers, tag
from anisomap.sensor_map import SensorMap


def recognises(path: Path, head: bytes) -> bool:
    """Recognise MJCF by its root element."""
    return xml_files.root_is(head, "mujoco")


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map with a scale and one component as a model of one body with sites."""
    skin = xml_files.named_taxels(sensor_map, "MJCF")
    quaternions = skin.rotations.as_quat(scalar_first=True)
    size = repr(xml_files.SENSOR_RADIUS)
    lines = [
        tag("mujoco", {"model": skin.frame}, closed=False),
        *xml_files.map_comments(sensor_map, "site"),
        "<worldbody>",
        tag("body", {"name": skin.frame}, closed=False),
    ]
    for name, position, turn in zip(skin.names, skin.positions, quaternions, strict=True):
        pose = {"pos": format_numbers(position), "quat": format_numbers(turn)}
        lines.append(tag("site", {"name": name, **pose, "size": size}))
    path.write_text("\n".join([*lines, "</body>", "</worldbody>", "</mujoco>", ""]), "utf-8")


def read_map(path: Path) -> SensorMap:
    """Read the sites of one body as sensors, in the frame of that body."""
    root: Any = xml_files.parse_xml(path)
    owners = [element for element in root.iter() if element.find("site") is not None]
    if len(owners) > 1:
        raise FileError(f"{path}: sites must belong to one body, got {len(owners)} bodies")
    positions = {}
    for owner in owners:
        for i, site in enumerate(owner.findall("site")):
            name = site.get("name", f"site{i}")
            if name in positions:
                raise FileError(f"{path}: two sites have the name {name!r}")
            pos = site.get("pos", "0 0 0")
            positions[name] = xml_files.parse_vector(path, f"pos of {name!r}", pos)
    return xml_files.map_from_positions(path, positions, "sites")
