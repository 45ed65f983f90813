"""Write XML elements and comments, and parse XML safely, for URDF, MJCF and launch files."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from anisomap.budget import Budget
from anisomap.errors import FileError
from anisomap.io.parsing.libraries import import_extra, library_errors
from anisomap.io.parsing.source import quote
from anisomap.placement import METRES, Taxels, to_taxels
from anisomap.sensor_map import SensorMap

EXTRA = "xml"

SENSOR_RADIUS = 0.002
"""Radius in metres of the spheres that represent sensors; for display only."""

_MAX_BYTES = 64 * 1024 * 1024
_ELEMENT_BYTES, _ATTRIBUTE_BYTES = 270, 280  # measured: CPython 3.11, one attribute per element
_MAX_RATIO = 20  # of these to the file; the URDFs that anisomap writes reach 13
_ROOT = re.compile(rb"<\s*+([A-Za-z_][\w.-]*+)")
_BEFORE_ROOT = {b"<!--": b"-->", b"<?": b"?>", b"<!DOCTYPE": b">"}
# Characters that XML 1.0 cannot represent, not even escaped.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def root_is(head: bytes, name: str) -> bool:
    """Return whether the root element of a file, after declarations and comments, is `name`."""
    text = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    start = 0
    while opening := next((mark for mark in _BEFORE_ROOT if text.startswith(mark, start)), b""):
        closing = _BEFORE_ROOT[opening]
        end = text.find(closing, start + len(opening))
        if end < 0:
            return False
        start = end + len(closing)
        while text[start : start + 1].isspace():
            start += 1
    found = _ROOT.match(text, start)
    return bool(found and found[1] == name.encode())


def named_taxels(sensor_map: SensorMap, purpose: str) -> Taxels:
    """Convert a map to taxels, as `to_taxels`, and check that XML can represent their names.

    Raises
    ------
    InputError
        If the map has no scale, several components, or no placed sensor.
    FileError
        If a name contains a control character.
    """
    skin = to_taxels(sensor_map, purpose)
    for name in (*skin.names, skin.frame):
        if _FORBIDDEN.search(name):
            raise FileError(
                f"{purpose} cannot represent the name {quote(name)} with control characters"
            )
    return skin


def tag(name: str, attributes: Mapping[str, str], *, closed: bool = True) -> str:
    """Format a tag with escaped attributes."""
    pairs = "".join(f" {key}={quoteattr(value)}" for key, value in attributes.items())
    return f"<{name}{pairs}{'/' if closed else ''}>"


def map_comments(sensor_map: SensorMap, element: str) -> list[str]:
    """Format comments about a map: its frame, method, verdict and notes.

    Parameters
    ----------
    sensor_map : SensorMap
    element : str
        The element that represents a sensor, such as ``"site"``.
    """
    lines = [
        f"{int(sensor_map.placed.sum())} sensors in metres, right-handed; the z axis of each "
        f"{element} is the surface normal"
        + (", estimated from the positions" if sensor_map.normals is None else ""),
        f"known up to {sensor_map.known_up_to}",
        f"method: {sensor_map.method or 'unknown'}",
        f"verdict: {sensor_map.verdict}",
        *(f"note: {note}" for note in sensor_map.notes),
    ]
    if np.isfinite(sensor_map.errors).any():
        lines.append("90 % of the sensors are within their error, in metres:")
        lines += [
            f"error of {name}: {error * METRES[sensor_map.units]:.3g}"
            for name, error in zip(sensor_map.names, sensor_map.errors.tolist(), strict=True)
            if math.isfinite(error)
        ]
    return [comment(line) for line in lines]


def comment(text: str) -> str:
    """Format a comment; text that would end it, and characters that XML forbids, are replaced."""
    plain = _FORBIDDEN.sub("?", " ".join(text.split()))
    # XML forbids two hyphens in a row inside a comment, and with "xacro:eval-comments" xacro
    # evaluates the comments after it.
    plain = plain.replace("--", "- -").replace("--", "- -").replace("xacro:", "xacro ")
    return f"<!-- {plain} -->"


def format_numbers(values: Iterable[float]) -> str:
    """Format numbers, separated by blanks, so that they are read back equal."""
    return " ".join(repr(float(value)) for value in values)


def parse_xml(path: Path) -> object:
    """Parse an untrusted file: without entities, external files, or unlimited size.

    Returns
    -------
    xml.etree.ElementTree.Element

    Raises
    ------
    FileError
        If the file is not valid XML, declares a document type, is larger than 64 MiB, or would take
        far more memory than its size.
    MissingExtraError
        If defusedxml is not installed.
    """
    if path.stat().st_size > _MAX_BYTES:
        raise FileError(f"{path} is larger than {_MAX_BYTES >> 20} MiB, the limit for XML")
    parser = import_extra("defusedxml.ElementTree", "reading XML", EXTRA)
    budget, content = Budget(path), path.read_bytes()
    n_elements, n_attributes = content.count(b"<") - content.count(b"</"), content.count(b"=")
    n_bytes = len(content) + _ELEMENT_BYTES * n_elements + _ATTRIBUTE_BYTES * n_attributes
    budget.check(n_bytes, "its text", reachable=max(budget.free, _MAX_RATIO * budget.size))
    with library_errors(path):
        return parser.fromstring(content, forbid_dtd=True)


def parse_vector(path: Path, name: str, text: str | None) -> NDArray[np.float64]:
    """Parse three finite numbers, separated by blanks.

    Raises
    ------
    FileError
        If `text` is anything else.
    """
    try:
        values = np.array([float(field) for field in (text or "").split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != 3 or not np.isfinite(values).all():
        raise FileError(f"{path}: {name} must be 3 finite numbers, got {quote(str(text))}")
    return values


def map_from_positions(
    path: Path, positions: Mapping[str, NDArray[np.float64]], elements: str
) -> SensorMap:
    """Create a map from positions in metres, by sensor name.

    Raises
    ------
    FileError
        If `positions` is empty.
    """
    if not positions:
        raise FileError(f"{path} holds no {elements} to read as sensors")
    return SensorMap(np.array(list(positions.values())), names=tuple(positions), units="m")
