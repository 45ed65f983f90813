"""The route from files to a judged map: read, mend, complete, examine, map and judge.

Each function takes the result of the preceding one.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap import io
from anisomap.base.wording import as_text, printable
from anisomap.errors import AnisomapWarning, FileError, InputError
from anisomap.health import Finding, RecordingSummary, SensorHealth, assess, find_faults, summarise
from anisomap.method.dimensions import Dimensions
from anisomap.method.pipeline import Stages, reconstruct_with_stages
from anisomap.names import find_sensors
from anisomap.numerics.precision import check_pair_memory
from anisomap.recording import MissingPolicy, Recording, Scalar, join_runs
from anisomap.sensor_map import SensorMap
from anisomap.verdict.diagnosis import diagnose

MAX_READINGS = 1 << 27
"""Maximum number of readings; longer recordings are sampled. 512 MiB of float32."""

_LEAST_OBJECTS = 4  # many tables resemble smaller matrices
_ROUNDING = 1e-6  # of values printed with 7 digits, relative to the largest

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Examined:
    """A recording, with its sensor health, summary and faults.

    findings: Remaining faults.
    mended: Faults that were mended.
    drop: Sensors to leave out of the map.
    """

    recording: Recording
    health: Sequence[SensorHealth]
    summary: RecordingSummary
    findings: Sequence[Finding] = ()
    mended: Sequence[Finding] = ()
    drop: Sequence[str] = ()


def read(
    path: Path,
    how: io.ReadOptions | None = None,
    *,
    max_readings: float = math.inf,
    progress: Callable[[float], None] | None = None,
) -> Recording:
    """Read a recording; the default of its source is the file name."""
    logger.info("reading %s", printable(path.name))
    recording = io.read(path, options=how, max_readings=max_readings, progress=progress)
    _refuse_dissimilarities(path, recording.readings)
    return replace(recording, source=recording.source or as_text(path.name))


def _refuse_dissimilarities(path: Path, readings: NDArray[np.floating]) -> None:
    """Refuse a square matrix with mostly symmetric pairs, and zeros only on the diagonal."""
    n = len(readings)
    if n < _LEAST_OBJECTS or readings.shape != (n, n):
        return
    largest = np.abs(readings).max(where=np.isfinite(readings), initial=0)
    rounding = _ROUNDING * largest
    is_zero = np.abs(readings) <= rounding
    symmetric = np.abs(readings - readings.T) <= rounding
    if np.array_equal(is_zero, np.eye(n, dtype=bool)) and 2 * symmetric.sum() > n * n:
        raise FileError(
            f"{path} holds dissimilarities ({n} x {n}, symmetric, 0 on the diagonal), not a "
            f"recording; map them in Python: d = anisomap.read({str(path)!r}).readings; "
            'anisomap.Anisomap(metric="precomputed").fit_transform((d + d.T) / 2)'
        )


def read_runs(
    paths: Sequence[Path],
    how: io.ReadOptions,
    *,
    max_readings: float = MAX_READINGS,
    progress: Callable[[float], None] | None = None,
) -> list[Recording]:
    """Read one recording, or several of one skin.

    If all runs together exceed the maximum number of readings, frames are sampled evenly in time,
    with a warning. Runs are joined before a preset is applied, since a preset leaves out channels
    that are constant in all runs.
    """
    joined = len(paths) > 1 and bool(how.preset)
    each = replace(how, preset="", positions=None) if joined else how
    runs: list[Recording] = []
    for path in paths:
        runs.append(read(path, each, max_readings=max_readings, progress=progress))
        own = [io.sampled_every(run.metadata) for run in runs]
        every = max(own)
        n_all = sum(run.readings.size * k for run, k in zip(runs, own, strict=True))
        while n_all > every * max_readings:
            every *= 2
        runs = [io.thin(run, every // k) for run, k in zip(runs, own, strict=True)]
    io.check_no_frames(paths, runs, each)
    for note in _sampling_note(runs[0]):
        warnings.warn(note, AnisomapWarning, stacklevel=2)
    if not joined:
        return runs
    whole = io.apply_preset(join_runs(runs), how.preset)
    return [io.attach_positions(whole, how.positions)]


def _sampling_note(recording: Recording) -> tuple[str, ...]:
    every = io.sampled_every(recording.metadata)
    if every == 1:
        return ()
    return (
        f"one frame in {every} was used, evenly in time, since all readings together exceed the "
        "limit of memory",
    )


def complete(runs: Recording | Sequence[Recording], missing: MissingPolicy) -> Recording:
    """Handle missing readings, and join the runs; errors name the option for missing readings."""
    try:
        return join_runs(runs, missing)
    except InputError as error:
        if missing != "error":
            raise
        hint = "use --missing drop-frames or --missing interpolate"
        raise InputError(error.problem, hint) from error


def split_names(
    chosen: Sequence[str] | None, names: Sequence[str], metadata: Mapping[str, Scalar] | None = None
) -> list[str]:
    """Split a list of sensors at commas, unless a sensor name contains the comma.

    Columns that the reader left out, according to the metadata, are ignored.
    """
    left_out = ("text_columns", "other_columns")
    skipped = " ".join(str((metadata or {}).get(key, "")) for key in left_out)
    found = []
    for text in chosen or []:
        found += [text] if text in names else [part.strip() for part in text.split(",")]
    return [name for name in found if name in names or f"({name})" not in skipped]


def find_dropped(
    chosen: Sequence[str] | None, names: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the sensors of a list, split by `split_names`, and its parts that name no sensor.

    Both are empty if there are no names yet.
    """
    found, unknown = set[int](), []
    for text in split_names(chosen, names) if names else []:
        try:
            found.update(find_sensors(names, [text]).tolist())
        except InputError:
            unknown.append(text)
    return tuple(names[i] for i in sorted(found)), tuple(unknown)


def examine(
    recording: Recording,
    *,
    mended: Sequence[Finding] | None = None,
    drop: Sequence[str] | None = None,
) -> Examined:
    """Assess a recording; unless it was mended, search for its faults.

    mended: Faults, from `anisomap.repair`.
    drop: Sensors to leave out of the map: see `split_names`.
    """
    # Without this check, sensors whose pairs do not fit into memory would be compared for hours.
    check_pair_memory(recording.n_sensors, refined=False)
    joined = join_runs(recording)
    dropped = split_names(drop, joined.names, joined.metadata)
    joined.indices(dropped)  # refuse unknown names early
    health = assess(joined)
    found = find_faults(joined) if mended is None else [one for one in mended if not one.mendable]
    done = [one for one in mended or () if one.mendable]
    return Examined(joined, health, summarise(joined, health), found, done, dropped)


def make_map(examined: Examined, method: str, dimensions: Dimensions) -> tuple[SensorMap, Stages]:
    """Make a map, without a verdict, and the stages that `judge` needs; notes are warnings."""
    recording = examined.recording
    made, stages = reconstruct_with_stages(recording, method, dimensions, drop=examined.drop)
    provenance = dict(made.provenance)
    if note := _sampling_note(recording):
        provenance[io.FRAMES_SAMPLED] = io.sampled_every(recording.metadata)
    if examined.mended:
        kinds = dict.fromkeys(one.kind for one in examined.mended)
        provenance["repaired"] = ", ".join(kinds)
    made = replace(made, notes=(*note, *made.notes), provenance=provenance)
    return _diagnosed(examined, made, with_verdict=False), stages


def judge(
    examined: Examined, sensor_map: SensorMap, stages: Stages, *, seed: int = 0, **how: Any
) -> SensorMap:
    """Add a verdict to a map from `make_map`, by maps of resampled recordings. how: `diagnose`."""
    return _diagnosed(examined, sensor_map, stages=stages, rng=seed, **how)


def _diagnosed(examined: Examined, sensor_map: SensorMap, **how: object) -> SensorMap:
    return diagnose(
        sensor_map,
        examined.recording,
        drop=examined.drop,
        health=examined.health,
        findings=examined.findings,
        **how,  # type: ignore[arg-type]
    )
