"""URDF: the skin as fixed frames and the ``tactile`` element, and the kinematics of robots.

The z axis of a frame is the surface normal. ``tactile`` is the URDF extension for tactile sensors:
a channel, and position and shape of each sensor. Lengths are in metres, frames right-handed.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, FileError
from anisomap.files import open_regular
from anisomap.io.maps import xml_files
from anisomap.io.maps.xml_files import format_numbers, tag
from anisomap.io.parsing.source import file_errors, quote
from anisomap.placement import Taxels
from anisomap.placement.kinematics import SLIDING, TURNING, Joint, KinematicTree, Mimic, transform
from anisomap.sensor_map import SensorMap

MAX_FRAMES = 100
"""Maximum number of frames without a warning; chosen by hand."""

_CHANNEL = "tactile"


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map with a scale and one component as a link with fixed frames.

    The suffix ``.xacro`` selects a macro with the parent link as parameter. More than `MAX_FRAMES`
    sensors give a warning.
    """
    skin = xml_files.named_taxels(sensor_map, "URDF")
    if len(skin.names) > MAX_FRAMES:
        warnings.warn(
            f"the map gives {len(skin.names)} frames, one per sensor; more than {MAX_FRAMES} slow "
            "down software that tracks frames, so consider the tactile element or another format",
            AnisomapWarning,
            stacklevel=2,
        )
    macro = path.suffix.lower() == ".xacro"
    if macro:
        skin = _without_expressions(skin)
    else:
        _check_expressions(skin)
    parent = "${parent}" if macro else skin.frame
    comments = xml_files.map_comments(sensor_map, "frame")
    body = [*_frames(skin, parent), *_tactile(skin, parent)]
    if macro:
        robot = tag("robot", {"xmlns:xacro": "http://www.ros.org/wiki/xacro"}, closed=False)
        opening = tag("xacro:macro", {"name": "skin", "params": "parent"}, closed=False)
        lines = [robot, *comments, opening, *body, "</xacro:macro>", "</robot>"]
    else:
        robot = tag("robot", {"name": skin.frame}, closed=False)
        lines = [robot, *comments, tag("link", {"name": skin.frame}), *body, "</robot>"]
    path.write_text('<?xml version="1.0"?>\n' + "\n".join(lines) + "\n", encoding="utf-8")


def read_map(path: Path) -> SensorMap:
    """Read the fixed frames of one link as sensors, in the frame of that link."""
    positions = _frame_positions(path, _read_joints(path))
    return xml_files.map_from_positions(path, positions, "fixed frames")


def _frame_positions(path: Path, joints: Sequence[_Joint]) -> dict[str, NDArray[np.float64]]:
    """Return the positions of the child links of fixed joints, which must have one parent."""
    positions: dict[str, NDArray[np.float64]] = {}
    fixed = [each for each in joints if each.kind == "fixed" and "child" in each.elements]
    for joint in fixed:
        first = fixed[0].attribute("parent", "link")
        if joint.attribute("parent", "link") != first:
            raise FileError(
                f"{path}: fixed frames must have one parent link, got {quote(first)} and "
                f"{quote(joint.attribute('parent', 'link'))}"
            )
        name = joint.attribute("child", "link")
        if name in positions:
            raise FileError(f"{path}: {quote(name)} is the child of two fixed joints")
        xyz = joint.attribute("origin", "xyz", _ZERO)
        positions[name] = xml_files.parse_vector(path, f"xyz of {quote(name)}", xyz)
    return positions


def _without_expressions(skin: Taxels) -> Taxels:
    """Escape names, in which xacro evaluates ``${...}`` and ``$(...)``.

    The escape ``$${`` is not enough: xacro drops the text after ``$$`` without a bracket.
    """
    frame, *names = (name.replace("$", "${'$'}") for name in (skin.frame, *skin.names))
    return replace(skin, frame=frame, names=tuple(names))


def _check_expressions(skin: Taxels) -> None:
    """Reject expressions of xacro, because launch files often pass plain URDF through it."""
    for name in (skin.frame, *skin.names):
        if "${" in name or "$(" in name:
            raise FileError(
                f"URDF cannot represent the name {quote(name)}, which xacro would evaluate; rename "
                "the sensor or frame"
            )


def _frames(skin: Taxels, parent: str) -> list[str]:
    lines = []
    for name, position, turn in zip(skin.names, skin.positions, skin.roll_pitch_yaw, strict=True):
        joint = tag("joint", {"name": f"{name}_fixed", "type": "fixed"}, closed=False)
        origin = tag("origin", {"xyz": format_numbers(position), "rpy": format_numbers(turn)})
        links = tag("parent", {"link": parent}) + tag("child", {"link": name})
        lines += [tag("link", {"name": name}), f"{joint}{links}{origin}</joint>"]
    return lines


def _tactile(skin: Taxels, parent: str) -> list[str]:
    name = f"{skin.frame}_tactile"
    lines = [tag("sensor", {"name": name, "update_rate": "100"}, closed=False)]
    lines += [tag("parent", {"link": parent}), tag("tactile", {"channel": _CHANNEL}, closed=False)]
    sphere = tag("sphere", {"radius": repr(xml_files.SENSOR_RADIUS)})
    for index, position, turn in zip(
        skin.indices, skin.positions, skin.roll_pitch_yaw, strict=True
    ):
        pose = {"xyz": format_numbers(position), "rpy": format_numbers(turn)}
        taxel = tag("taxel", {"idx": str(index), **pose}, closed=False)
        lines.append(f"{taxel}<geometry>{sphere}</geometry></taxel>")
    return [*lines, "</tactile>", "</sensor>"]


_DEPTH = 1  # of the joints of the robot; transmissions list joints farther inside
_MAX_JOINTS = 100_000  # each takes up to 1 kB
_ZERO, _X_AXIS = "0 0 0", "1 0 0"  # the defaults of URDF


def read_robot(path: str | os.PathLike[str]) -> KinematicTree:
    """Read the links and joints of a URDF file.

    Parameters
    ----------
    path : path-like
        Plain URDF; run xacro first.

    Returns
    -------
    KinematicTree

    Raises
    ------
    FileError
        If the file is missing, damaged, no URDF, has no joint, or its joints form no tree.
    MissingExtraError
        If defusedxml is not installed.
    """
    file = Path(path)
    with file_errors(file):
        with open_regular(file) as stream:
            if not xml_files.root_is(stream.read(1 << 16), "robot"):
                raise FileError(f"{file} is no URDF: its first element must be robot")
        joints = [_joint(file, each) for each in _read_joints(file) if each.depth == _DEPTH]
        if not joints:
            raise FileError(f"{file} has no joint")
        return KinematicTree(tuple(joints))


@dataclass
class _Joint:
    """An element `joint` that has parts, and the first of each of its parts."""

    depth: int
    name: str
    kind: str
    elements: dict[str, Mapping[str, str]] = field(default_factory=dict)

    def attribute(self, element: str, key: str, default: str = "") -> str:
        """Return an attribute of a part."""
        return self.elements.get(element, {}).get(key, default)


class _Joints:
    """Collects joints."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.found: list[_Joint] = []
        self._open: list[_Joint] = []

    def start(self, depth: int, tag: str, attributes: Mapping[str, str]) -> None:
        if self._open and depth == self._open[-1].depth + 1:
            self._open[-1].elements.setdefault(tag, dict(attributes))
        if tag == "joint":
            if len(self.found) == _MAX_JOINTS:
                raise FileError(f"{self._path} has more than {_MAX_JOINTS} joints")
            joint = _Joint(depth, attributes.get("name", ""), attributes.get("type", ""))
            self._open.append(joint)

    def end(self, depth: int, tag: str) -> None:
        if self._open and self._open[-1].depth == depth:
            self.found.append(self._open.pop())


def _read_joints(path: Path) -> list[_Joint]:
    joints = _Joints(path)
    xml_files.parse_xml(path, joints)
    return joints.found


def _joint(path: Path, joint: _Joint) -> Joint:
    """Return a joint of a robot."""
    what = f"joint {quote(joint.name)}"
    parent, child = (joint.attribute(key, "link") for key in ("parent", "child"))
    if not (joint.name and parent and child):
        raise FileError(f"{path}: {what} must have a name, a parent and a child link")
    xyz, rpy, axis = (
        xml_files.parse_vector(path, f"{key} of {what}", joint.attribute(part, key, usual))
        for part, key, usual in (
            ("origin", "xyz", _ZERO),
            ("origin", "rpy", _ZERO),
            ("axis", "xyz", _X_AXIS),
        )
    )
    length = float(np.linalg.norm(axis))
    if joint.kind in TURNING + SLIDING and not (0 < length < math.inf):
        raise FileError(f"{path}: the axis of {what} must not have the length {length:g}")
    unit = axis / length if length else axis
    return Joint(
        joint.name, joint.kind, parent, child, transform(xyz, rpy), unit, _mimic(path, joint, what)
    )


def _mimic(path: Path, joint: _Joint, what: str) -> Mimic | None:
    if "mimic" not in joint.elements:
        return None
    try:
        factors = [
            float(joint.attribute("mimic", key, usual))
            for key, usual in (("multiplier", "1"), ("offset", "0"))
        ]
    except ValueError:
        factors = [math.nan]
    if not np.isfinite(factors).all():
        raise FileError(f"{path}: mimic of {what} must have finite numbers")
    return Mimic(joint.attribute("mimic", "joint"), *factors)
