"""URDF, and xacro made of it: a fixed frame a sensor, and the ``tactile`` element.

A frame's z is the normal of the skin. The element is that of the URDF extension for tactile
sensors: a channel, and for each sensor its place and shape. Joints and sensors are in metres and,
as everything in URDF, right-handed.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from anisomap.errors import AnisomapWarning, FileError
from anisomap.io.parsing import xml_files
from anisomap.io.parsing.xml_files import numbers, tag
from anisomap.placement import Taxels, taxels
from anisomap.sensor_map import SensorMap

MOST_FRAMES = 100
"""More frames than this slow down everything that follows a robot's frames."""

_CHANNEL = "tactile"
_RADIUS = 0.002  # metres; of the balls that stand for sensors


def recognises(path: Path, head: bytes) -> bool:
    """Tell URDF by its first element."""
    return xml_files.root_is(head, "robot")


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as a robot of one link with fixed frames.

    Parameters
    ----------
    sensor_map : SensorMap
        With a scale, in one piece. See `anisomap.placement.taxels`.
    path : pathlib.Path
        With ``.xacro``, the elements stand in a macro that takes the parent's name.

    Raises
    ------
    InputError
        If the map has no scale, or is in pieces.
    FileError
        If XML cannot hold a name.

    Warns
    -----
    AnisomapWarning
        If there are more than `MOST_FRAMES` sensors.
    """
    skin = taxels(sensor_map, "URDF")
    xml_files.check_names((*skin.names, skin.frame), path)
    if len(skin.names) > MOST_FRAMES:
        warnings.warn(
            f"{len(skin.names)} sensors make as many frames, which slows down what follows them; "
            f"above {MOST_FRAMES}, take the tactile element or another format",
            AnisomapWarning,
            stacklevel=2,
        )
    macro = path.suffix.lower() == ".xacro"
    parent = "${parent}" if macro else skin.frame
    body = [*_frames(skin, parent), *_tactile(skin, parent)]
    note = (
        f"<!-- {len(skin.names)} sensors in metres, right-handed, in the frame of the skin; z of "
        "each frame is the estimated normal; the map may be a mirror image of the skin -->"
    )
    if macro:
        robot = tag("robot", {"xmlns:xacro": "http://www.ros.org/wiki/xacro"}, closed=False)
        opening = tag("xacro:macro", {"name": "skin", "params": "parent"}, closed=False)
        lines = [robot, note, opening, *body, "</xacro:macro>", "</robot>"]
    else:
        robot = tag("robot", {"name": skin.frame}, closed=False)
        lines = [robot, note, tag("link", {"name": skin.frame}), *body, "</robot>"]
    path.write_text('<?xml version="1.0"?>\n' + "\n".join(lines) + "\n", encoding="utf-8")


def read_map(path: Path) -> SensorMap:
    """Read the sensors of a URDF file: those of its tactile elements, else its fixed frames.

    Parameters
    ----------
    path : pathlib.Path

    Returns
    -------
    SensorMap
        In metres, in the frame of the link that they are fixed to.

    Raises
    ------
    FileError
        If it is no such file, it is damaged, or there are no sensors of one link.
    MissingExtraError
        If the hardened parser is not installed.
    """
    root: Any = xml_files.parsed(path)
    joints = {
        joint.find("child").get("link", ""): joint
        for joint in root.iter("joint")
        if joint.get("type") == "fixed" and joint.find("child") is not None
    }
    parents = {_link(joint, "parent") for joint in joints.values()}
    if len(parents) > 1:
        raise FileError(f"{path}: its fixed frames have {len(parents)} parents; give those of one")
    places = {
        name: xml_files.vector(path, f"xyz of {name!r}", _xyz(joint))
        for name, joint in joints.items()
    }
    return xml_files.map_of(path, places, "fixed frames")


def _frames(skin: Taxels, parent: str) -> list[str]:
    turns = skin.roll_pitch_yaw
    lines = []
    for name, place, turn in zip(skin.names, skin.positions, turns, strict=True):
        joint = tag("joint", {"name": f"{name}_fixed", "type": "fixed"}, closed=False)
        origin = tag("origin", {"xyz": numbers(place), "rpy": numbers(turn)})
        ends = tag("parent", {"link": parent}) + tag("child", {"link": name})
        lines += [tag("link", {"name": name}), f"{joint}{ends}{origin}</joint>"]
    return lines


def _tactile(skin: Taxels, parent: str) -> list[str]:
    name = f"{skin.frame}_tactile"
    lines = [tag("sensor", {"name": name, "update_rate": "100"}, closed=False)]
    lines += [tag("parent", {"link": parent}), tag("tactile", {"channel": _CHANNEL}, closed=False)]
    turns = skin.roll_pitch_yaw
    ball = f"<geometry>{tag('sphere', {'radius': repr(_RADIUS)})}</geometry>"
    for index, place, turn in zip(skin.indices, skin.positions, turns, strict=True):
        where = {"idx": str(index), "xyz": numbers(place), "rpy": numbers(turn)}
        lines.append(f"{tag('taxel', where, closed=False)}{ball}</taxel>")
    return [*lines, "</tactile>", "</sensor>"]


def _link(joint: Any, end: str) -> str:
    found = joint.find(end)
    return "" if found is None else str(found.get("link", ""))


def _xyz(joint: Any) -> str:
    origin = joint.find("origin")
    return "0 0 0" if origin is None else str(origin.get("xyz", "0 0 0"))
