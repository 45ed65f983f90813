"""Conversion between the typed fields of a map and the provenance that files store."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from anisomap.recording import Scalar
from anisomap.sensor_map import DEFAULT_FRAME, SensorMap

_FLAGS = ("approximate", "uneven", "mirrored", "handed", "anchored")


def to_provenance(sensor_map: SensorMap) -> dict[str, Scalar]:
    """Return the provenance of a map, extended by its frame and the flags that are set."""
    flags: dict[str, Scalar] = {name: True for name in _FLAGS if getattr(sensor_map, name)}
    frame = {} if sensor_map.frame == DEFAULT_FRAME else {"frame": sensor_map.frame}
    return {**sensor_map.provenance, **flags, **frame}


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
        "provenance": {k: v for k, v in stored.items() if k not in (*_FLAGS, "frame")},
    }
