"""Diagnosis of a map: sensor health, split-half confidence, and the notes that follow from them.

All of it is computed beside the map, from the map and its recording, and never changes positions.
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
)
from anisomap.health import SensorHealth, assess, weaknesses
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
    with_confidence: bool = True,
    progress: Callable[[float], None] | None = None,
) -> SensorMap:
    """Add sensor health, a confidence and the notes that follow from them to a map.

    Parameters
    ----------
    sensor_map : SensorMap
        From `anisomap.reconstruct`.
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        Of the same sensors, as given to `anisomap.reconstruct`.
    options : MethodOptions, optional
        As given to `anisomap.reconstruct`.
    drop : iterable of str or int
        Sensors that were dropped; their faults are not noted.
    health : sequence of SensorHealth, optional
        From `anisomap.assess`, if computed already.
    with_confidence : bool
        Whether to compute `confidence`, which takes two to four times as long as the map.
    progress : callable, optional
        Called with the share done, from 0 to 1.

    Returns
    -------
    SensorMap
        The same positions.

    Raises
    ------
    InputError
        If the recording is not of the sensors of the map.

    Warns
    -----
    AnisomapWarning
        Once for each note that is added.
    """
    runs = as_runs(recording)
    skin = join_runs(runs)
    if skin.names != sensor_map.names:
        raise InputError(
            f"the recording ({skin.n_sensors} sensors, {skin.names[0]} ...) is not of the sensors "
            f"of the map ({sensor_map.n_sensors} sensors, {sensor_map.names[0]} ...)"
        )
    assessed = assess(runs) if health is None else tuple(health)
    dropped = set(skin.indices(drop).tolist())
    kept = [sensor for i, sensor in enumerate(assessed) if i not in dropped]
    notes = list(weaknesses(skin, kept))
    expected = math.nan
    if with_confidence:
        expected = confidence(sensor_map, runs, options=options, progress=progress)
    notes += _insufficient(expected)
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
    """Estimate the Mantel r of a map with the truth from maps of halves of the recording.

    Parameters
    ----------
    sensor_map, recording, options, progress
        See `diagnose`.

    Returns
    -------
    float
        For the largest component; in [0, 1]. NaN if it is unknown: for methods that do not refine
        their maps, for precomputed stages, runs that lack sensors, fewer than 12 sensors or 80
        frames, and for uneven maps whose halves agree, since both share the same distortion.

    Notes
    -----
    Halves are mapped by the default method, for which the relation between agreement and Mantel r
    was calibrated: see `anisomap.evaluation.confidence.expected_mantel_r`.
    """
    runs = as_runs(recording)
    method = METHODS.get(sensor_map.method)
    largest = sensor_map.component == 0
    if (
        method is None
        or method.refine is None
        or sensor_map.approximate
        or len(runs) > 1
        or np.count_nonzero(largest) < MIN_SENSORS
    ):
        return math.nan
    tell = progress or (lambda _share: None)
    n_done = 0
    whole = replace(options or MethodOptions(), split_unrelated=False)

    def place(half: NDArray[np.floating]) -> NDArray[np.float64]:
        nonlocal n_done
        made = reconstruct(half, DEFAULT_METHOD, sensor_map.dimensions, options=whole)
        n_done += 1
        tell(n_done / N_HALVES)
        return made.positions

    logger.info("mapping halves of the recording to estimate the confidence")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # halves are short by design
        agreement = agreement_of_halves(runs[0].readings[:, largest], place)
    expected = expected_mantel_r(agreement)
    return math.nan if sensor_map.uneven and expected >= DOUBTFUL else expected


def _insufficient(expected: float) -> Iterator[str]:
    if expected < DOUBTFUL:
        yield (
            "insufficient evidence: maps of halves of the recording differ, and the expected "
            f"Mantel r is only {expected:.2f}; record longer, and touch all of the skin"
        )
