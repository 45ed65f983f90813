"""The checked map of a live session: exactly the map of ``anisomap map``, with its verdict."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass
from pathlib import Path

from anisomap import io, route
from anisomap.defaults import DEFAULT_METHOD
from anisomap.dimensions import AUTO, Dimensions
from anisomap.errors import AnisomapError
from anisomap.evaluation import score
from anisomap.health import RecordingSummary, SensorHealth
from anisomap.large.chunks import Excerpt
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from anisomap.usability import Verdict

MAX_READINGS = 1 << 27
"""Readings of a final map above which they are read in blocks, as ``anisomap map`` does: 512 MiB
of float32."""

MAX_INTERIM_READINGS = 1 << 22
"""Readings of a checked map while the session runs; of more, evenly spread parts are used."""


@dataclass(frozen=True, eq=False)
class Examination:
    """A checked map.

    sensor_map: None if there is no map yet, for the reason of the verdict.
    error_against_truth: RMS error in spacings, if the truth is known; else NaN.
    n_frames: Number of frames of the recording when it was read.
    final: Whether all frames of the session are in the map.
    """

    sensor_map: SensorMap | None
    health: tuple[SensorHealth, ...]
    summary: RecordingSummary | None
    verdict: Verdict
    error_against_truth: float
    n_frames: int
    seconds: float
    final: bool


@dataclass(frozen=True)
class ExaminationOptions:
    """What a checked map is made with.

    dimensions: Number of coordinates; "auto" chooses it for each checked map.
    preset: See `ReadOptions`.
    drop: Sensors to leave out.
    truth: Positions to compare with.
    """

    dimensions: Dimensions = AUTO
    method: str = DEFAULT_METHOD
    preset: str = ""
    drop: tuple[str, ...] = ()
    truth: SensorMap | None = None


def examine(
    path: Path, n_frames: int, options: ExaminationOptions, *, final: bool = False
) -> Examination:
    """Map the recording of a session, and judge the map."""
    begun = time.monotonic()
    made: SensorMap | None = None
    examined: route.Examined | None = None
    verdict, error = Verdict(), float("nan")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            examined = route.examine(_read(path, n_frames, options, final))
            drop = [name for name in options.drop if name in examined.recording.names]
            made, judge = route.make_map(examined, options.method, options.dimensions, drop=drop)
            made = made if judge is None else judge(made)
            if options.truth is not None:
                error = score(made, options.truth, permutations=0).rms_in_spacings
        except AnisomapError as problem:
            verdict = Verdict(reasons=(str(problem),))
    return Examination(
        sensor_map=made,
        health=() if examined is None else tuple(examined.health),
        summary=None if examined is None else examined.summary,
        verdict=verdict if made is None else made.verdict,
        error_against_truth=error,
        n_frames=n_frames,
        seconds=time.monotonic() - begun,
        final=final,
    )


def _read(path: Path, n_frames: int, options: ExaminationOptions, final: bool) -> route.Source:
    """Read a recording as `anisomap map` does; parts of it if it is long and still grows."""
    how = io.ReadOptions(preset=options.preset)
    with io.open_stream(path, frames=1) as stream:
        n_readings = n_frames * stream.n_sensors
    if final and n_readings > MAX_READINGS:
        return route.read_in_blocks([path], how, "interpolate", method=options.method)
    if final or n_readings <= MAX_INTERIM_READINGS:
        return route.read_runs([path], how, "interpolate")
    excerpt = Excerpt(MAX_INTERIM_READINGS)
    with io.open_stream(path) as stream:
        for block in stream.blocks:
            excerpt.add(block.readings)
        parts = Recording(excerpt.readings, names=stream.names, source=stream.source)
    found = io.apply_preset(parts, options.preset) if options.preset else parts
    return [found.complete("interpolate")]
