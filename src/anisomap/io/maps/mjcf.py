"""MJCF models for MuJoCo: sensors are sites of one body, in metres, with z along the normal."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.maps import xml_files
from anisomap.io.maps.xml_files import format_numbers, tag
from anisomap.io.parsing.source import quote
from anisomap.sensor_map import SensorMap


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
    sites = _Sites(path)
    xml_files.parse_xml(path, sites)
    return xml_files.map_from_positions(path, sites.positions, "sites")


class _Sites:
    """Collects the positions of the sites of one body, by their names."""

    def __init__(self, path: Path) -> None:
        self.positions: dict[str, NDArray[np.float64]] = {}
        self._path = path
        self._open: list[int] = []  # numbers of the open elements
        self._n_elements = 0
        self._owner = -1

    def start(self, depth: int, tag: str, attributes: Mapping[str, str]) -> None:
        self._open[depth:] = [self._n_elements]
        self._n_elements += 1
        if tag != "site" or not depth:
            return
        owner = self._open[depth - 1]
        if self._owner not in (-1, owner):
            raise FileError(f"{self._path}: sites must belong to one body, got two or more bodies")
        self._owner = owner
        name = attributes.get("name", f"site{len(self.positions)}")
        if name in self.positions:
            raise FileError(f"{self._path}: two sites have the name {quote(name)}")
        pos = attributes.get("pos", "0 0 0")
        what = f"pos of {quote(name)}"
        self.positions[name] = xml_files.parse_vector(self._path, what, pos)

    def end(self, depth: int, tag: str) -> None:
        """Do nothing: sites have no content."""
