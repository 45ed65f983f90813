"""Files of a live session: maps and the report, and the command that makes the map again."""

from __future__ import annotations

import shlex
from pathlib import Path

from anisomap import io
from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.drawing import report
from anisomap.errors import InputError
from anisomap.live.workers import Examination, ExaminationOptions
from anisomap.method.dimensions import AUTO
from anisomap.placement import parse_length, scaled_to_spacing
from anisomap.sensor_map import SensorMap


def save_map(examination: Examination | None, path: Path, *, spacing: str = "") -> Path:
    """Write the checked map of a session."""
    sensor_map = map_of(examination)
    if spacing:
        sensor_map = scaled_to_spacing(sensor_map, *parse_length(spacing))
    elif io.needs_scale(path):
        raise InputError(
            f"the format of {path.name} is in metres: give the distance between neighbouring "
            "sensors, such as 6.5mm"
        )
    io.write(sensor_map, path)
    return path


def save_report(examination: Examination | None, path: Path) -> Path:
    """Write the report on the checked map of a session."""
    sensor_map = map_of(examination)
    report.check_writable(path)
    report.write_report(
        path,
        sensor_map,
        health=() if examination is None else examination.health,
        summary=None if examination is None else examination.summary,
    )
    return path


def map_of(examination: Examination | None) -> SensorMap:
    """Return the checked map."""
    if examination is None or examination.sensor_map is None:
        reason = "" if examination is None else f": {examination.verdict.reasons[0]}"
        raise InputError(f"there is no checked map yet{reason}")
    return examination.sensor_map


def command_for(recording: Path, options: ExaminationOptions, gaps: bool) -> str:
    """Return the command that makes the final map of a session again."""
    words = ["anisomap", "map", str(recording)]
    if options.dimensions != AUTO:
        words += ["-d", str(options.dimensions)]
    if options.method != DEFAULT_METHOD:
        words += ["-m", options.method]
    if options.preset:
        words += ["--preset", options.preset]
    for name in options.drop:
        words += ["--drop", name]
    if gaps:
        words += ["--missing", "interpolate"]
    if options.spacing_mm:
        words += ["--spacing", f"{options.spacing_mm:g}mm"]
    return shlex.join(words)
