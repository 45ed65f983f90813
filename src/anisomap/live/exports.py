"""A session for viewers: readings over time at the places of a map, for Foxglove and Rerun."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import import_extra
from anisomap.evaluation import median_spacing
from anisomap.files import atomic_write
from anisomap.numerics.similarity.rest import estimate_rest
from anisomap.placement import METRES
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
    with path.open("wb") as file:
        writer = writing.Writer(file)
        writer.start(profile="", library="anisomap")
        clouds, names = (
            writer.register_channel(
                topic=topic,
                message_encoding="json",
                schema_id=writer.register_schema(name, "jsonschema", b'{"type": "object"}'),
            )
            for topic, name in (("/skin", "foxglove.PointCloud"), ("/names", "anisomap.Names"))
        )
        text = json.dumps({"names": session.names}).encode()
        writer.add_message(names, log_time=0, publish_time=0, data=text)
        fields = [
            {"name": name, "offset": 4 * i, "type": _FLOAT32}
            for i, name in enumerate(("x", "y", "z", "reading"))
        ]
        for time, levels in zip(session.times, session.levels, strict=True):
            moment = int(time * 1e9)
            points = np.column_stack([session.points, levels]).astype("<f4").tobytes()
            cloud = {
                "timestamp": dict(zip(("sec", "nsec"), divmod(moment, 10**9), strict=True)),
                "frame_id": session.frame,
                "pose": {
                    "position": {"x": 0, "y": 0, "z": 0},
                    "orientation": {"x": 0, "y": 0, "z": 0, "w": 1},
                },
                "point_stride": 16,
                "fields": fields,
                "data": base64.b64encode(points).decode(),
            }
            data = json.dumps(cloud).encode()
            writer.add_message(clouds, log_time=moment, publish_time=moment, data=data)
        writer.finish()


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
