"""Conversion between the typed fields of a map and the provenance that files store."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from anisomap.recording import Scalar
from anisomap.sensor_map import DEFAULT_FRAME, SensorMap

_FLAGS = ("approximate", "uneven", "mirrored", "handed", "anchored")
_FIELDS = (*_FLAGS, "frame")

_ESCAPE = "~"
"""Precedes a key of the provenance that is also the name of a field."""


def to_provenance(sensor_map: SensorMap) -> dict[str, Scalar]:
    """Return the provenance of a map, extended by its frame and the flags that are set."""
    flags: dict[str, Scalar] = {name: True for name in _FLAGS if getattr(sensor_map, name)}
    frame = {} if sensor_map.frame == DEFAULT_FRAME else {"frame": sensor_map.frame}
    provenance = {
        f"{_ESCAPE}{key}" if key.lstrip(_ESCAPE) in _FIELDS else key: value
        for key, value in sensor_map.provenance.items()
    }
    return {**provenance, **flags, **frame}


def from_provenance(stored: Mapping[str, Scalar]) -> dict[str, Any]:
    """Split stored provenance into arguments of `SensorMap`."""
    facts: dict[str, Any] = {name: stored[name] is True for name in _FLAGS if name in stored}
    if "frame" in stored:
        facts["frame"] = str(stored["frame"])
    if "precomputed" not in stored:
        facts["similarity"] = str(stored.get("similarity", ""))
    iterations = stored.get("iterations")
    if isinstance(iterations, int):
        facts["n_iterations"] = int(iterations)
    return {
        **facts,
        "provenance": {
            key.removeprefix(_ESCAPE) if key.lstrip(_ESCAPE) in _FIELDS else key: value
            for key, value in stored.items()
            if key not in _FIELDS
        },
    }
