"""MJCF: sensors as sites of a body, for MuJoCo. Metres; z of each site is the normal."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from anisomap.errors import FileError
from anisomap.io.parsing import xml_files
from anisomap.io.parsing.xml_files import numbers, tag
from anisomap.placement import taxels
from anisomap.sensor_map import SensorMap

_SIZE = 0.002  # metres


def recognises(path: Path, head: bytes) -> bool:
    """Tell MJCF by its first element."""
    return xml_files.root_is(head, "mujoco")


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as a model of one body with sites.

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
    skin = taxels(sensor_map, "MJCF")
    xml_files.check_names((*skin.names, skin.frame), path)
    quaternions = skin.rotations.as_quat(scalar_first=True)
    lines = [
        tag("mujoco", {"model": skin.frame}, closed=False),
        "<!-- metres, right-handed; z of each site is the estimated normal; the map may be a "
        "mirror image of the skin -->",
        "<worldbody>",
        tag("body", {"name": skin.frame}, closed=False),
    ]
    lines += [
        tag(
            "site",
            {"name": name, "pos": numbers(at), "quat": numbers(turn), "size": repr(_SIZE)},
        )
        for name, at, turn in zip(skin.names, skin.positions, quaternions, strict=True)
    ]
    path.write_text("\n".join([*lines, "</body>", "</worldbody>", "</mujoco>", ""]), "utf-8")


def read_map(path: Path) -> SensorMap:
    """Read the sites of a model as sensors.

    Parameters
    ----------
    path : pathlib.Path
        A model whose sites belong to one body; where that stands is not looked at.

    Returns
    -------
    SensorMap
        In metres, in the frame of that body.

    Raises
    ------
    FileError
        If it is no such file, it is damaged, or its sites belong to several bodies.
    MissingExtraError
        If the hardened parser is not installed.
    """
    root: Any = xml_files.parsed(path)
    owners = [element for element in root.iter() if element.find("site") is not None]
    if len(owners) > 1:
        raise FileError(f"{path}: its sites belong to {len(owners)} bodies; give those of one")
    places = {}
    for owner in owners:
        for i, site in enumerate(owner.findall("site")):
            name = site.get("name", f"site{i}")
            if name in places:
                raise FileError(f"{path}: two sites have the name {name!r}")
            places[name] = xml_files.vector(path, f"pos of {name!r}", site.get("pos", "0 0 0"))
    return xml_files.map_of(path, places, "sites")
