"""Calibrations of CySkin: JSON with the address, position and normal of each taxel, in metres.

Normals become unit vectors; those of zero length are unknown.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from anisomap.errors import FileError
from anisomap.io.parsing.json_text import read_json
from anisomap.io.parsing.naming import distinct_names
from anisomap.io.parsing.source import quote
from anisomap.sensor_map import SensorMap

_KEYS = (b'"skin"', b'"taxels"')
_NO_ADDRESS = 0

_Taxel: TypeAlias = tuple[int, list[float], list[float]]
"""Address, position and normal."""


def recognises(path: Path, head: bytes) -> bool:
    """Recognise a JSON object with the keys skin and taxels near its start."""
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    return start.startswith(b"{") and all(key in head for key in _KEYS)


def read_map(path: Path) -> SensorMap:
    """Read the taxels of all patches, named by their addresses.

    Taxels with address 0, which no module reads, are left out. Repeated addresses are numbered in
    the order of the file, as in recordings.
    """
    found = [_taxel(path, number, taxel) for number, taxel in enumerate(_taxels(path))]
    kept = [taxel for taxel in found if taxel[0] != _NO_ADDRESS]
    if not kept:
        raise FileError(f"{path} holds no taxel with an address")
    return SensorMap(
        np.array([position for _, position, _ in kept]),
        names=distinct_names(path, [str(address) for address, _, _ in kept]),
        normals=np.array([normal for _, _, normal in kept]),
        units="m",
    )


def _taxels(path: Path) -> Iterator[Any]:
    """Yield the taxels of a skin; some versions list them by patch."""
    document = read_json(path)
    skin = document.get("skin") if isinstance(document, dict) else None
    listed = skin.get("taxels") if isinstance(skin, dict) else None
    if not isinstance(listed, list):
        raise FileError(f"{path} is JSON without the taxels of a skin")
    for entry in listed:
        yield from entry if isinstance(entry, list) else [entry]


def _taxel(path: Path, number: int, taxel: Any) -> _Taxel:
    """Return the address, position and unit normal of a taxel; NaN without a normal."""
    where = f"{path}, taxel {number}"
    if not isinstance(taxel, dict):
        raise FileError(f"{where}: must be an object with id and x, got {quote(str(taxel))}")
    address, position = taxel.get("id"), taxel.get("x")
    if not isinstance(address, int) or isinstance(address, bool) or address < 0:
        raise FileError(f"{where}: id must be a whole number, got {quote(str(address))}")
    if not isinstance(position, list) or not _is_point(position):
        raise FileError(f"{where}: x must be three finite numbers, got {quote(str(position))}")
    normal = taxel.get("n")
    vector = normal if isinstance(normal, list) and _is_point(normal) else [0.0] * 3
    length = math.hypot(*vector)
    unit = [x / length if 0 < length < math.inf else math.nan for x in vector]
    return address, [float(x) for x in position], unit


def _is_point(values: list[Any]) -> bool:
    numbers = [x for x in values if isinstance(x, int | float) and not isinstance(x, bool)]
    return len(numbers) == len(values) == 3 and all(map(math.isfinite, numbers))
