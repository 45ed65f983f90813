"""Maps as JSON, and calibrations of CySkin.

A map has its properties, then one object per sensor; NaN is null. A calibration has the address,
position and normal of each taxel, in metres; normals become unit vectors, and those of zero length
are unknown.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np

from anisomap.errors import FileError
from anisomap.io.parsing.facts import properties_of, read_properties, to_python_scalar
from anisomap.io.parsing.names import distinct_names
from anisomap.io.parsing.source import quote, read_json
from anisomap.recording import Scalar
from anisomap.sensor_map import UNASSESSED, SensorMap
from anisomap.usability import ACCURACY, UNKNOWN

_MARK = "anisomap map"
SIGNATURE = f'{{\n "format": "{_MARK}"'.encode()
# Strict JSON has no infinities; {"float": "inf"} differs from the string "inf".
_INFINITE = "float"
_VERDICT = ("verdict", *ACCURACY, "reasons")  # properties in an object of their own


def recognises(path: Path, head: bytes) -> bool:
    """Recognise a JSON object by its first character."""
    return head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{")


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as strict JSON; every field is read back equal."""
    known = properties_of(sensor_map)
    verdict = {"level": known["verdict"], **{key: known[key] for key in _VERDICT[1:]}}
    columns: dict[str, Sequence[Any]] = {
        "name": sensor_map.names,
        "position": sensor_map.positions.tolist(),
        "component": sensor_map.component.tolist(),
        "health": sensor_map.health,
        "error": sensor_map.errors.tolist(),
    }
    for key, values in (("covariance", sensor_map.covariances), ("normal", sensor_map.normals)):
        if values is not None:
            columns[key] = values.tolist()
    document = {
        "format": _MARK,
        "known_up_to": sensor_map.known_up_to,
        **{
            key: verdict if key == "verdict" else value
            for key, value in known.items()
            if key == "verdict" or key not in _VERDICT
        },
        "dimensions": sensor_map.dimensions,
        "sensors": [
            {k: v for k, v in zip(columns, row, strict=True) if k != "error" or not math.isnan(v)}
            for row in zip(*columns.values(), strict=True)
        ],
    }
    text = json.dumps(_to_json(document), indent=1, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def read_map(path: Path) -> SensorMap:
    """Read a map from an object with a list ``sensors`` of objects, each with a ``position``.

    All other properties that `write_map` writes are optional; the first sensor tells which there
    are.
    """
    document = read_json(path)
    listed = document.get("sensors") if isinstance(document, dict) else None
    if not isinstance(listed, list) or not listed:
        raise FileError(f"{path} is JSON without a list of sensors, so it is not a map")
    for i, sensor in enumerate(listed):
        if not isinstance(sensor, dict):
            raise FileError(f"{path}, sensor {i}: must be an object with a position")

    def typed(key: str, kind: type, default: object = None) -> list[Any]:
        values = [sensor.get(key, default) for sensor in listed]
        for i, value in enumerate(values):
            if type(value) is not kind:
                where, shown = f"{path}, sensor {i}: {key}", quote(str(value))
                raise FileError(f"{where} is {shown}; it must be {kind.__name__}")
        return values

    def numbers(key: str, *shape: int) -> list[Any]:
        return [
            _numbers(f"{path}, sensor {i}: {key}", sensor.get(key), shape)
            for i, sensor in enumerate(listed)
        ]

    first = listed[0]
    k = len(typed("position", list)[0])
    oriented = all("normal" in sensor for sensor in listed)
    return SensorMap(
        np.array(numbers("position", k)),
        names=distinct_names(path, typed("name", str) if "name" in first else []),
        component=np.array(typed("component", int) if "component" in first else [], np.intp),
        health=tuple(typed("health", str, UNASSESSED)),
        errors=np.array(numbers("error")),
        covariances=np.array(numbers("covariance", k, k)) if "covariance" in first else None,
        normals=np.array(numbers("normal", 3)) if oriented else None,
        **_read_properties(path, document),
    )


def _numbers(what: str, value: object, shape: tuple[int, ...]) -> Any:
    """Convert a number, or nested lists of numbers."""
    if not shape:
        try:
            return _from_json(value)
        except ValueError:
            raise FileError(f"{what} must hold numbers or null, got {quote(str(value))}") from None
    if not isinstance(value, list):
        raise FileError(f"{what} is {quote(str(value))}; it must be list")
    if len(value) != shape[0]:
        raise FileError(
            f"{what} must have {shape[0]} coordinates, as for sensor 0, got {len(value)}"
        )
    return [_numbers(what, each, shape[1:]) for each in value]


def _read_properties(path: Path, document: dict[str, Any]) -> dict[str, Any]:
    try:
        verdict = dict(document.get("verdict", {}))
        stored = {**document, **verdict, "verdict": verdict.get("level", UNKNOWN)}
        numbers = {key: _from_json(stored.get(key)) for key in ("stress", *ACCURACY)}
        provenance = {
            key: value if isinstance(value, Scalar) else _from_json(value)
            for key, value in stored.get("provenance", {}).items()
        }
        return read_properties({**stored, **numbers, "provenance": provenance})
    except (ValueError, TypeError, AttributeError) as error:
        raise FileError(
            f"{path}: stress must be a number, notes a list, verdict an object as anisomap writes "
            f"it, and provenance an object of strings and numbers ({error})"
        ) from error


def _to_json(value: Any) -> Any:
    """Convert to values of strict JSON."""
    if isinstance(value, dict):
        return {key: _to_json(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_to_json(each) for each in value]
    scalar = to_python_scalar(value)
    if not isinstance(scalar, float) or math.isfinite(scalar):
        return scalar
    return None if math.isnan(scalar) else {_INFINITE: repr(scalar)}


def _from_json(value: object) -> float:
    """Invert `_to_json` for a number."""
    if value is None:
        return math.nan
    if isinstance(value, dict) and isinstance(value.get(_INFINITE), str):
        return float(value[_INFINITE])
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    raise ValueError(f"{value!r} is not a number")


def is_calibration(path: Path, head: bytes) -> bool:
    """Recognise a JSON object with the keys skin and taxels near its start."""
    return recognises(path, head) and all(key in head for key in (b'"skin"', b'"taxels"'))


def read_calibration(path: Path) -> SensorMap:
    """Read the taxels of all patches of CySkin, named by their addresses.

    Taxels with address 0, which no module reads, are left out. Repeated addresses are numbered in
    the order of the file, as in recordings.
    """
    document = read_json(path)
    skin = document.get("skin") if isinstance(document, dict) else None
    listed = skin.get("taxels") if isinstance(skin, dict) else None
    if not isinstance(listed, list):
        raise FileError(f"{path} is JSON without the taxels of a skin")
    # Some versions list them by patch.
    taxels = (taxel for each in listed for taxel in (each if isinstance(each, list) else [each]))
    found = [_taxel(f"{path}, taxel {i}", taxel) for i, taxel in enumerate(taxels)]
    kept = [taxel for taxel in found if taxel[0]]
    if not kept:
        raise FileError(f"{path} holds no taxel with an address")
    return SensorMap(
        np.array([position for _, position, _ in kept]),
        names=distinct_names(path, [str(address) for address, _, _ in kept]),
        normals=np.array([normal for _, _, normal in kept]),
        units="m",
    )


def _taxel(where: str, taxel: Any) -> tuple[int, list[float], list[float]]:
    """Return the address, position and unit normal of a taxel; NaN without a normal."""
    if not isinstance(taxel, dict):
        raise FileError(f"{where}: must be an object with id and x, got {quote(str(taxel))}")
    address, position, normal = taxel.get("id"), taxel.get("x"), taxel.get("n")
    if type(address) is not int or address < 0:
        raise FileError(f"{where}: id must be a whole number, got {quote(str(address))}")
    if not _is_point(position):
        raise FileError(f"{where}: x must be three finite numbers, got {quote(str(position))}")
    vector = normal if _is_point(normal) else [0.0] * 3
    length = math.hypot(*vector)
    unit = [x / length if 0 < length < math.inf else math.nan for x in vector]
    return address, [float(x) for x in position], unit


def _is_point(values: object) -> TypeGuard[list[float]]:
    return (
        isinstance(values, list)
        and [type(x) in (int, float) for x in values] == [True] * 3
        and all(map(math.isfinite, values))
    )
