"""The route from files to a judged map: recordings are read, assessed and mapped."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeAlias

from anisomap import io
from anisomap.base.wording import as_text
from anisomap.errors import AnisomapWarning, InputError
from anisomap.health import (
    Finding,
    RecordingSummary,
    SensorHealth,
    assess,
    find_faults,
    repair,
    summarise,
)
from anisomap.method.dimensions import Dimensions
from anisomap.method.options import MethodOptions
from anisomap.method.pipeline import reconstruct_with_stages
from anisomap.numerics.precision import check_pair_memory
from anisomap.recording import MissingPolicy, Recording, Scalar, as_runs, join_runs
from anisomap.sensor_map import SensorMap
from anisomap.verdict.diagnosis import diagnose

MAX_READINGS = 1 << 27
"""Readings above which a recording is sampled: 512 MiB of float32."""

Judge: TypeAlias = Callable[..., SensorMap]
"""A function that adds its verdict to a map."""

Progress: TypeAlias = Callable[[str], AbstractContextManager[Callable[[float], None]]]
"""Shows that a task runs; gives a function of the share that is done."""


def silent(_: str) -> AbstractContextManager[Callable[[float], None]]:
    """Show no progress."""
    return nullcontext(lambda _: None)


@dataclass(frozen=True)
class Examined:
    """Recordings of one skin, with their sensor health, summary and faults.

    recording: All runs as one.
    """

    runs: Sequence[Recording]
    recording: Recording
    health: Sequence[SensorHealth]
    summary: RecordingSummary
    findings: Sequence[Finding] = ()


def read(
    path: Path,
    how: io.ReadOptions | None = None,
    *,
    max_readings: float = math.inf,
    progress: Progress = silent,
) -> Recording:
    """Read a recording; the default of its source is the file name."""
    with progress(f"reading {path.name}") as report_progress:
        recording = io.read(path, options=how, max_readings=max_readings, progress=report_progress)
    return replace(recording, source=recording.source or as_text(path.name))


def read_runs(
    paths: Sequence[Path],
    how: io.ReadOptions,
    missing: MissingPolicy = "error",
    *,
    max_readings: float = MAX_READINGS,
    progress: Progress = silent,
) -> list[Recording]:
    """Read one recording, or several of one skin, without missing readings.

    If all together have more readings than allowed, frames are sampled evenly in time. A preset
    leaves out channels that are constant in all runs, so it is applied to the joined runs.
    """
    joined = len(paths) > 1 and bool(how.preset)
    each = replace(how, preset="", positions=None) if joined else how
    sampled = _read_sampled(paths, each, max_readings, progress)
    runs = [_complete(run, missing) for run in sampled]
    if not joined:
        return runs
    every = {key: value for key, value in runs[0].metadata.items() if key == io.FRAMES_SAMPLED}
    whole = join_runs(runs)
    whole = replace(whole, metadata={**whole.metadata, **every})
    return [io.attach_positions(io.apply_preset(whole, how.preset), how.positions)]


def read_mended(
    paths: Sequence[Path],
    how: io.ReadOptions,
    missing: MissingPolicy | None = None,
    *,
    max_readings: float = math.inf,
    progress: Progress = silent,
) -> tuple[list[Recording], tuple[Finding, ...]]:
    """Read recordings of one skin, and mend their faults; None leaves readings missing."""
    runs = _read_sampled(paths, how, max_readings, progress)
    with progress("repairing the recording"):
        mended = [repair(run) for run in as_runs(runs)]
    findings = tuple(finding for one in mended for finding in one.findings)
    found = [one.recording for one in mended]
    return found if missing is None else [_complete(one, missing) for one in found], findings


def _read_sampled(
    paths: Sequence[Path], how: io.ReadOptions, max_readings: float, progress: Progress
) -> list[Recording]:
    """Read every k-th frame of recordings, so that all together fit, and warn if k is not 1."""
    runs: list[Recording] = []
    for path in paths:
        runs.append(read(path, how, max_readings=max_readings, progress=progress))
        own = [io.sampled_every(run.metadata) for run in runs]
        every = max(own)
        n_all = sum(run.readings.size * k for run, k in zip(runs, own, strict=True))
        while n_all > every * max_readings:
            every *= 2
        runs = [io.thin(run, every // k) for run, k in zip(runs, own, strict=True)]
    io.check_no_frames(paths, runs, how)
    for note in _sampling_note(runs):
        warnings.warn(note, AnisomapWarning, stacklevel=3)
    return runs


def _sampling_note(runs: Sequence[Recording]) -> tuple[str, ...]:
    every = io.sampled_every(runs[0].metadata)
    if every == 1:
        return ()
    return (
        f"one frame in {every} was used, evenly in time, since all readings together exceed the "
        "limit of memory",
    )


def _complete(recording: Recording, missing: MissingPolicy) -> Recording:
    """Handle missing readings; an error names the option that does."""
    try:
        return recording.complete(missing)
    except InputError as error:
        if missing != "error":
            raise
        hint = "use --missing drop-frames or --missing interpolate"
        raise InputError(f"{str(error).partition(';')[0]}; {hint}") from error


def split_names(
    chosen: Sequence[str] | None, names: Sequence[str], metadata: Mapping[str, Scalar] | None = None
) -> list[str]:
    """Split a list of sensors at commas, unless a sensor name contains the comma.

    Columns that the reader has left out, according to the metadata, are ignored.
    """
    left_out = ("text_columns", "other_columns")
    skipped = " ".join(str((metadata or {}).get(key, "")) for key in left_out)
    found = []
    for text in chosen or []:
        found += [text] if text in names else [part.strip() for part in text.split(",")]
    return [name for name in found if name in names or f"({name})" not in skipped]


def examine(
    runs: Sequence[Recording],
    findings: Sequence[Finding] | None = None,
    *,
    progress: Progress = silent,
) -> Examined:
    """Assess recordings of one skin; by default, their faults are searched for."""
    # Comparing all pairs of so many sensors that no map fits into memory takes hours.
    check_pair_memory(max(run.n_sensors for run in runs), refined=False)
    with progress("assessing sensors"):
        joined, health = join_runs(runs), assess(runs)
        found = find_faults(runs) if findings is None else findings
        return Examined(runs, joined, health, summarise(joined, health), found)


def make_map(
    examined: Examined,
    method: str,
    dimensions: Dimensions,
    *,
    options: MethodOptions | None = None,
    drop: Sequence[str] = (),
    seed: int = 0,
    progress: Progress = silent,
) -> tuple[SensorMap, Judge]:
    """Make a map, and what judges it; notes are warnings."""
    runs = examined.runs
    with progress("making the map"):
        made, stages = reconstruct_with_stages(runs, method, dimensions, options=options, drop=drop)
        if note := _sampling_note(runs):
            every = io.sampled_every(runs[0].metadata)
            provenance = {**made.provenance, io.FRAMES_SAMPLED: every}
            made = replace(made, notes=(*note, *made.notes), provenance=provenance)
        diagnosed = partial(
            diagnose,
            recording=runs,
            options=options,
            drop=drop,
            health=examined.health,
            findings=examined.findings,
            rng=seed,
            stages=stages,
        )
        return diagnosed(made, with_verdict=False), diagnosed
