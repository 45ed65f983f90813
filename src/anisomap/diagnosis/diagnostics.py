"""Diagnosis of a map: sensor health, the verdict, and the notes that follow from them.

All are computed from a map and its recording; none changes a position.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.diagnosis import Evidence, judge
from anisomap.diagnosis.doubts import extent_in_spacings, systematic_doubts
from anisomap.diagnosis.parts import MIN_FRAMES, MIN_SENSORS, MapParts
from anisomap.diagnosis.resampling import (
    MAX_SENSORS,
    STEP,
    covariances,
    departure_in_spacings,
    error_in_spacings,
    resampled_maps,
)
from anisomap.errors import AnisomapWarning, InputError
from anisomap.health import Finding, SensorHealth, assess, find_faults, spoiling, weaknesses
from anisomap.mapping import Stages
from anisomap.methods import METHODS
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.options import MethodOptions
from anisomap.recording import Recording, as_runs, join_runs
from anisomap.sensor_map import SensorMap
from anisomap.usability import Verdict

logger = logging.getLogger(__name__)

_SAME_MAP = 0.5
"""Largest departure of a map from that of the covariogram fit, in spacings, for which resamples of
the latter show its errors. At most .2 where the fit was the last step or was averaged with paths,
at least 1 where lengths were taken from heights (12 simulated skins, seeds 201 to 212)."""


def diagnose(
    sensor_map: SensorMap,
    recording: Recording | ArrayLike | Sequence[Recording],
    *,
    options: MethodOptions | None = None,
    drop: Iterable[str | int] = (),
    health: Sequence[SensorHealth] | None = None,
    findings: Sequence[Finding] | None = None,
    with_verdict: bool = True,
    rng: np.random.Generator | int | None = None,
    progress: Callable[[float], None] | None = None,
    stages: Stages | None = None,
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
        Whether to judge the map, and to estimate the covariance of every position, by maps of
        resampled recordings and of halves.
    rng : numpy.random.Generator or int, optional
        Draws the resamples; seed 0 by default.
    progress : callable, optional
        Called with the completed share, from 0 to 1.
    stages : Stages, optional
        From `anisomap.reconstruction.reconstruct_with_stages`, if the map comes from it. Without
        them, the map is made again; the result is the same.

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
    verdict, found, uneven = Verdict(), None, sensor_map.uneven
    if with_verdict:
        parts = _parts(sensor_map, runs, options, stages)
        found, repeatability = _uncertainty(sensor_map, parts, options, rng, progress)
        evidence = _evidence(sensor_map, parts, faults, repeatability)
        uneven |= any(doubt.kind == "distortion" for doubt in evidence.doubts)
        verdict = judge(evidence)
    notes += [reason for reason in verdict.reasons if reason.startswith("insufficient evidence")]
    notes = [note for note in notes if note not in sensor_map.notes]
    for note in notes:
        warnings.warn(note, AnisomapWarning, stacklevel=2)
    return replace(
        sensor_map,
        health=tuple(sensor.status for sensor in assessed),
        verdict=verdict,
        covariances=found,
        uneven=uneven,
        notes=(*sensor_map.notes, *notes),
        provenance={**sensor_map.provenance, "verdict": verdict.summary},
    )


def estimate_uncertainty(
    sensor_map: SensorMap,
    recording: Recording | ArrayLike | Sequence[Recording],
    *,
    options: MethodOptions | None = None,
    rng: np.random.Generator | int | None = None,
    progress: Callable[[float], None] | None = None,
) -> tuple[NDArray[np.float64] | None, float]:
    """Estimate the errors that chance makes, by maps of resampled recordings.

    Parameters
    ----------
    sensor_map, recording, options, rng, progress
        See `diagnose`.

    Returns
    -------
    covariances : ndarray of shape (N, k, k), or None
        See `SensorMap.covariances`; None if they cannot be known.
    repeatability : float
        RMS error of the positions of the largest component, in spacings; NaN if it cannot be
        known.

    Raises
    ------
    InputError
        If a reading is missing.

    Notes
    -----
    Blocks of frames are resampled (`anisomap.numerics.reliability.sampling_noise`), and each
    resample is mapped by a few iterations of the covariogram fit, starting from the map. If the
    map departs from that fit, because lengths were taken from the heights of contacts, halves of
    the recording are mapped from the beginning, and the covariances are scaled to their
    difference.
    """
    parts = _parts(sensor_map, as_runs(recording), options)
    return _uncertainty(sensor_map, parts, options, rng, progress)


def _uncertainty(
    sensor_map: SensorMap,
    parts: MapParts | str,
    options: MethodOptions | None,
    rng: np.random.Generator | int | None,
    progress: Callable[[float], None] | None,
) -> tuple[NDArray[np.float64] | None, float]:
    """See `estimate_uncertainty`."""
    if isinstance(parts, str):
        return None, math.nan
    report = progress or (lambda _share: None)
    generator = np.random.default_rng(0 if rng is None else rng)
    found = np.full((*sensor_map.positions.shape, sensor_map.dimensions), np.nan)
    repeatability = math.nan
    sizes = sensor_map.component_sizes
    logger.info("mapping resampled recordings to estimate the repeatability")
    for label, size in enumerate(sizes):
        if size < MIN_SENSORS:
            continue
        members = sensor_map.component == label
        positions = sensor_map.positions[members]
        done, share = sum(sizes[:label]) / sum(sizes), size / sum(sizes)
        try:
            part = parts[label]
            reference, maps = resampled_maps(
                part.pairs,
                positions,
                sensor_map.method,
                part.refined,
                options=options,
                rng=generator,
                progress=_part_of(report, done, share),
            )
        except InputError:  # no relation between sensors is left
            repeatability = math.inf if label == 0 else repeatability
            continue
        component = covariances(maps, positions, STEP)
        error = error_in_spacings(component, positions)
        if departure_in_spacings(reference, positions) > _SAME_MAP:
            by_halves = parts.error_of_halves(label)
            component *= (by_halves / error) ** 2 if 0 < error < math.inf else math.nan
            error = by_halves
        found[members] = np.where(np.isfinite(component), component, np.nan)
        repeatability = error if label == 0 else repeatability
    return found, repeatability


def _part_of(report: Callable[[float], None], done: float, share: float) -> Callable[[float], None]:
    return lambda part: report(done + part * share)


def collect_evidence(
    sensor_map: SensorMap,
    recording: Recording | ArrayLike | Sequence[Recording],
    faults: Sequence[Finding] = (),
    *,
    options: MethodOptions | None = None,
    repeatability: float | None = None,
    stages: Stages | None = None,
) -> Evidence:
    """Collect the evidence for the verdict on a map, of its largest component."""
    parts = _parts(sensor_map, as_runs(recording), options, stages)
    if repeatability is None:
        repeatability = _uncertainty(sensor_map, parts, options, None, None)[1]
    return _evidence(sensor_map, parts, faults, repeatability)


def _evidence(
    sensor_map: SensorMap, parts: MapParts | str, faults: Sequence[Finding], repeatability: float
) -> Evidence:
    """See `collect_evidence`."""
    if isinstance(parts, str):
        return Evidence(doubts=systematic_doubts(sensor_map, faults), unknown=parts)
    part = parts[0]
    positions = part.positions
    # Resamples start from the map, so they cannot show that the fit may end in another one.
    halves = parts.error_of_halves(0)
    with limited_blas(len(positions)):
        doubts = systematic_doubts(
            sensor_map,
            faults,
            readings=part.readings,
            similarity=part.pairs.similarity,
            changes=part.pairs.changes,
            correlation=part.pairs.correlation,
            repeatability=repeatability,
            halves=halves,
        )
    return Evidence(
        repeatability=repeatability,
        extent=extent_in_spacings(positions),
        dimensions=sensor_map.dimensions,
        doubts=doubts,
    )


def _parts(
    sensor_map: SensorMap,
    runs: Sequence[Recording],
    options: MethodOptions | None,
    stages: Stages | None = None,
) -> MapParts | str:
    """Return the components of a map, or why its repeatability cannot be known."""
    if unknown := _unknown(sensor_map, runs):
        return unknown
    return MapParts(sensor_map, runs[0].complete(), options or MethodOptions(), stages)


def _unknown(sensor_map: SensorMap, runs: Sequence[Recording]) -> str:
    """Return why the repeatability of a map cannot be known; empty if it can."""
    method = METHODS.get(sensor_map.method)
    if method is None or sensor_map.similarity not in (
        method.similarity,
        method.contact_similarity,
    ):
        return "the map does not follow from the readings of one recording in memory"
    n_sensors = np.count_nonzero(sensor_map.component == 0)
    reasons = {
        f"{sensor_map.method} does not refine maps, and has no verdicts": not method.refinements,
        "the recordings have different sensors": len(runs) > 1,
        f"fewer than {MIN_SENSORS} sensors are related": n_sensors < MIN_SENSORS,
        f"resampling more than {MAX_SENSORS} sensors takes too much memory": n_sensors
        > MAX_SENSORS,
        f"the recording has fewer than {MIN_FRAMES} frames": runs[0].n_frames < MIN_FRAMES,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")
