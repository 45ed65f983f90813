"""Maps as JSON: what the map is, then an object a sensor; unknown numbers are null."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from anisomap.errors import FileError
from anisomap.io.parsing.comments import python_scalar
from anisomap.io.parsing.map_facts import from_provenance, to_provenance
from anisomap.io.parsing.source import opened_text, quoted
from anisomap.recording import Scalar
from anisomap.sensor_map import SensorMap

_MARK = "anisomap map"
# Strict JSON has no infinities; a name tells them apart from a text of the same letters.
_INFINITE = "float"


def recognises(path: Path, head: bytes) -> bool:
    """Tell a JSON object by its first character."""
    return head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{")


def read_map(path: Path) -> SensorMap:
    """Read a map from JSON.

    Parameters
    ----------
    path : pathlib.Path
        An object with a list ``sensors`` of objects, each with a ``position``, and whatever else
        `write_map` writes.

    Returns
    -------
    SensorMap

    Raises
    ------
    FileError
        If it is not valid JSON (with line and column), or a sensor is not as it should be.
    """
    with opened_text(path) as stream:
        content = stream.read()
    try:
        document = json.loads(content)
    except json.JSONDecodeError as error:
        raise FileError(
            f"{path}, line {error.lineno}, column {error.colno}: not valid JSON ({error.msg})"
        ) from error
    except (ValueError, RecursionError) as error:
        raise FileError(f"{path}: not valid JSON ({error})") from error
    sensors = document.get("sensors") if isinstance(document, dict) else None
    if not isinstance(sensors, list) or not sensors:
        raise FileError(f"{path} is JSON, but no map: it has no list of sensors")
    rows = [_Sensor(path, i, sensor) for i, sensor in enumerate(sensors)]
    dimensions = len(rows[0].value("position", (list,)))
    named, placed = "name" in sensors[0], "component" in sensors[0]
    return SensorMap(
        np.array([row.position(dimensions) for row in rows]),
        names=tuple(row.value("name", (str,)) for row in rows) if named else (),
        component=np.array([row.value("component", (int,)) for row in rows if placed], np.intp),
        health=tuple(row.value("health", (str,), "ok") for row in rows),
        **_described(path, document),
    )


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as strict JSON.

    Parameters
    ----------
    sensor_map : SensorMap
        What to write; all of it reads back equal.
    path : pathlib.Path
        Where.
    """
    document = {
        "format": _MARK,
        "known_up_to": sensor_map.known_up_to,
        "method": sensor_map.method,
        "units": sensor_map.units,
        **sensor_map.reference,
        "stress": _strict(float(sensor_map.stress)),
        "confidence": _strict(float(sensor_map.confidence)),
        "notes": list(sensor_map.notes),
        "provenance": {k: _strict(value) for k, value in to_provenance(sensor_map).items()},
        "dimensions": sensor_map.dimensions,
        "sensors": [
            {
                "name": name,
                "position": [_strict(coordinate) for coordinate in position],
                "component": component,
                "health": health,
            }
            for name, position, component, health in zip(
                sensor_map.names,
                sensor_map.positions.tolist(),
                sensor_map.component.tolist(),
                sensor_map.health,
                strict=True,
            )
        ],
    }
    text = json.dumps(document, indent=1, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


class _Sensor:
    """One object of the list of sensors, with its number for messages."""

    def __init__(self, path: Path, number: int, content: object) -> None:
        self.where = f"{path}, sensor {number}"
        if not isinstance(content, dict):
            raise FileError(f"{self.where}: must be an object with a position")
        self.content: dict[str, Any] = content

    def value(self, key: str, kinds: tuple[type, ...], default: object = None) -> Any:
        value = self.content.get(key, default)
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            wanted = " or ".join(kind.__name__ for kind in kinds)
            raise FileError(f"{self.where}: {key} is {quoted(str(value))}; it must be a {wanted}")
        return value

    def position(self, dimensions: int) -> list[float]:
        values = self.value("position", (list,))
        if len(values) != dimensions:
            problem = f"position has {len(values)} coordinates, but that of sensor 0 {dimensions}"
            raise FileError(f"{self.where}: {problem}")
        try:
            return [_loose(value) for value in values]
        except ValueError:
            problem = f"position {quoted(str(values))} must be of numbers or null"
            raise FileError(f"{self.where}: {problem}") from None


def _strict(value: Scalar) -> object:
    """Make of a number what strict JSON can hold."""
    scalar = python_scalar(value)
    if not isinstance(scalar, float) or math.isfinite(scalar):
        return scalar
    return None if math.isnan(scalar) else {_INFINITE: repr(scalar)}


def _loose(value: object) -> float:
    """Undo `_strict` for a number."""
    if value is None:
        return math.nan
    if isinstance(value, dict) and isinstance(value.get(_INFINITE), str):
        return float(value[_INFINITE])
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value)
    raise ValueError(f"{value!r} is no number")


def _described(path: Path, document: dict[str, Any]) -> dict[str, Any]:
    """Give what the document says of the map as a whole."""
    notes, provenance = document.get("notes", []), document.get("provenance", {})
    try:
        return {
            "units": str(document.get("units", "")),
            "method": str(document.get("method", "")),
            "stress": _loose(document.get("stress")),
            "confidence": _loose(document.get("confidence")),
            "notes": tuple(map(str, notes)),
            **from_provenance(
                {
                    key: value if isinstance(value, Scalar) else _loose(value)
                    for key, value in provenance.items()
                }
            ),
        }
    except (ValueError, TypeError, AttributeError) as error:
        raise FileError(
            f"{path}: stress must be a number (as confidence), notes a list, and provenance an "
            f"object of text and numbers ({error})"
        ) from error
