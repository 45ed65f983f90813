"""Models of robots: URDF, and MJCF for MuJoCo.

Sensors are fixed frames of one link, or sites of one body, in metres and right-handed; the z axis
of each is the surface normal. URDF also contains the element ``tactile``, an extension for tactile
sensors: a channel, and position and shape of each sensor.
"""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Comment, Element, ElementTree, SubElement, indent

import numpy as np
from numpy.typing import NDArray

from anisomap.base import METRES
from anisomap.errors import AnisomapWarning, FileError, error_reason, import_extra
from anisomap.files.paths import open_regular
from anisomap.io.parsing.source import quote
from anisomap.placement import Taxels, to_taxels
from anisomap.placement.placing import judgement
from anisomap.sensor_map import SensorMap

EXTRA = "xml"

_MAX_FRAMES = 100  # without a warning; chosen by hand
_RADIUS = "0.002"  # in metres, of the spheres that represent sensors; for display only
_CHANNEL = "tactile"
_ZERO = "0 0 0"  # the default of URDF

_MAX_BYTES, _MAX_DEPTH = 1 << 24, 1000
# The first element, after declarations and comments; matched in linear time.
_ROOT = re.compile(
    rb"(?:\xef\xbb\xbf)?\s*+(?:(?:<!--.*?-->|<\?.*?\?>|<!DOCTYPE[^>]*+>)\s*+)*+"
    rb"<\s*+([A-Za-z_][\w.-]*+)",
    re.DOTALL,
)
# Characters that XML 1.0 cannot represent, even if escaped.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def has_root(name: str) -> Callable[[Path, bytes], bool]:
    """Return the function that recognises files by their root element."""
    wanted = name.encode()
    return lambda path, head: (found := _ROOT.match(head)) is not None and found[1] == wanted


def write_urdf(sensor_map: SensorMap, path: Path) -> None:
    """Write a link with fixed frames; as ``.xacro``, a macro with the parent link as parameter."""
    skin = _named_taxels(sensor_map, "URDF")
    if len(skin.names) > _MAX_FRAMES:
        problem = f"{len(skin.names)} frames, one per sensor, slow down software that tracks frames"
        remedy = "consider the tactile element or another format"
        warnings.warn(f"{problem}; {remedy}", AnisomapWarning, stacklevel=2)
    macro = path.suffix.lower() == ".xacro"
    skin = _without_expressions(skin, escaped=macro)
    space = {"xmlns:xacro": "http://www.ros.org/wiki/xacro"}
    robot = _document("robot", space if macro else {"name": skin.frame}, sensor_map, "frame")
    if macro:
        model, parent = SubElement(robot, "xacro:macro", name="skin", params="parent"), "${parent}"
    else:
        model, parent = robot, skin.frame
        SubElement(model, "link", name=parent)
    sensor = Element("sensor", name=f"{skin.frame}_tactile", update_rate="100")
    SubElement(sensor, "parent", link=parent)
    tactile = SubElement(sensor, "tactile", channel=_CHANNEL)
    for index, name, position, turn in zip(
        skin.indices, skin.names, skin.positions, skin.roll_pitch_yaw, strict=True
    ):
        pose = {"xyz": _numbers(position), "rpy": _numbers(turn)}
        SubElement(model, "link", name=name)
        joint = SubElement(model, "joint", name=f"{name}_fixed", type="fixed")
        SubElement(joint, "parent", link=parent)
        SubElement(joint, "child", link=name)
        SubElement(joint, "origin", pose)
        taxel = SubElement(tactile, "taxel", pose, idx=str(index))
        SubElement(SubElement(taxel, "geometry"), "sphere", radius=_RADIUS)
    model.append(sensor)
    _write(robot, path)


def write_mjcf(sensor_map: SensorMap, path: Path) -> None:
    """Write a model of one body with sites."""
    skin = _named_taxels(sensor_map, "MJCF")
    model = _document("mujoco", {"model": skin.frame}, sensor_map, "site")
    body = SubElement(SubElement(model, "worldbody"), "body", name=skin.frame)
    quaternions = skin.rotations.as_quat(scalar_first=True)
    for name, position, turn in zip(skin.names, skin.positions, quaternions, strict=True):
        pose = {"pos": _numbers(position), "quat": _numbers(turn)}
        SubElement(body, "site", pose, name=name, size=_RADIUS)
    _write(model, path)


def _named_taxels(sensor_map: SensorMap, purpose: str) -> Taxels:
    """Convert a map to taxels, and check that XML can represent their names."""
    skin = to_taxels(sensor_map, purpose)
    for name in (*skin.names, skin.frame):
        if _FORBIDDEN.search(name):
            raise FileError(f"{purpose} cannot represent control characters, as in {quote(name)}")
    return skin


def _without_expressions(skin: Taxels, *, escaped: bool) -> Taxels:
    """Escape or reject names that xacro would evaluate; launch files often pass URDF to xacro."""
    names = (skin.frame, *skin.names)
    if escaped:
        # The escape ``$${`` is not enough: xacro drops the text after ``$$`` without a bracket.
        frame, *others = (name.replace("$", "${'$'}") for name in names)
        return replace(skin, frame=frame, names=tuple(others))
    for name in names:
        if "${" in name or "$(" in name:
            raise FileError(f"xacro would evaluate the name {quote(name)}; rename it")
    return skin


def _document(
    root: str, attributes: dict[str, str], sensor_map: SensorMap, element: str
) -> Element:
    """Create a document with comments about a map; `element` is the tag of its sensors."""
    document = Element(root, attributes)
    lines = [
        f"{int(sensor_map.placed.sum())} sensors in metres, right-handed; the z axis of each "
        f"{element} is the surface normal"
        + (", estimated from the positions" if sensor_map.normals is None else ""),
        sensor_map.pose,
        f"method: {sensor_map.method or 'unknown'}",
        *judgement(sensor_map),
        *(f"note: {note}" for note in sensor_map.notes),
    ]
    if np.isfinite(sensor_map.errors).any():
        lines.append("90% of the sensors are within their error, in metres:")
        errors = zip(sensor_map.names, METRES[sensor_map.units] * sensor_map.errors, strict=True)
        lines += [f"error of {name}: {e:.3g}" for name, e in errors if math.isfinite(e)]
    document.extend(map(_comment, lines))
    return document


def _write(document: Element, path: Path) -> None:
    indent(document)
    document.tail = "\n"
    ElementTree(document).write(path, encoding="utf-8", xml_declaration=True)


def _comment(text: str) -> Any:
    """Make a comment; text that would end the comment and forbidden characters are replaced."""
    plain = _FORBIDDEN.sub("?", " ".join(text.split()))
    # XML forbids two hyphens in a row inside a comment, and with "xacro:eval-comments" xacro
    # evaluates the comments after it.
    plain = plain.replace("--", "- -").replace("--", "- -").replace("xacro:", "xacro ")
    return Comment(f" {plain} ")


def _numbers(values: Iterable[float]) -> str:
    """Format numbers, separated by blanks, so that they are read back equal."""
    return " ".join(repr(float(value)) for value in values)


def read_urdf(path: Path) -> SensorMap:
    """Read the fixed frames of one link as sensors, in the frame of that link."""
    positions = dict[str, NDArray[np.float64]]()
    parents = list[str]()
    for _, joint in _elements(path):
        if joint.tag != "joint" or joint.get("type") != "fixed" or joint.find("child") is None:
            continue
        name, parent = _part(joint, "child", "link"), _part(joint, "parent", "link")
        parents = parents or [parent]
        if parent != parents[0]:
            both = f"{quote(parents[0])} and {quote(parent)}"
            raise FileError(f"{path}: fixed frames must have one parent link, got {both}")
        if name in positions:
            raise FileError(f"{path}: {quote(name)} is the child of two fixed joints")
        origin = _part(joint, "origin", "xyz", _ZERO)
        positions[name] = _vector(path, f"xyz of {quote(name)}", origin)
    return _map_of(path, positions, "fixed frames")


def read_mjcf(path: Path) -> SensorMap:
    """Read the sites of one body as sensors, in the frame of that body."""
    positions = dict[str, NDArray[np.float64]]()
    body = None
    for around, site in _elements(path):
        if site.tag != "site" or not around:
            continue
        if body is not None and body is not around[-1]:
            raise FileError(f"{path}: sites must belong to one body, got two or more bodies")
        body = around[-1]
        name = site.get("name", f"site{len(positions)}")
        if name in positions:
            raise FileError(f"{path}: two sites have the name {quote(name)}")
        positions[name] = _vector(path, f"pos of {quote(name)}", site.get("pos", _ZERO))
    return _map_of(path, positions, "sites")


def _elements(path: Path) -> Iterator[tuple[list[Any], Any]]:
    """Yield every element at its end, with enclosing elements; only the parts of joints are kept.

    The file is not trusted: entities, external files and unlimited sizes are refused.
    """
    if path.stat().st_size > _MAX_BYTES:
        raise FileError(f"{path} is larger than {_MAX_BYTES >> 20} MiB, the limit for XML")
    around = list[Any]()
    for event, element in _events(path):
        if event == "start":
            around.append(element)
            if len(around) > _MAX_DEPTH:
                raise FileError(f"{path} has more than {_MAX_DEPTH} nested elements")
            continue
        around.pop()
        yield around, element
        if around and around[-1].tag != "joint":
            del around[-1][0]  # the parser is ahead, so that other elements may follow


def _events(path: Path) -> Iterator[tuple[str, Any]]:
    library = import_extra("defusedxml.ElementTree", "reading XML", EXTRA)
    with open_regular(path) as stream:
        try:
            yield from library.iterparse(stream, ("start", "end"), forbid_dtd=True)
        except (SyntaxError, ValueError, LookupError) as error:
            raise FileError(f"{path} is damaged or cut short: {error_reason(error)}") from error


def _part(joint: Any, part: str, key: str, default: str = "") -> str:
    """Return an attribute of the first part of a joint with a given name."""
    found = joint.find(part)
    return default if found is None else str(found.get(key, default))


def _vector(path: Path, name: str, text: str) -> NDArray[np.float64]:
    """Parse three finite numbers, separated by blanks."""
    try:
        values = np.array([float(field) for field in text.split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != 3 or not np.isfinite(values).all():
        raise FileError(f"{path}: {name} must be 3 finite numbers, got {quote(text)}")
    return values


def _map_of(path: Path, positions: Mapping[str, NDArray[np.float64]], elements: str) -> SensorMap:
    if not positions:
        raise FileError(f"{path} holds no {elements} to read as sensors")
    return SensorMap(np.array(list(positions.values())), names=tuple(positions), units="m")
