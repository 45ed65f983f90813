"""Diagnosis of a map: sensor health, the verdict, and the notes that follow from them.

All are computed from a map and its recording; none changes a position.
"""

from __future__ import annotations

import itertools
import logging
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.health import Finding, SensorHealth, assess, find_faults, spoiling, weaknesses
from anisomap.methods import DEFAULT_METHOD, METHODS, MethodOptions
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.reconstruction import reconstruct
from anisomap.recording import Recording
from anisomap.runs import as_runs, join_runs
from anisomap.sensor_map import SensorMap
from anisomap.stages.pairs import compare
from anisomap.usability import Verdict
from anisomap.verdict import Evidence, judge
from anisomap.verdict.doubts import extent_in_spacings, systematic_doubts
from anisomap.verdict.halves import MIN_FRAMES, MIN_SENSORS, N_HALVES, repeatability_of_halves

logger = logging.getLogger(__name__)


def diagnose(
    sensor_map: SensorMap,
    recording: Recording | ArrayLike | Sequence[Recording],
    *,
    options: MethodOptions | None = None,
    drop: Iterable[str | int] = (),
    health: Sequence[SensorHealth] | None = None,
    findings: Sequence[Finding] | None = None,
    with_verdict: bool = True,
    progress: Callable[[float], None] | None = None,
) -> SensorMap:
    """Add sensor health, a verdict and the notes that follow from them to a map.

    Parameters
    ----------
    sensor_map : SensorMap
        From `anisomap.reconstruct`.
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        The recording that was mapped, as given to `anisomap.reconstruct`.
    options : MethodOptions, optional
        As given to `anisomap.reconstruct`.
    drop : iterable of str or int
        Sensors that were left out of the map, by name or index; their faults are not noted.
    health : sequence of SensorHealth, optional
        From `anisomap.assess`, if computed already.
    findings : sequence of Finding, optional
        From `anisomap.find_faults`, if computed already.
    with_verdict : bool
        Whether to judge the map by maps of halves of the recording, which takes two to four times
        as long as the map.
    progress : callable, optional
        Called with the completed share, from 0 to 1.

    Returns
    -------
    SensorMap
        A copy with the same positions.

    Raises
    ------
    InputError
        If the sensors of the recording are not those of the map.

    Warns
    -----
    AnisomapWarning
        Once for each note that is added.
    """
    runs = as_runs(recording)
    joined = join_runs(runs)
    if joined.names != sensor_map.names:
        raise InputError(
            f"the recording must have the sensors of the map, {sensor_map.n_sensors} sensors from "
            f"{sensor_map.names[0]!r} on, got {joined.n_sensors} from {joined.names[0]!r} on"
        )
    assessed = assess(runs) if health is None else tuple(health)
    unused = joined.varying() & ~sensor_map.placed  # sensors that were dropped from the map
    dropped = {*joined.indices(drop).tolist(), *np.flatnonzero(unused).tolist()}
    kept = [sensor for i, sensor in enumerate(assessed) if i not in dropped]
    faults = find_faults(runs) if findings is None else findings
    notes = [*weaknesses(joined, kept), *spoiling(faults)]
    verdict = Verdict()
    if with_verdict:
        verdict = judge(
            collect_evidence(sensor_map, runs, faults, options=options, progress=progress)
        )
    notes += [reason for reason in verdict.reasons if reason.startswith("insufficient evidence")]
    notes = [note for note in notes if note not in sensor_map.notes]
    for note in notes:
        warnings.warn(note, AnisomapWarning, stacklevel=2)
    return replace(
        sensor_map,
        health=tuple(sensor.status for sensor in assessed),
        verdict=verdict,
        notes=(*sensor_map.notes, *notes),
        provenance={**sensor_map.provenance, "verdict": verdict.summary},
    )


def collect_evidence(
    sensor_map: SensorMap,
    recording: Recording | ArrayLike | Sequence[Recording],
    faults: Sequence[Finding] = (),
    *,
    options: MethodOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> Evidence:
    """Collect the evidence for the verdict on a map, of its largest component.

    Parameters
    ----------
    sensor_map, recording, options, progress
        See `diagnose`.
    faults : sequence of Finding
        Faults of the recording, from `anisomap.health.find_faults`.

    Returns
    -------
    Evidence
        See `anisomap.verdict.judge`.
    """
    runs = as_runs(recording)
    if unknown := _unknown(sensor_map, runs):
        return Evidence(doubts=systematic_doubts(sensor_map, faults), unknown=unknown)
    largest = sensor_map.component == 0
    positions = sensor_map.positions[largest]
    part = runs[0].complete().select(largest)
    statistic = sensor_map.similarity
    repeatability = _repeatability(sensor_map, runs[0], options, progress)
    with limited_blas(part.n_sensors):
        pairs = compare([part], statistic, bins=(options or MethodOptions()).bins, with_noise=False)
        doubts = systematic_doubts(
            sensor_map,
            faults,
            readings=part.readings,
            similarity=pairs.similarity,
            blended=statistic == "blended-correlation",
            repeatability=repeatability,
        )
    return Evidence(
        repeatability=repeatability,
        extent=extent_in_spacings(positions),
        dimensions=sensor_map.dimensions,
        doubts=doubts,
    )


def _unknown(sensor_map: SensorMap, runs: Sequence[Recording]) -> str:
    """Return why the repeatability of a map cannot be known; empty if it can."""
    method = METHODS.get(sensor_map.method)
    if method is None or sensor_map.similarity not in (
        method.similarity,
        method.contact_similarity,
    ):
        return "the map does not follow from the readings of one recording in memory"
    if method.refine is None:
        return f"maps by {sensor_map.method} are not judged, only refined ones"
    if len(runs) > 1:
        return "the recordings have different sensors"
    if np.count_nonzero(sensor_map.component == 0) < MIN_SENSORS:
        return f"fewer than {MIN_SENSORS} sensors are related"
    if runs[0].n_frames < MIN_FRAMES:
        return f"the recording has fewer than {MIN_FRAMES} frames"
    return ""


def _repeatability(
    sensor_map: SensorMap,
    recording: Recording,
    options: MethodOptions | None,
    progress: Callable[[float], None] | None,
) -> float:
    report = progress or (lambda _share: None)
    half_options = replace(options or MethodOptions(), split_unrelated=False)
    n_made = itertools.count(1)

    def map_half(half: NDArray[np.floating]) -> NDArray[np.float64]:
        made = reconstruct(half, DEFAULT_METHOD, sensor_map.dimensions, options=half_options)
        report(next(n_made) / N_HALVES)
        return made.positions

    largest = sensor_map.component == 0
    readings = recording.complete().readings[:, largest]
    logger.info("mapping halves of the recording to estimate the repeatability")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # halves are short by design
        return repeatability_of_halves(readings, sensor_map.positions[largest], map_half)
