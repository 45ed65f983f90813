"""Conversion of command-line arguments to bodies and parameters of scenarios."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from anisomap import io
from anisomap.errors import InputError
from anisomap.sensor_map import SensorMap
from anisomap.simulation import BODIES, Body, body_from_points, find_body, load_body
from anisomap.simulation.imported import MESH_SUFFIXES, MODEL_SUFFIXES


def find(body: str, sensors: str | None, **options: Any) -> Body:
    """Make a body from its name or file."""
    given = _parse_sensors(sensors)
    if body in BODIES:
        if given is None or isinstance(given, int):
            return find_body(body, given, **options)
        raise InputError(
            f"--sensors must be the number of sensors of the body {body}, which has predefined "
            f"positions, got {sensors}"
        )
    if options:
        raise InputError(
            f"--{next(iter(options))} applies to named bodies only, and {body} is a file"
        )
    path = Path(body)
    if path.suffix.lower() in (*MESH_SUFFIXES, *MODEL_SUFFIXES) and not _contains_only_points(path):
        if isinstance(given, Path):
            found = _positions(given)
            return load_body(path, found.positions, found.names)
        return load_body(path, given)
    if not path.exists():
        raise InputError(
            f"there is no body or file {body!r}; choose from {', '.join(BODIES)}, or give a mesh, "
            "a MuJoCo model or a file of positions"
        )
    found = _positions(path)
    return body_from_points(
        found.positions, names=found.names, name=path.name.split(".")[0], units=found.units
    )


def _parse_sensors(text: str | None) -> int | Path | None:
    if text is None:
        return None
    return int(text) if text.lstrip("-").isdecimal() else Path(text)


def _contains_only_points(path: Path) -> bool:
    """Return whether a file is a PLY point cloud, without faces, as written for maps."""
    if path.suffix.lower() != ".ply" or not path.is_file():
        return False
    with path.open("rb") as file:
        return b"element face" not in file.read(4096).split(b"end_header")[0]


def _positions(path: Path) -> SensorMap:
    found = io.read_map(path)
    if found.dimensions != 3:
        raise InputError(f"{path} must contain positions in 3 dimensions, got {found.dimensions}")
    return found


def parse_parameters(parameters: list[str]) -> dict[str, Any]:
    """Read ``NAME=VALUE`` pairs."""
    parsed: dict[str, Any] = {}
    for text in parameters:
        name, equals, value = text.partition("=")
        try:
            parsed[name.strip().replace("-", "_")] = (
                int(value) if value.strip().lstrip("+-").isdecimal() else float(value)
            )
        except ValueError as error:
            hint = f"{value!r} is not a number" if equals else "write NAME=VALUE"
            raise InputError(f"--parameter {text!r}: {hint}") from error
    return parsed
