"""Files of a live session: maps, the report, and exports for robots."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from anisomap import io
from anisomap.drawing import figures, report
from anisomap.errors import InputError
from anisomap.health import summarise
from anisomap.live.examination import Examination
from anisomap.placement import parse_length, scaled_to_spacing
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap

EXPORTS = (".csv", ".json", ".ply", ".pcd", ".npz", ".urdf", ".mjcf", ".icub.txt", ".launch.xml")
"""Suffixes of the exports that the page offers."""


def save_map(
    examination: Examination | None, path: Path, *, spacing: str = "", inputs: Iterable[Path] = ()
) -> Path:
    """Write the checked map of a session.

    Parameters
    ----------
    examination : Examination or None
    path : pathlib.Path
        Its suffix chooses the format.
    spacing : str
        Distance between neighbouring sensors, such as ``"6.5mm"``; formats in metres require it.
    inputs : iterable of pathlib.Path
        Files that must not be replaced.

    Returns
    -------
    pathlib.Path
        The same path.

    Raises
    ------
    InputError
        If there is no checked map yet, the spacing is not a length, or the format requires one.
    FileError
        If the file cannot be written.
    """
    sensor_map = map_of(examination)
    if path.resolve() in {other.resolve() for other in inputs}:
        raise InputError(f"{path} is the recording; give the map another name")
    if spacing:
        sensor_map = scaled_to_spacing(sensor_map, *parse_length(spacing))
    elif io.needs_scale(path):
        raise InputError(
            f"the format of {path.name} is in metres: give the distance between neighbouring "
            "sensors, such as 6.5mm"
        )
    io.write(sensor_map, path)
    return path


def save_report(examination: Examination | None, path: Path, recording: Path) -> Path:
    """Write the report on the checked map of a session.

    Parameters
    ----------
    examination : Examination or None
    path : pathlib.Path
        Must end in ``.html``.
    recording : pathlib.Path
        The recording of the session, which is summarised.

    Returns
    -------
    pathlib.Path
        The same path.

    Raises
    ------
    InputError
        If there is no checked map yet.
    MissingExtraError
        If the libraries of reports are not installed.
    """
    sensor_map = map_of(examination)
    report.check_writable(path)
    health = () if examination is None else examination.health
    read: Recording = io.read(recording)
    report.write_report(
        path,
        sensor_map,
        health=health,
        summary=summarise(read.complete("interpolate"), health),
        figure_png=figures.figure_bytes(figures.map_figure(sensor_map)),
    )
    return path


def map_of(examination: Examination | None) -> SensorMap:
    """Return the checked map.

    Raises
    ------
    InputError
        If there is none yet.
    """
    if examination is None or examination.sensor_map is None:
        reason = "" if examination is None else f": {examination.reason}"
        raise InputError(f"there is no checked map yet{reason}")
    return examination.sensor_map
