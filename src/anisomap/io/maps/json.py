"""Maps as JSON: properties of the map, then one object per sensor; NaN is null."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from anisomap.errors import FileError
from anisomap.io.parsing.facts import from_provenance, to_provenance, to_python_scalar
from anisomap.io.parsing.json_text import read_json
from anisomap.io.parsing.naming import distinct_names
from anisomap.io.parsing.source import quote
from anisomap.recording import Scalar
from anisomap.sensor_map import UNASSESSED, SensorMap
from anisomap.usability import ACCURACY, UNKNOWN, Verdict

_MARK = "anisomap map"
SIGNATURE = f'{{\n "format": "{_MARK}"'.encode()
# Strict JSON has no infinities; {"float": "inf"} differs from the string "inf".
_INFINITE = "float"


def recognises(path: Path, head: bytes) -> bool:
    """Recognise a JSON object by its first character."""
    return head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"{")


def read_map(path: Path) -> SensorMap:
    """Read a map from an object with a list ``sensors`` of objects, each with a ``position``.

    All other properties that `write_map` writes are optional.
    """
    document = read_json(path)
    listed = document.get("sensors") if isinstance(document, dict) else None
    if not isinstance(listed, list) or not listed:
        raise FileError(f"{path} is JSON without a list of sensors, so it is not a map")
    sensors = [_Sensor(f"{path}, sensor {i}", content) for i, content in enumerate(listed)]
    return SensorMap(**_columns(path, sensors), **_map_properties(path, document))


def write_map(sensor_map: SensorMap, path: Path) -> None:
    """Write a map as strict JSON; every field is read back equal."""
    document = {
        "format": _MARK,
        "known_up_to": sensor_map.known_up_to,
        "method": sensor_map.method,
        "units": sensor_map.units,
        **sensor_map.reference,
        "stress": _to_json(float(sensor_map.stress)),
        "verdict": {
            "level": sensor_map.verdict.level,
            **{name: _to_json(float(getattr(sensor_map.verdict, name))) for name in ACCURACY},
            "reasons": list(sensor_map.verdict.reasons),
        },
        "notes": list(sensor_map.notes),
        "provenance": {k: _to_json(value) for k, value in to_provenance(sensor_map).items()},
        "dimensions": sensor_map.dimensions,
        "sensors": [
            {
                "name": name,
                "position": [_to_json(coordinate) for coordinate in position],
                "component": component,
                "health": health,
                **({} if math.isnan(error) else {"error": _to_json(error)}),
                **({} if covariance is None else {"covariance": _rows_to_json(covariance)}),
                **({} if normal is None else {"normal": [_to_json(value) for value in normal]}),
            }
            for name, position, component, health, error, covariance, normal in zip(
                sensor_map.names,
                sensor_map.positions.tolist(),
                sensor_map.component.tolist(),
                sensor_map.health,
                sensor_map.errors.tolist(),
                [None] * sensor_map.n_sensors
                if sensor_map.covariances is None
                else sensor_map.covariances.tolist(),
                [None] * sensor_map.n_sensors
                if sensor_map.normals is None
                else sensor_map.normals.tolist(),
                strict=True,
            )
        ],
    }
    text = json.dumps(document, indent=1, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def _columns(path: Path, sensors: list[_Sensor]) -> dict[str, Any]:
    """Return the fields of a map that have a value per sensor; the first sensor tells which."""
    first = sensors[0].content
    size = len(sensors[0].value("position", (list,)))
    names = [row.value("name", (str,)) for row in sensors] if "name" in first else []
    component = [row.value("component", (int,)) for row in sensors] if "component" in first else []
    oriented = all("normal" in row.content for row in sensors)
    return {
        "positions": np.array([row.numbers("position", size) for row in sensors]),
        "names": distinct_names(path, names),
        "component": np.array(component, np.intp),
        "health": tuple(row.value("health", (str,), UNASSESSED) for row in sensors),
        "errors": np.array([row.number("error") for row in sensors]),
        "covariances": np.array([row.matrix("covariance", size) for row in sensors])
        if "covariance" in first
        else None,
        "normals": np.array([row.numbers("normal", 3) for row in sensors]) if oriented else None,
    }


class _Sensor:
    """An object in the list of sensors, with its place for messages."""

    def __init__(self, where: str, content: object) -> None:
        self.where = where
        if not isinstance(content, dict):
            raise FileError(f"{where}: must be an object with a position")
        self.content: dict[str, Any] = content

    def value(self, key: str, kinds: tuple[type, ...], default: object = None) -> Any:
        value = self.content.get(key, default)
        if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
            expected = " or ".join(kind.__name__ for kind in kinds)
            raise FileError(f"{self.where}: {key} is {quote(str(value))}; it must be {expected}")
        return value

    def numbers(self, key: str, count: int) -> list[float]:
        values = self.value(key, (list,))
        if len(values) != count:
            raise FileError(
                f"{self.where}: {key} must have {count} coordinates, as for sensor 0, "
                f"got {len(values)}"
            )
        try:
            return [_from_json(value) for value in values]
        except ValueError:
            problem = f"{key} must hold numbers or null, got {quote(str(values))}"
            raise FileError(f"{self.where}: {problem}") from None

    def matrix(self, key: str, size: int) -> list[list[float]]:
        rows = self.value(key, (list,))
        if len(rows) != size:
            raise FileError(f"{self.where}: {key} must have {size} rows, got {len(rows)}")
        entries = _Sensor(self.where, {f"{key} row {i}": row for i, row in enumerate(rows)})
        return [entries.numbers(name, size) for name in entries.content]

    def number(self, key: str) -> float:
        try:
            return _from_json(self.content.get(key))
        except ValueError:
            value = quote(str(self.content[key]))
            raise FileError(f"{self.where}: {key} is {value}; it must be a number") from None


def _rows_to_json(rows: list[list[float]]) -> list[list[object]]:
    return [[_to_json(value) for value in row] for row in rows]


def _to_json(value: Scalar) -> object:
    """Convert a scalar to a value of strict JSON."""
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


def _verdict(content: dict[str, Any]) -> Verdict:
    return Verdict(
        str(content.get("level", UNKNOWN)),
        **{name: _from_json(content.get(name)) for name in ACCURACY},
        reasons=tuple(map(str, content.get("reasons", []))),
    )


def _map_properties(path: Path, document: dict[str, Any]) -> dict[str, Any]:
    notes, provenance = document.get("notes", []), document.get("provenance", {})
    try:
        return {
            "units": str(document.get("units", "")),
            "method": str(document.get("method", "")),
            "stress": _from_json(document.get("stress")),
            "verdict": _verdict(document.get("verdict", {})),
            "notes": tuple(map(str, notes)),
            **from_provenance(
                {
                    key: value if isinstance(value, Scalar) else _from_json(value)
                    for key, value in provenance.items()
                }
            ),
        }
    except (ValueError, TypeError, AttributeError) as error:
        raise FileError(
            f"{path}: stress must be a number, notes a list, verdict an object as anisomap writes "
            f"it, and provenance an object of strings and numbers ({error})"
        ) from error
