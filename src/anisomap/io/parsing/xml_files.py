"""What URDF, MJCF and launch files have in common: XML, written plainly and read with suspicion."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import FileError
from anisomap.io.parsing.foreign import foreign, imported
from anisomap.sensor_map import SensorMap

EXTRA = "xml"

_LARGEST = 64 * 1024 * 1024
_ROOT = re.compile(rb"<\s*([A-Za-z_][\w.-]*)")
# No XML 1.0 file can hold these, however they are written.
_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ufffe\uffff]")

Element = object


def root_is(head: bytes, name: str) -> bool:
    """Tell whether the first element of a file, after declarations and comments, has a name."""
    text = re.sub(rb"<!--.*?-->|<\?.*?\?>|<!DOCTYPE[^>]*>", b"", head, flags=re.DOTALL).lstrip()
    found = _ROOT.match(text.removeprefix(b"\xef\xbb\xbf"))
    return bool(found and found[1] == name.encode())


def tag(name: str, attributes: Mapping[str, str], *, closed: bool = True) -> str:
    """Write a tag; what is special in XML is escaped in the attributes."""
    pairs = "".join(f" {key}={quoteattr(value)}" for key, value in attributes.items())
    return f"<{name}{pairs}{'/' if closed else ''}>"


def numbers(values: Iterable[float]) -> str:
    """Write numbers with blanks between, so that they read back equal."""
    return " ".join(repr(float(value)) for value in values)


def check_names(names: Iterable[str], path: Path) -> None:
    """Refuse names that XML cannot hold.

    Raises
    ------
    FileError
        If a name holds a control character.
    """
    for name in names:
        if _FORBIDDEN.search(name):
            raise FileError(f"cannot write {path}: XML cannot hold the name {name!r}")


def parsed(path: Path) -> object:
    """Parse a file that may come from anywhere: no entities, no other files, not too large.

    Returns
    -------
    xml.etree.ElementTree.Element

    Raises
    ------
    FileError
        If it is no XML, or means harm.
    MissingExtraError
        If the hardened parser is not installed.
    """
    if path.stat().st_size > _LARGEST:
        raise FileError(f"{path} is larger than any description of a robot")
    parser = imported("defusedxml.ElementTree", "reading XML", EXTRA)
    with foreign(path):
        return parser.fromstring(path.read_bytes(), forbid_dtd=True)


def vector(path: Path, what: str, text: str | None, count: int = 3) -> NDArray[np.float64]:
    """Read numbers between blanks.

    Raises
    ------
    FileError
        If there are not `count` finite ones.
    """
    try:
        values = np.array([float(field) for field in (text or "").split()])
    except ValueError:
        values = np.empty(0)
    if len(values) != count or not np.isfinite(values).all():
        raise FileError(f"{path}: {what} must be {count} numbers, not {text!r}")
    return values


def map_of(path: Path, places: Mapping[str, NDArray[np.float64]], what: str) -> SensorMap:
    """Make a map of named places in metres.

    Raises
    ------
    FileError
        If there are none.
    """
    if not places:
        raise FileError(f"{path} holds no {what}, which would be its sensors")
    return SensorMap(np.array(list(places.values())), names=tuple(places), units="m")
