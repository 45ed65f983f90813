"""Files of a live session: maps, the report, and exports for robots."""

from __future__ import annotations

import shlex
from pathlib import Path

from anisomap import io
from anisomap.defaults import DEFAULT_METHOD
from anisomap.dimensions import AUTO
from anisomap.drawing import figures, report
from anisomap.errors import InputError
from anisomap.live.examination import Examination, ExaminationOptions
from anisomap.live.exports import SESSIONS, save_session
from anisomap.placement import Anchors, parse_length, place, scaled_to_spacing
from anisomap.sensor_map import SensorMap

EXPORTS = (
    ".csv", ".json", ".ply", ".pcd", ".npz", ".urdf", ".mjcf", ".icub.txt", ".launch.xml", *SESSIONS
)  # fmt: skip
"""Suffixes of the exports that the page offers."""


def save_map(
    examination: Examination | None,
    path: Path,
    *,
    recording: Path,
    preset: str = "",
    spacing: str = "",
    anchors: Anchors | None = None,
) -> Path:
    """Write the checked map of a session, or what a viewer shows of the session."""
    sensor_map = map_of(examination)
    length = parse_length(spacing) if spacing else None
    if anchors is not None:
        sensor_map = place(sensor_map, anchors, spacing=length).map
    elif length is not None:
        sensor_map = scaled_to_spacing(sensor_map, *length)
    elif path.suffix.lower() not in SESSIONS and io.needs_scale(path):
        raise InputError(
            f"the format of {path.name} is in metres: give the distance between neighbouring "
            "sensors, such as 6.5mm, or anchors"
        )
    if path.suffix.lower() in SESSIONS:
        readings = io.read(recording, options=io.ReadOptions(preset=preset))
        return save_session(sensor_map, readings, path)
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
        figure_png=figures.figure_bytes(figures.map_figure(sensor_map)),
    )
    return path


def map_of(examination: Examination | None) -> SensorMap:
    """Return the checked map."""
    if examination is None or examination.sensor_map is None:
        reason = "" if examination is None else f": {examination.reason}"
        raise InputError(f"there is no checked map yet{reason}")
    return examination.sensor_map


def command_for(recording: Path, options: ExaminationOptions, *, gaps: bool) -> str:
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
    return shlex.join(words)
