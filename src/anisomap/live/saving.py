"""Files of a live session: maps, the report, and readings over time for Foxglove and Rerun."""

from __future__ import annotations

import base64
import json
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap import io
from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.drawing import report
from anisomap.errors import InputError, import_extra
from anisomap.evaluation import median_spacing
from anisomap.files.paths import atomic_write
from anisomap.live.workers import Examination, ExaminationOptions
from anisomap.method.dimensions import AUTO
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.placement import METRES, Anchors, parse_length, place, scaled_to_spacing
from anisomap.recording import Recording
from anisomap.sensor_map import UNSCALED, SensorMap

MAX_RATE_HZ = 25.0
"""Rate of the exported readings: the strongest of each interval is kept."""

_FLOAT32 = 7  # of foxglove.PackedElementField


@dataclass(frozen=True, eq=False)
class _Session:
    """What viewers are given: points (n, 3), levels (t, n) from 0 (rest) to 1, times (t,) in s."""

    names: tuple[str, ...]
    points: NDArray[np.float32]
    levels: NDArray[np.float32]
    times: NDArray[np.float64]
    frame: str


def save_session(sensor_map: SensorMap, recording: Recording, path: Path) -> Path:
    """Write a recording at the places of its map; the suffix chooses the viewer."""
    session = _session(sensor_map, recording.complete("interpolate"))
    with atomic_write(path) as aside:
        SESSIONS[path.suffix.lower()](session, aside)
    return path


def _session(sensor_map: SensorMap, recording: Recording) -> _Session:
    placed = np.flatnonzero(sensor_map.placed & (sensor_map.component == 0))
    names = tuple(sensor_map.names[i] for i in placed)
    columns = [recording.names.index(name) for name in names]
    points = np.zeros((len(placed), 3), dtype=np.float32)
    width = min(3, sensor_map.dimensions)
    points[:, :width] = sensor_map.positions[placed, :width]
    if sensor_map.units in UNSCALED:  # viewers need some size
        points /= median_spacing(sensor_map.positions[placed]) or 1.0
    else:
        points *= METRES[sensor_map.units]
    depth = estimate_rest(recording.readings).depth(recording.readings)[:, columns]
    strongest = depth.max(axis=0)
    levels = np.divide(depth, strongest, out=np.zeros_like(depth), where=strongest > 0)
    times = recording.times
    if times is None:
        times = np.arange(recording.n_frames) / (recording.rate_hz or MAX_RATE_HZ)
    # A frame at the end of an interval belongs to the next, whichever way its time was rounded.
    interval = np.floor((times - times[0]) * MAX_RATE_HZ + 1e-6).astype(int)
    starts = np.flatnonzero(np.diff(interval, prepend=-1))
    return _Session(
        names,
        points,
        np.maximum.reduceat(levels, starts).astype(np.float32),
        times[starts] - times[0],
        sensor_map.frame,
    )


def _write_mcap(session: _Session, path: Path) -> None:
    """Write messages foxglove.PointCloud, with a field for the readings, and the names once."""
    writing = import_extra("mcap.writer", "writing MCAP", "mcap")
    fields = [
        {"name": name, "offset": 4 * i, "type": _FLOAT32}
        for i, name in enumerate(("x", "y", "z", "reading"))
    ]

    def cloud(moment: int, levels: NDArray[np.float32]) -> dict[str, Any]:
        return {
            "timestamp": dict(zip(("sec", "nsec"), divmod(moment, 10**9), strict=True)),
            "frame_id": session.frame,
            "pose": {
                "position": dict.fromkeys("xyz", 0.0),
                "orientation": dict.fromkeys("xyz", 0.0) | {"w": 1.0},
            },
            "point_stride": 16,
            "fields": fields,
            "data": np.column_stack([session.points, levels]).astype("<f4").tobytes(),
        }

    with path.open("wb") as file:
        writer = writing.Writer(file)
        writer.start(profile="", library="anisomap")

        def write(channel: int, moment: int, message: dict[str, Any]) -> None:
            data = json.dumps(message, default=lambda raw: base64.b64encode(raw).decode()).encode()
            writer.add_message(channel, log_time=moment, publish_time=moment, data=data)

        names = {"names": session.names}
        clouds, once = (
            writer.register_channel(
                topic=topic,
                message_encoding="json",
                schema_id=writer.register_schema(
                    name, "jsonschema", json.dumps(_schema_of(example)).encode()
                ),
            )
            for topic, name, example in (
                ("/skin", "foxglove.PointCloud", cloud(0, session.levels[0])),
                ("/names", "anisomap.Names", names),
            )
        )
        write(once, 0, names)
        for time, levels in zip(session.times, session.levels, strict=True):
            write(clouds, moment := int(time * 1e9), cloud(moment, levels))
        writer.finish()


def _schema_of(value: object) -> dict[str, Any]:
    """Describe a message as JSON Schema: Foxglove reads no property that its schema does not name.

    Bytes are text in base64, which Foxglove decodes if the schema says so.
    """
    match value:
        case dict():
            properties = {key: _schema_of(item) for key, item in value.items()}
            return {"type": "object", "properties": properties}
        case list() | tuple():
            return {"type": "array", "items": _schema_of(value[0])}
        case bytes():
            return {"type": "string", "contentEncoding": "base64"}
    return {"type": {str: "string", int: "integer", float: "number"}[type(value)]}


def _write_rrd(session: _Session, path: Path) -> None:
    """Write points whose colours follow the readings, and the readings as curves."""
    rerun = import_extra("rerun", "writing RRD", "rerun")
    stream = rerun.RecordingStream("anisomap")
    stream.save(path)
    radius = 0.3 * median_spacing(session.points)
    light, dark = np.array([236, 240, 244]), np.array([8, 48, 107])  # as on the live page
    stream.log("skin", rerun.Points3D(session.points, labels=session.names), static=True)
    for time, levels in zip(session.times, session.levels, strict=True):
        stream.set_time("time", duration=float(time))
        colours = (light + levels[:, None] * (dark - light)).astype(np.uint8)
        stream.log("skin", rerun.Points3D(session.points, colors=colours, radii=radius))
        stream.log("readings", rerun.Scalars(levels))
    stream.flush()
    stream.disconnect()


SESSIONS: Mapping[str, Callable[[_Session, Path], None]] = MappingProxyType(
    {".mcap": _write_mcap, ".rrd": _write_rrd}
)
"""Writers of sessions by suffix."""


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
    )
    return path


def map_of(examination: Examination | None) -> SensorMap:
    """Return the checked map."""
    if examination is None or examination.sensor_map is None:
        reason = "" if examination is None else f": {examination.verdict.reasons[0]}"
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
