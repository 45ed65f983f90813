"""URDF and xacro: a fixed frame per sensor, and the ``tactile`` element.

The z axis of a frame is the surface normal. ``tactile`` is the URDF extension for tactile sensors:
a channel, and position and shape of each sensor. Lengths are in metres, frames right-handed.

Kinematics of robots from URDF.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import AnisomapWarning, FileError
from anisomap.files import open_regular
from anisomap.io.maps import xml_files
from anisomap.io.maps.xml_files import format_numbers, tag
from anisomap.io.parsing.source import file_errors, quote
from anisomap.numerics.kinematics import SLIDING, TURNING, Joint, KinematicTree, Mimic, transform
from anisomap.placement import Taxels
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
    joints = _FixedJoints(path)
    xml_files.parse_xml(path, joints)
    return xml_files.map_from_positions(path, joints.positions, "fixed frames")


@dataclass
class _Joint:
    """A joint that is not yet closed, and the first of each of its elements."""

    depth: int
    elements: dict[str, Mapping[str, str]] = field(default_factory=dict)


class _FixedJoints:
    """Collects the positions of the child links of fixed joints with one parent."""

    def __init__(self, path: Path) -> None:
        self.positions: dict[str, NDArray[np.float64]] = {}
        self._path = path
        self._open: list[_Joint] = []
        self._parent: str | None = None

    def start(self, depth: int, tag: str, attributes: Mapping[str, str]) -> None:
        if self._open and depth == self._open[-1].depth + 1:
            self._open[-1].elements.setdefault(tag, attributes)
        if tag == "joint" and attributes.get("type") == "fixed":
            self._open.append(_Joint(depth))

    def end(self, depth: int, tag: str) -> None:
        if not self._open or self._open[-1].depth != depth:
            return
        elements = self._open.pop().elements
        if "child" not in elements:
            return
        parent = elements.get("parent", {}).get("link", "")
        if self._parent not in (None, parent):
            raise FileError(
                f"{self._path}: fixed frames must have one parent link, got "
                f"{quote(str(self._parent))} and {quote(parent)}"
            )
        self._parent = parent
        name = elements["child"].get("link", "")
        xyz = elements.get("origin", {}).get("xyz", "0 0 0")
        what = f"xyz of {quote(name)}"
        if name in self.positions:
            raise FileError(f"{self._path}: {quote(name)} is the child of two fixed joints")
        self.positions[name] = xml_files.parse_vector(self._path, what, xyz)


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
        joints = _Joints(file)
        xml_files.parse_xml(file, joints)
        if not joints.found:
            raise FileError(f"{file} has no joint")
        return KinematicTree(tuple(joints.found))


@dataclass
class _Open:
    """A joint that is not yet closed, and the first of each of its elements."""

    attributes: Mapping[str, str]
    elements: dict[str, Mapping[str, str]] = field(default_factory=dict)


class _Joints:
    """Collects joints."""

    def __init__(self, path: Path) -> None:
        self.found: list[Joint] = []
        self._path = path
        self._open: _Open | None = None

    def start(self, depth: int, tag: str, attributes: Mapping[str, str]) -> None:
        if depth == _DEPTH and tag == "joint":
            self._open = _Open(dict(attributes))
        elif self._open is not None and depth == _DEPTH + 1:
            self._open.elements.setdefault(tag, dict(attributes))

    def end(self, depth: int, tag: str) -> None:
        if depth == _DEPTH and self._open is not None:
            self.found.append(self._joint(self._open))
            self._open = None

    def _joint(self, joint: _Open) -> Joint:
        name, kind = (joint.attributes.get(key, "") for key in ("name", "type"))
        what = f"joint {quote(name)}"
        parent, child = (joint.elements.get(key, {}).get("link", "") for key in ("parent", "child"))
        if not (name and parent and child):
            raise FileError(f"{self._path}: {what} must have a name, a parent and a child link")
        origin = joint.elements.get("origin", {})
        xyz, rpy = (
            xml_files.parse_vector(self._path, f"{key} of {what}", origin.get(key, _ZERO))
            for key in ("xyz", "rpy")
        )
        axis = xml_files.parse_vector(
            self._path, f"axis of {what}", joint.elements.get("axis", {}).get("xyz", _X_AXIS)
        )
        return Joint(
            name, kind, parent, child, transform(xyz, rpy), self._unit(axis, kind, what),
            self._mimic(joint.elements.get("mimic"), what),
        )  # fmt: skip

    def _unit(self, axis: NDArray[np.float64], kind: str, what: str) -> NDArray[np.float64]:
        length = float(np.linalg.norm(axis))
        if kind in TURNING + SLIDING and not (0 < length < math.inf):
            raise FileError(f"{self._path}: the axis of {what} must not have the length {length:g}")
        return axis / length if length else axis

    def _mimic(self, given: Mapping[str, str] | None, what: str) -> Mimic | None:
        if given is None:
            return None
        try:
            factors = [float(given.get(key, usual)) for key, usual in
                       (("multiplier", "1"), ("offset", "0"))]  # fmt: skip
        except ValueError:
            factors = [math.nan]
        if not np.isfinite(factors).all():
            raise FileError(f"{self._path}: mimic of {what} must have finite numbers")
        return Mimic(given.get("joint", ""), *factors)
