"""Diagnosis of a map: sensor health, the verdict, and resulting notes.

All are computed from a map and its recording; positions are not changed.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.base import DEFAULT_METHOD
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation.scoring import align
from anisomap.health import Finding, SensorHealth, assess, find_faults, spoiling, weaknesses
from anisomap.health.recording_faults.stimulation import one_period
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.map_verdict import CONTACTS, Verdict
from anisomap.method.configuration import Configuration
from anisomap.method.dimensions import AUTO, SPATIAL
from anisomap.method.evidence import Evidence, log_stage
from anisomap.method.named import METHODS, MethodOptions
from anisomap.method.pipeline import Stages, reconstruct_with_stages
from anisomap.notes import Note, untouched
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.recording import Recording, join_runs
from anisomap.sensor_map import SensorMap
from anisomap.verdict.chance import (
    MAX_SENSORS,
    MIN_FRAMES,
    MIN_SENSORS,
    Part,
    covariances,
    deviations_by_chance,
    error_in_spacings,
    extent_in_spacings,
    regional_difference,
    rms_in_spacings,
    with_systematic_errors,
)
from anisomap.verdict.judge import Measurements, judge
from anisomap.verdict.second_map import (
    agreement_of_halves,
    differences_from_second_map,
    sensors_pair_off,
    spacing_varies,
)

_SAME = 1e-6  # of the extent; far above rounding errors of a scaled or rotated map

UNCLEAR = Note("unclear-dimensions")

FATAL = ("changed",)
"""Faults with which similar readings do not indicate that sensors are near."""

UNSEEN = ("copies", "separate-regions")
"""Faults that misplace sensors equally in all maps, so that estimated errors do not include them.

Of 2,100 maps in five tables of benchmark `trust`, 13 with copies were wrong in spite of an estimate
for a usable map; of 66 with other faults or notes, 1 was.
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
    contacts: str = "",
    uneven: bool = False,
    rng: np.random.Generator | int | None = None,
    progress: Callable[[float], None] | None = None,
    stages: Stages | None = None,
) -> SensorMap:
    """Add sensor health, a verdict and resulting notes to a map.

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
        From `anisomap.assess`, if already computed.
    findings : sequence of Finding, optional
        From `anisomap.find_faults`, if already computed.
    with_verdict : bool
        Whether to judge the map and estimate the covariance of every position, by maps of resampled
        recordings and a second map.
    contacts : str
        Shape of all contacts: ``"compact"``, as of a fingertip, a palm or a ball, or
        ``"elongated"``, as of an edge or a roller; taken from the metadata of the recording by
        default. Unless contacts are compact, a map of unevenly spaced sensors is usable for
        neighbours at best, because its compression by long contacts cannot be detected.
    uneven : bool
        Whether sensors are known to be unevenly spaced on the skin. Otherwise, a map with unevenly
        spaced sensors is usable for neighbours at best, because it may be folded.
    rng : numpy.random.Generator or int, optional
        Draws the resamples; seed 0 by default.
    progress : callable, optional
        Called with the completed share, from 0 to 1.
    stages : Stages, optional
        From `anisomap.method.pipeline.reconstruct_with_stages`, if the map comes from it.
        Without stages, the map is made again, with the same result.

    Returns
    -------
    SensorMap
        A copy with the same positions.

    Raises
    ------
    InputError
        If the sensors of recording and map differ, or `contacts` is unknown.

    Warns
    -----
    AnisomapWarning
        Once for each note that is added.
    """
    joined = join_runs(recording)
    if joined.names != sensor_map.names:
        raise InputError(
            f"recording and map must have the same sensors, got {joined.n_sensors} from "
            f"{joined.names[0]!r} on and {sensor_map.n_sensors} from {sensor_map.names[0]!r} on"
        )
    assessed = assess(joined) if health is None else tuple(health)
    unused = joined.varying() & ~sensor_map.placed  # sensors that were dropped from the map
    dropped = {*joined.indices(drop).tolist(), *np.flatnonzero(unused).tolist()}
    kept = [sensor for i, sensor in enumerate(assessed) if i not in dropped]
    faults = find_faults(joined) if findings is None else findings
    notes = [*weaknesses(joined, kept), *spoiling(faults)]
    verdict, found = Verdict(), None
    earlier, facts = sensor_map.notes, dict(sensor_map.provenance)
    if with_verdict:
        if stated := _stated(contacts, joined):
            facts["contacts"] = stated
        measured, found = examine(
            sensor_map,
            joined.complete(),
            options=options,
            rng=rng,
            progress=progress,
            stages=stages,
            faults=faults,
            contacts=stated,
        )
        facts |= {"uneven": True} if uneven else {}
        verdict = judge(replace(measured, known_uneven=uneven))
        if not joined.touched:
            verdict = replace(verdict, reasons=tuple(map(untouched, verdict.reasons)))
        if measured.confirmed:
            facts["dimensions_because"] = str(Note("three-dimensions"))
            earlier = tuple(note for note in earlier if note != UNCLEAR)
    notes = [note for note in notes if note not in earlier]
    for note in notes:
        warnings.warn(note, AnisomapWarning, stacklevel=2)
    return replace(
        sensor_map,
        health=tuple(sensor.status for sensor in assessed),
        verdict=verdict,
        covariances=found,
        notes=(*earlier, *notes),
        provenance={**facts, "verdict": verdict.summary},
    )


def examine(
    sensor_map: SensorMap,
    recording: Recording,
    *,
    options: MethodOptions | None = None,
    rng: np.random.Generator | int | None = None,
    progress: Callable[[float], None] | None = None,
    stages: Stages | None = None,
    faults: Sequence[Finding] = (),
    contacts: str = "",
) -> tuple[Measurements, NDArray[np.float64] | None]:
    """Measure the errors of a map as far as possible, and the covariances of its positions."""
    sizes = sensor_map.component_sizes
    measured = Measurements(
        placed=int(np.count_nonzero(sensor_map.placed)),
        rarely=_rarely_touched(sensor_map, recording),
        largest=sizes[0],
        contacts=contacts,
        spatial=sensor_map.dimensions == SPATIAL,
        unclear=UNCLEAR in sensor_map.notes,
        chosen="chosen_dimensions" in sensor_map.provenance,
        faults=spoiling([one for one in faults if one.kind not in UNSEEN + FATAL]),
        unseen=spoiling([one for one in faults if one.kind in UNSEEN]),
        fatal=(*_of_one_period(recording), *spoiling([one for one in faults if one.kind in FATAL])),
    )
    options, report = options or MethodOptions(), progress or (lambda _share: None)
    judged = _judged(sensor_map, recording, options, stages)
    if isinstance(judged, Note):
        return replace(measured, unknown=judged), None
    made, stages = judged
    generator = np.random.default_rng(0 if rng is None else rng)
    found = np.full((*sensor_map.positions.shape, sensor_map.dimensions), np.nan)
    log_stage("mapping resampled recordings to estimate the repeatability", sizes[0])
    sizes = made.component_sizes
    for label, size in enumerate(sizes):
        part = Part.of(stages, label)
        if size < MIN_SENSORS or part is None:
            continue
        done, share = sum(sizes[:label]) / sum(sizes), size / sum(sizes)
        positions = made.positions[made.component == label]
        recipe, told = METHODS[sensor_map.method], _part_of(report, done, share)
        with limited_blas(1):  # products are of short blocks of frames, or of few sensors
            deviations = deviations_by_chance(
                part, positions, recipe, options, rng=generator, progress=told
            )
            uneven, crowded = spacing_varies(positions)
            differences = differences_from_second_map(part.evidence, positions, uneven=uneven)
        chance = covariances(deviations, positions)
        by_metric = align(part.scaled, positions).aligned - positions
        one = replace(
            measured,
            repeatability=error_in_spacings(chance, positions),
            difference=rms_in_spacings(differences, positions),
            metric=rms_in_spacings(by_metric, positions),
            uneven=uneven,
        )
        if label == 0:
            groups = np.bincount(stages.evidence.groups.linked[stages.configuration.component == 0])
            measured = replace(
                one,
                linked=int(groups.max()),
                regional=regional_difference(differences, positions),
                crowded=crowded and measured.spatial,
                extent=extent_in_spacings(positions),
                paired=sensors_pair_off(part.evidence.similarity),
                agreement=agreement_of_halves(part.evidence, generator),
            )
            if stages.other is not None:
                apart, regions = _between_dimensions(stages.configuration, stages.other)
                gain = _gain_of_third(part.evidence, stages.configuration, stages.other)
                measured = replace(measured, between=apart, regions_between=regions, gain=gain)
        if math.isfinite(error := one.error.value):
            members = sensor_map.indices(np.array(made.names)[made.component == label].tolist())
            found[members] = with_systematic_errors(chance, differences, positions, error)
    return measured, found


def _stated(contacts: str, recording: Recording) -> str:
    """Return the stated shape of contacts, or the shape in the metadata."""
    if contacts and contacts not in CONTACTS:
        raise InputError(f"contacts must be {' or '.join(CONTACTS)}, got {contacts!r}")
    told = str(recording.metadata.get("contacts", ""))
    return contacts or (told if told in CONTACTS else "")


def _between_dimensions(made: Configuration, other: Configuration) -> tuple[float, float]:
    """Compare the maps in 2 and in 3 dimensions, as a whole and in regions, in spacings.

    Sensors in the largest components of both maps are compared.
    """
    both = (made.component == 0) & (other.component == 0)
    flat, spatial = sorted((made.positions[both], other.positions[both]), key=lambda x: x.shape[1])
    differences = align(flat, spatial).aligned - spatial
    return rms_in_spacings(differences, spatial), regional_difference(differences, spatial)


def _gain_of_third(evidence: Evidence, *made: Configuration) -> float:
    """Return the gain by a third dimension relative to the gain of n coordinates from noise."""
    flat, spatial = (one.largest for one in sorted(made, key=lambda one: one.positions.shape[1]))
    if flat is None or spatial is None:
        return 0.0
    similarity, n_sensors = np.asarray(evidence.similarity), len(evidence.similarity)
    spread = float(similarity[np.triu_indices(n_sensors, 1)].var())
    by_chance = 2 * evidence.noise / ((n_sensors - 1) * spread)
    return (flat.unexplained - spatial.unexplained) / by_chance


def _of_one_period(recording: Recording) -> tuple[Note, ...]:
    """Return a note if the readings of a part are almost entirely one sine."""
    found = map(one_period, recording.parts)
    return tuple(Note("one-period", share=one[0], period=one[1]) for one in found if one)[:1]


def _rarely_touched(sensor_map: SensorMap, recording: Recording) -> int:
    """Count the placed sensors with few contacts in each part; 0 if sensors are not touched."""
    if not recording.touched:
        return 0
    most = dict.fromkeys(sensor_map.names, 0)
    for part in recording.parts:
        for name, count in zip(part.names, part.signals.contacts.tolist(), strict=True):
            most[name] = max(most.get(name, 0), count)
    placed = np.flatnonzero(sensor_map.placed)
    return sum(most[sensor_map.names[i]] < MIN_CONTACTS for i in placed.tolist())


def _judged(
    sensor_map: SensorMap, recording: Recording, options: MethodOptions, stages: Stages | None
) -> tuple[SensorMap, Stages] | Note:
    """Return the map to measure and its stages, or the reason why there is none.

    It is the given map, apart from scale and pose. If parts of the recording lack sensors, it is a
    map of the sensors in all parts.
    """
    common = set(sensor_map.names).intersection(*(part.names for part in recording.parts))
    kept = [name for name in sensor_map.names if name in common]
    made = (
        sensor_map
        if len(kept) == sensor_map.n_sensors
        else sensor_map.select(sensor_map.indices(kept))
    )
    if note := _unknown(made, recording.n_frames, whole=made is sensor_map):
        return note
    if made is sensor_map and stages is not None and _follows(made, stages):
        return made, stages
    unplaced = [made.names[i] for i in np.flatnonzero(~made.placed)]
    chosen = made is sensor_map and "chosen_dimensions" in made.provenance
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", AnisomapWarning)  # repeated in the notes of the map
        try:
            again, stages = reconstruct_with_stages(
                recording.select(recording.indices(kept)),
                made.method,
                AUTO if chosen else made.dimensions,
                options=options,
                drop=unplaced,
            )
        except InputError:
            return Note("other-readings")
    if made is not sensor_map:
        return again, stages
    return (made, stages) if _follows(made, stages) else Note("other-readings")


def _follows(sensor_map: SensorMap, stages: Stages) -> bool:
    """Return whether a map has the positions of given stages, apart from scale and pose."""
    found, placed = stages.configuration, sensor_map.component[sensor_map.placed]
    if not np.array_equal(found.component, placed):
        return False
    largest = placed == 0
    given = sensor_map.positions[sensor_map.placed][largest]
    apart = align(found.positions[largest], given).rms
    return bool(apart <= _SAME * float(np.linalg.norm(given.std(axis=0))))


def _unknown(sensor_map: SensorMap, n_frames: int, *, whole: bool) -> Note | None:
    """Return a note on why the errors of a map cannot be estimated; None if they can."""
    method = METHODS.get(sensor_map.method)
    if method is None or sensor_map.similarity not in (
        method.similarity,
        method.contact_similarity,
    ):
        return Note("other-readings")
    n_sensors = int(np.count_nonzero(sensor_map.component == 0))
    reasons = (
        (
            method.refine is None,
            Note("no-verdict", method=sensor_map.method, default=DEFAULT_METHOD),
        ),
        (
            n_sensors < MIN_SENSORS,
            Note("few-sensors", count=n_sensors, least=MIN_SENSORS)
            if whole
            else Note("no-common-sensors", least=MIN_SENSORS),
        ),
        (sensor_map.dimensions > SPATIAL, Note("many-dimensions", most=SPATIAL)),
        (n_sensors > MAX_SENSORS, Note("many-sensors", most=MAX_SENSORS)),
        (n_frames < MIN_FRAMES, Note("few-frames", count=n_frames, least=MIN_FRAMES)),
    )
    return next((note for holds, note in reasons if holds), None)


def _part_of(report: Callable[[float], None], done: float, share: float) -> Callable[[float], None]:
    return lambda part: report(done + part * share)
