"""Diagnosis of a map: sensor health, split-half confidence, and the notes that follow from them.

All are computed from a map and its recording; none changes a position.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation.confidence import (
    DOUBTFUL,
    MIN_SENSORS,
    N_HALVES,
    agreement_of_halves,
    expected_mantel_r,
    map_agreement,
)
from anisomap.health import Finding, SensorHealth, assess, find_faults, spoiling, weaknesses
from anisomap.methods import DEFAULT_METHOD, METHODS, MethodOptions
from anisomap.reconstruction import reconstruct
from anisomap.recording import Recording
from anisomap.runs import as_runs, join_runs
from anisomap.sensor_map import SensorMap

logger = logging.getLogger(__name__)


def diagnose(
    sensor_map: SensorMap,
    recording: Recording | ArrayLike | Sequence[Recording],
    *,
    options: MethodOptions | None = None,
    drop: Iterable[str | int] = (),
    health: Sequence[SensorHealth] | None = None,
    findings: Sequence[Finding] | None = None,
    with_confidence: bool = True,
    progress: Callable[[float], None] | None = None,
) -> SensorMap:
    """Add sensor health, a confidence and the notes that follow from them to a map.

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
    with_confidence : bool
        Whether to compute `confidence`, which takes two to four times as long as the map.
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
    expected = math.nan
    if with_confidence:
        expected = confidence(sensor_map, runs, options=options, progress=progress)
    notes += _insufficient(expected)
    notes = [note for note in notes if note not in sensor_map.notes]
    for note in notes:
        warnings.warn(note, AnisomapWarning, stacklevel=2)
    return replace(
        sensor_map,
        health=tuple(sensor.status for sensor in assessed),
        confidence=expected,
        notes=(*sensor_map.notes, *notes),
    )


def confidence(
    sensor_map: SensorMap,
    recording: Recording | ArrayLike | Sequence[Recording],
    *,
    options: MethodOptions | None = None,
    progress: Callable[[float], None] | None = None,
) -> float:
    """Estimate the Mantel r between a map and the truth from maps of halves of the recording.

    Parameters
    ----------
    sensor_map, recording, options, progress
        See `diagnose`.

    Returns
    -------
    float
        Confidence of the largest component, in [0, 1]. NaN for methods without refinement,
        precomputed stages, maps of chunks and approximate maps, runs with different sensors, fewer
        than 12 sensors or 80 frames, and for uneven maps if the halves agree, since both share the
        same distortion.

    Raises
    ------
    InputError
        If a reading is missing.

    Notes
    -----
    Halves are mapped by the default method, for which the relation between agreement and Mantel r
    was calibrated: see `anisomap.evaluation.confidence.expected_mantel_r`. The agreement is that of
    the halves with each other or with the map, whichever is lower.
    """
    runs = as_runs(recording)
    method = METHODS.get(sensor_map.method)
    largest = sensor_map.component == 0
    if (
        method is None
        or method.refine is None
        or sensor_map.similarity not in (method.similarity, method.contact_similarity)
        or len(runs) > 1
        or np.count_nonzero(largest) < MIN_SENSORS
    ):
        return math.nan
    report = progress or (lambda _share: None)
    halves: list[NDArray[np.float64]] = []
    half_options = replace(options or MethodOptions(), split_unrelated=False)

    def map_half(half: NDArray[np.floating]) -> NDArray[np.float64]:
        made = reconstruct(half, DEFAULT_METHOD, sensor_map.dimensions, options=half_options)
        halves.append(made.positions)
        report(len(halves) / N_HALVES)
        return made.positions

    readings = runs[0].complete().readings[:, largest]
    logger.info("mapping halves of the recording to estimate the confidence")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # halves are short by design
        agreement = agreement_of_halves(readings, map_half)
    if halves:
        # The map itself must agree with the halves, or it is not the map of this recording.
        positions = sensor_map.positions[largest]
        with_map = float(np.mean([map_agreement(half, positions) for half in halves]))
        agreement = min(agreement, with_map)
    expected = expected_mantel_r(agreement)
    return math.nan if sensor_map.uneven and expected >= DOUBTFUL else expected


def _insufficient(expected: float) -> Iterator[str]:
    if expected < DOUBTFUL:
        yield (
            "insufficient evidence: maps of halves of the recording differ, and the expected "
            f"Mantel r is only {expected:.2f}; record longer, and touch all of the skin"
        )
