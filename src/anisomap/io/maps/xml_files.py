"""Write XML elements and comments, and parse XML safely, for URDF, MJCF and launch files."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from html import escape
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError, import_extra
from anisomap.files import open_regular
from anisomap.io.parsing.source import library_errors, quote
from anisomap.placement import METRES, Taxels, to_taxels
from anisomap.sensor_map import SensorMap

EXTRA = "xml"

SENSOR_RADIUS = 0.002
"""Radius in metres of the spheres that represent sensors; for display only."""

_MAX_BYTES = 64 * 1024 * 1024
MAX_TAG_BYTES = 1 << 23
"""The vertices of a mesh are an attribute in MJCF; this is a mesh of about 300,000 vertices.
The attributes of a tag take at most 40 times its size as objects (measured: CPython 3.11)."""

_STEP = 1 << 16
_MAX_DEPTH = 1000
_MAX_NAMES = 10_000  # of elements and attributes; the parser keeps each
_ROOT = re.compile(rb"<\s*+([A-Za-z_][\w.-]*+)")
_BEFORE_ROOT = {b"<!--": b"-->", b"<?": b"?>", b"<!DOCTYPE": b">"}
# Characters that XML 1.0 cannot represent, not even escaped.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")

# Parsers replace these characters in attributes by spaces (XML 1.0, section 3.3.3).
_SPACE = str.maketrans({"\n": "&#10;", "\r": "&#13;", "\t": "&#9;"})


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


def has_root(name: str) -> Callable[[Path, bytes], bool]:
    """Return the function that recognises files by their root element."""
    return lambda path, head: root_is(head, name)


def named_taxels(sensor_map: SensorMap, purpose: str) -> Taxels:
    """Convert a map to taxels, as `to_taxels`, and check that XML can represent their names."""
    skin = to_taxels(sensor_map, purpose)
    for name in (*skin.names, skin.frame):
        if _FORBIDDEN.search(name):
            raise FileError(
                f"{purpose} cannot represent the name {quote(name)} with control characters"
            )
    return skin


def tag(name: str, attributes: Mapping[str, str], *, closed: bool = True) -> str:
    """Format a tag with escaped attributes."""
    pairs = "".join(
        f' {key}="{escape(value).translate(_SPACE)}"' for key, value in attributes.items()
    )
    return f"<{name}{pairs}{'/' if closed else ''}>"


def map_comments(sensor_map: SensorMap, element: str) -> list[str]:
    """Format comments about a map: its frame, method, verdict and notes."""
    lines = [
        f"{int(sensor_map.placed.sum())} sensors in metres, right-handed; the z axis of each "
        f"{element} is the surface normal"
        + (", estimated from the positions" if sensor_map.normals is None else ""),
        sensor_map.pose,
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


class Elements(Protocol):
    """What is done with the elements of a file."""

    def start(self, depth: int, tag: str, attributes: Mapping[str, str]) -> None:
        """Take the start of an element; the root has depth 0."""

    def end(self, depth: int, tag: str) -> None:
        """Take the end of an element."""


def parse_xml(path: Path, elements: Elements) -> None:
    """Parse an untrusted file: without entities, external files, or unlimited size.

    Elements are passed on one by one, and not kept.
    """
    if path.stat().st_size > _MAX_BYTES:
        raise FileError(f"{path} is larger than {_MAX_BYTES >> 20} MiB, the limit for XML")
    library = import_extra("defusedxml.ElementTree", "reading XML", EXTRA)
    target = _Target(path, elements)
    parser, waiting, seen = library.DefusedXMLParser(target=target, forbid_dtd=True), 0, 0
    with open_regular(path) as stream:
        while chunk := stream.read(_STEP):
            waiting = waiting if target.n_events == seen else 0
            waiting, seen = waiting + len(chunk), target.n_events
            if waiting > MAX_TAG_BYTES:
                raise FileError(f"{path} has a tag or text of more than {MAX_TAG_BYTES} bytes")
            with library_errors(path):
                parser.feed(chunk)
    with library_errors(path):
        parser.close()


class _Target:
    """Passes elements on, after counting what the parser keeps of them."""

    def __init__(self, path: Path, elements: Elements) -> None:
        self.n_events = 0
        self._path, self._elements, self._depth = path, elements, 0
        self._names: set[str] = set()

    def start(self, tag: str, attributes: Mapping[str, str]) -> None:
        self.n_events += 1
        self._names.add(tag)
        self._names.update(attributes)
        if len(self._names) > _MAX_NAMES:
            raise FileError(
                f"{self._path} has elements with more than {_MAX_NAMES} different names"
            )
        if self._depth > _MAX_DEPTH:
            raise FileError(f"{self._path} has more than {_MAX_DEPTH} nested elements")
        self._elements.start(self._depth, tag, attributes)
        self._depth += 1

    def end(self, tag: str) -> None:
        self.n_events += 1
        self._depth -= 1
        self._elements.end(self._depth, tag)

    def comment(self, _text: str) -> None:
        self.n_events += 1

    def close(self) -> None:
        """Do nothing: the parser requires this function."""


def parse_vector(path: Path, name: str, text: str | None) -> NDArray[np.float64]:
    """Parse three finite numbers, separated by blanks."""
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
    """Create a map from positions in metres, by sensor name."""
    if not positions:
        raise FileError(f"{path} holds no {elements} to read as sensors")
    return SensorMap(np.array(list(positions.values())), names=tuple(positions), units="m")
