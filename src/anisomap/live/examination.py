"""The checked map of a live session: exactly the map of ``anisomap map``, with its verdict."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap import io
from anisomap.defaults import DEFAULT_METHOD
from anisomap.diagnosis.diagnostics import diagnose
from anisomap.dimensions import AUTO, Dimensions
from anisomap.errors import AnisomapError
from anisomap.evaluation import score
from anisomap.health import RecordingSummary, SensorHealth, assess, summarise
from anisomap.io.stream import ReadOptions
from anisomap.large.chunks import chunk_frames, complete_chunks
from anisomap.large.streaming import map_streamed_similarity, stream_similarity
from anisomap.options import MethodOptions
from anisomap.reconstruction import reconstruct_with_stages
from anisomap.recording import Recording
from anisomap.sensor_map import SensorMap
from anisomap.usability import Verdict

MAX_READINGS = 1 << 27
"""Readings of a final map above which they are read in blocks, as ``anisomap map`` does: 512 MiB
of float32."""

MAX_INTERIM_READINGS = 1 << 22
"""Readings of a checked map while the session runs; of more, evenly spread parts are used."""

_PARTS = 64  # of a long recording, evenly spread over it


@dataclass(frozen=True, eq=False)
class Examination:
    """A checked map.

    sensor_map: None if there is no map yet; see `reason`.
    summary: Of the frames that were mapped.
    error_against_truth: RMS error in spacings, if the truth is known; else NaN.
    n_frames: Number of frames of the recording when it was read.
    seconds: Time that the examination took.
    final: Whether all frames of the session are in the map.
    reason: Why there is no map; empty if there is one.
    """

    sensor_map: SensorMap | None
    health: tuple[SensorHealth, ...]
    summary: RecordingSummary | None
    verdict: Verdict
    error_against_truth: float
    n_frames: int
    seconds: float
    final: bool
    reason: str = ""


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


_Mapped: TypeAlias = tuple[SensorMap, tuple[SensorHealth, ...], RecordingSummary]


def examine(
    path: Path, n_frames: int, options: ExaminationOptions, *, final: bool = False
) -> Examination:
    """Map the recording of a session, and judge the map."""
    begun = time.monotonic()
    made: SensorMap | None = None
    health: tuple[SensorHealth, ...] = ()
    summary: RecordingSummary | None = None
    reason, error = "", float("nan")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            made, health, summary = _mapped(path, n_frames, options, final)
            if options.truth is not None:
                error = score(made, options.truth, permutations=0).rms_in_spacings
        except AnisomapError as problem:
            reason = str(problem)
    return Examination(
        sensor_map=made,
        health=health,
        summary=summary,
        verdict=Verdict(reasons=(reason,)) if made is None else made.verdict,
        error_against_truth=error,
        n_frames=n_frames,
        seconds=time.monotonic() - begun,
        final=final,
        reason=reason,
    )


def _mapped(path: Path, n_frames: int, options: ExaminationOptions, final: bool) -> _Mapped:
    with io.open_stream(path, frames=1) as stream:
        n_readings = n_frames * stream.n_sensors
    if final and n_readings > MAX_READINGS:
        return _mapped_in_blocks(path, options)
    if not final and n_readings > MAX_INTERIM_READINGS:
        recording = _parts_of(path, n_frames, options.preset)
    else:
        recording = io.read(path, options=ReadOptions(preset=options.preset))
    recording = recording.complete("interpolate")
    drop = [name for name in options.drop if name in recording.names]
    made, stages = reconstruct_with_stages(recording, options.method, options.dimensions, drop=drop)
    health = assess(recording)
    diagnosed = diagnose(made, recording, drop=drop, health=health, stages=stages)
    return diagnosed, health, summarise(recording, health)


def _mapped_in_blocks(path: Path, options: ExaminationOptions) -> _Mapped:
    with io.open_stream(path, frames=1) as stream:
        n_block = chunk_frames(stream.n_sensors)
        like = Recording(next(stream.blocks).readings, names=stream.names, source=stream.source)
    kept = np.arange(like.n_sensors)

    def chunks() -> Iterator[NDArray[Any]]:
        with io.open_stream(path, frames=n_block) as stream:
            for block in stream.blocks:
                yield block.readings[:, kept]

    if options.preset:
        probe = replace(like, readings=_extremes(chunks()))
        like = io.apply_preset(probe, options.preset)
        kept = np.array(list(io.numbering(probe, options.preset)))
    complete = complete_chunks(chunks, "interpolate")
    found = stream_similarity(complete, options.method, MethodOptions(), like=like)
    drop = [name for name in options.drop if name in like.names]
    made = map_streamed_similarity(found, options.method, options.dimensions, drop=drop)
    return made, found.health, summarise(found.excerpt, found.health)


def _extremes(blocks: Iterator[NDArray[Any]]) -> NDArray[Any]:
    """Return the first, the lowest and the highest reading of each channel, shape (3, N)."""
    found = np.empty((0, 0))
    for block in blocks:
        rows = np.concatenate([found, block]) if len(found) else block
        found = np.stack([rows[0], np.fmin.reduce(rows), np.fmax.reduce(rows)])
    return found


def _parts_of(path: Path, n_frames: int, preset: str) -> Recording:
    """Read evenly spread parts of a recording that together have `MAX_INTERIM_READINGS`."""
    with io.open_stream(path, frames=1) as stream:
        n_kept = MAX_INTERIM_READINGS // stream.n_sensors
    length = max(1, n_kept // _PARTS)
    stride = max(1, n_frames // length // _PARTS)
    with io.open_stream(path, frames=length) as stream:
        parts = [block.readings for i, block in enumerate(stream.blocks) if i % stride == 0]
        found = Recording(np.concatenate(parts), names=stream.names, source=stream.source)
    return io.apply_preset(found, preset) if preset else found
