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

from anisomap.base.defaults import DEFAULT_METHOD
from anisomap.errors import AnisomapWarning, InputError
from anisomap.health import Finding, SensorHealth, assess, find_faults, spoiling, weaknesses
from anisomap.method.named import METHODS
from anisomap.method.options import MethodOptions
from anisomap.method.pipeline import Stages
from anisomap.method.refinements import CURVE
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.recording import Recording, as_runs, join_runs
from anisomap.sensor_map import SensorMap
from anisomap.usability import Verdict
from anisomap.verdict.accuracy import (
    differences_from_steps,
    expected_error,
    regional_difference,
    rms_in_spacings,
    with_systematic_errors,
)
from anisomap.verdict.chance import (
    MAX_SENSORS,
    MIN_FRAMES,
    MIN_SENSORS,
    covariances,
    deviations_by_chance,
    error_in_spacings,
    made_again,
    part_of,
)
from anisomap.verdict.judge import Evidence, judge

logger = logging.getLogger(__name__)

FATAL = ("one-period",)
"""Faults after which similar readings do not mean that sensors are near."""

UNSEEN = ("copies", "changed", "separate-regions")
"""Faults that misplace sensors in all maps alike, so that the estimated error does not show them.

Of 2,100 maps in five tables of ``make trust``, 13 with copies were wrong although their estimate
was that of a usable map, and 1 of 66 with other faults or notes.
"""


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
        From `anisomap.method.reconstruction.reconstruct_with_stages`, if the map comes from it.
        Without them, the map is made again; the result is the same.

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
    verdict, found = Verdict(), None
    if with_verdict:
        evidence, found = examine(
            sensor_map,
            runs,
            options=options,
            rng=rng,
            progress=progress,
            stages=stages,
            faults=faults,
        )
        verdict = judge(evidence)
    notes = [note for note in notes if note not in sensor_map.notes]
    for note in notes:
        warnings.warn(note, AnisomapWarning, stacklevel=2)
    return replace(
        sensor_map,
        health=tuple(sensor.status for sensor in assessed),
        verdict=verdict,
        covariances=found,
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
    """Estimate the covariances of positions, and the errors that chance makes.

    Parameters
    ----------
    sensor_map, recording, options, rng, progress
        See `diagnose`.

    Returns
    -------
    covariances : ndarray of shape (N, k, k), or None
        See `SensorMap.covariances`; None if they cannot be known.
    repeatability : float
        RMS error of the positions of the largest component by chance, in spacings; NaN if it
        cannot be known.

    Raises
    ------
    InputError
        If a reading is missing.

    Notes
    -----
    Blocks of frames are resampled (`anisomap.numerics.reliability.sampling_noise`), and the method
    maps each resample from the covariogram fit of the map, in a few iterations and without the fit
    of contacts. If the map does not follow from that fit, because lengths were taken from the
    heights of contacts, halves of the recording are mapped from the beginning instead. Systematic
    errors are estimated from the differences from a map of evenly spaced sensors: see
    `anisomap.verdict.accuracy`.
    """
    evidence, found = examine(
        sensor_map, as_runs(recording), options=options, rng=rng, progress=progress
    )
    return found, evidence.repeatability


def examine(
    sensor_map: SensorMap,
    runs: Sequence[Recording],
    *,
    options: MethodOptions | None = None,
    rng: np.random.Generator | int | None = None,
    progress: Callable[[float], None] | None = None,
    stages: Stages | None = None,
    faults: Sequence[Finding] = (),
) -> tuple[Evidence, NDArray[np.float64] | None]:
    """Collect the evidence for the verdict on a map, and the covariances of its positions."""
    sizes = sensor_map.component_sizes
    evidence = Evidence(
        placed=int(np.count_nonzero(sensor_map.placed)),
        largest=sizes[0],
        faults=spoiling([one for one in faults if one.kind not in UNSEEN + FATAL]),
        unseen=(
            *spoiling([one for one in faults if one.kind in UNSEEN]),
            *(note for note in sensor_map.notes if note == CURVE),
        ),
        fatal=spoiling([one for one in faults if one.kind in FATAL]),
    )
    if unknown := _unknown(sensor_map, runs):
        return replace(evidence, unknown=unknown), None
    run, options = runs[0].complete(), options or MethodOptions()
    stages = made_again(sensor_map, run, options) if stages is None else stages
    report = progress or (lambda _share: None)
    generator = np.random.default_rng(0 if rng is None else rng)
    found = np.full((*sensor_map.positions.shape, sensor_map.dimensions), np.nan)
    logger.info("mapping resampled recordings to estimate the repeatability")
    for label, size in enumerate(sizes):
        if size < MIN_SENSORS:
            continue
        done, share = sum(sizes[:label]) / sum(sizes), size / sum(sizes)
        told = _part_of(report, done, share)
        if label == 0:
            evidence = replace(
                evidence, repeatability=math.inf, difference=math.inf, regional=math.inf
            )
        with limited_blas(1):  # products are those of short blocks of frames, or of few sensors
            try:
                part = part_of(sensor_map, label, run, options, stages)
                deviations = deviations_by_chance(part, sensor_map.method, options, generator, told)
            except InputError:  # no relation between sensors is left
                continue
            positions = part.positions
            differences = differences_from_steps(part.pairs, positions)
        chance = covariances(deviations, positions)
        repeatability = error_in_spacings(chance, positions)
        difference = rms_in_spacings(differences, positions)
        if label == 0:
            evidence = replace(
                evidence,
                repeatability=repeatability,
                difference=difference,
                regional=regional_difference(differences, positions),
            )
        error = expected_error(repeatability, difference).value
        if math.isfinite(error):
            members = sensor_map.component == label
            found[members] = with_systematic_errors(chance, differences, positions, error)
    return evidence, found


def _part_of(report: Callable[[float], None], done: float, share: float) -> Callable[[float], None]:
    return lambda part: report(done + part * share)


def _unknown(sensor_map: SensorMap, runs: Sequence[Recording]) -> str:
    """Return why the repeatability of a map cannot be known, and what to do; empty if it can."""
    method = METHODS.get(sensor_map.method)
    if method is None or sensor_map.similarity not in (
        method.similarity,
        method.contact_similarity,
    ):
        return "a verdict needs the readings that the map was made from"
    n_sensors, n_frames = np.count_nonzero(sensor_map.component == 0), runs[0].n_frames
    reasons = {
        f"maps by {sensor_map.method} have no verdict: use "
        f"{DEFAULT_METHOD}": not method.refinements,
        "the recordings have different sensors: map one of them": len(runs) > 1,
        f"only {n_sensors} sensors are related, and a verdict needs {MIN_SENSORS}: touch more of "
        "the skin": n_sensors < MIN_SENSORS,
        f"resampling more than {MAX_SENSORS:,} sensors takes too much memory: map parts of the "
        "skin": n_sensors > MAX_SENSORS,
        f"the recording has {n_frames} frames, and a verdict needs {MIN_FRAMES}: record "
        "longer": n_frames < MIN_FRAMES,
    }
    return next((reason for reason, holds in reasons.items() if holds), "")
