"""Kinematics of robots from URDF."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.files import open_regular
from anisomap.io.maps import xml_files
from anisomap.io.parsing.source import file_errors, quote
from anisomap.numerics.kinematics import SLIDING, TURNING, Joint, KinematicTree, Mimic, transform

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
