"""Update of a map by a new recording, in the frame of the map and with its corrections."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree
from scipy.special import ndtr, ndtri

from anisomap.base.immutable import Immutable
from anisomap.base.wording import join_items
from anisomap.errors import AnisomapWarning, InputError
from anisomap.evaluation.difference import MIN_COMPARED, Difference
from anisomap.evaluation.mantel_r import mantel
from anisomap.evaluation.scoring import median_spacing
from anisomap.health import assess
from anisomap.numerics.neighbours import Kernel, labels_by_size, padded, predict_field
from anisomap.numerics.procrustes import Similarity, fit_similarity, fit_similarity_robustly
from anisomap.numerics.reliability.split_half import profile_agreement
from anisomap.recording import Recording, as_runs, join_runs, match_names
from anisomap.sensor_map import UNASSESSED, UNPLACED, SensorMap
from anisomap.tracking.evidence import Evidence, gather_evidence, map_evidence

FAR = 3.0
"""Smallest distance of a move that is looked for, in spacings; nearer profiles are alike."""

# From median absolute deviations to standard deviations of a normal distribution.
_TO_SIGMA = 1 / float(ndtri(0.75))

# The corrections of an old map, such as those by a mesh, are taken to change over a few spacings.
_REACH, _NOISE = 3.0, 0.1
_NEIGHBOURS = 4  # of which a new sensor takes the largest error
_EXPLAINED = 0.5  # share of the variance of a map that its own evidence must explain


@dataclass(frozen=True, eq=False)
class Moves(Immutable):
    """Sensors that moved.

    Attributes
    ----------
    names : tuple of str
        The compared sensors.
    p_values : ndarray of shape (n,)
        Probability that chance alone makes any sensor fit a far place so much better (Bonferroni);
        1 for sensors that fit their own place better than any far one.
    like : tuple of str
        The far sensor of the map that each fits best.
    moved : tuple of str
        Sensors with a p value below the level.
    """

    names: tuple[str, ...]
    p_values: NDArray[np.float64]
    like: tuple[str, ...]
    moved: tuple[str, ...]


def find_moves(
    sensor_map: SensorMap, evidence: Evidence, fresh: Evidence, level: float
) -> Moves | None:
    """Find sensors of which the similarity to all others is that of a far sensor before.

    For each sensor, the agreement of its new profile with its own old one is compared with the
    best agreement with the profile of a far sensor. A sensor moved if the far one fits better, by
    more than chance explains: differences of sensors that did not move are taken as normal, with
    the median and the median absolute deviation of all.
    """
    compared = set(evidence.names) & set(fresh.names)
    placed = np.flatnonzero(sensor_map.placed)
    placed = placed[[sensor_map.names[i] in compared for i in placed]]
    if len(placed) < MIN_COMPARED:
        return None
    names = tuple(sensor_map.names[i] for i in placed)
    key = common_similarity(evidence, fresh)
    old_similarity, old_known = similarity_of(evidence, key, names)
    new_similarity, new_known = similarity_of(fresh, key, names)
    agreement = profile_agreement(new_similarity, old_similarity, new_known, old_known)
    places, component = sensor_map.positions[placed], sensor_map.component[placed]
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    far = (apart > FAR * spacing_of(sensor_map)) | (component[:, None] != component)
    if not far.any():
        return None
    elsewhere = np.where(far, agreement, -np.inf)
    gain = elsewhere.max(axis=1) - np.diag(agreement)
    finite = gain[np.isfinite(gain)]
    middle = float(np.median(finite))
    sigma = _TO_SIGMA * float(np.median(np.abs(finite - middle)))
    z = (gain - middle) / max(sigma, np.finfo(float).tiny)
    p_values = np.where(gain > 0, np.minimum(1.0, len(names) * ndtr(-z)), 1.0)
    return Moves(
        names=names,
        p_values=p_values,
        like=tuple(names[j] for j in elsewhere.argmax(axis=1)),
        moved=tuple(name for name, p in zip(names, p_values, strict=True) if p < level),
    )


def spacing_of(sensor_map: SensorMap) -> float:
    """Return the median distance between neighbours on the largest component, 0 of one sensor."""
    places = sensor_map.positions[sensor_map.component == 0]
    return median_spacing(places) if len(places) > 1 else 0.0


def common_similarity(first: Evidence, second: Evidence) -> str:
    """Return the most specific similarity of which both have sums."""
    return next(key for key in reversed(tuple(first.sums)) if key in second.sums)


def similarity_of(
    evidence: Evidence, key: str, names: Sequence[str]
) -> tuple[NDArray[np.floating], NDArray[np.bool_]]:
    """Return the similarity of n sensors, and which pairs of them are known, (n, n) each."""
    rows = match_names(names, evidence.names)
    inside = np.ix_(rows, rows)
    pairs = evidence.sums[key].statistics(key)
    return pairs.similarity[inside], pairs.known[inside]


@dataclass(frozen=True, eq=False)
class _Frame:
    """From a component of the map of new evidence to the frame of an old map.

    shared: Mask of the sensors of the component from which the frame is known.
    label: Their component on the old map.
    to_before: From the map of all evidence to that of the old evidence.
    to_old: From the map of the old evidence to the old map.
    base, field (n, k): Places of these sensors by `to_old`, and the corrections that the old map
        has there.
    """

    shared: NDArray[np.bool_]
    label: int
    to_before: Similarity
    to_old: Similarity
    base: NDArray[np.float64]
    field: NDArray[np.float64]

    def carry(
        self, points: NDArray[np.float64], spacing: float
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Transform points of the map of all evidence, (m, l): without and with corrections.

        Also the RMS errors of these, (m,).
        """
        carried = self.to_old.apply(padded(self.to_before.apply(points), self.base.shape[1]))
        kernel = Kernel(_REACH * spacing, _NOISE)
        found, variance = predict_field(self.base, self.field, carried, kernel)
        size = float(np.sqrt(np.mean(np.sum(self.field**2, axis=1))))
        return carried, carried + found, size * np.sqrt(variance)


def carry_over(
    old: SensorMap,
    before: SensorMap,
    after: SensorMap,
    moved: Sequence[str],
    extra: Sequence[str] = (),
) -> SensorMap:
    """Bring a map of new evidence into the frame of an old map."""
    names = tuple(dict.fromkeys((*old.names, *after.names, *extra)))
    grown = _grown(old, names)
    positions, component = np.array(grown.positions), np.array(grown.component)
    errors = np.array(grown.errors)
    normals = None if grown.normals is None else np.array(grown.normals)
    # Positions that were measured are worth more than any map.
    measured = (grown.errors == 0) & old.anchored
    for label in range(len(after.component_sizes)):
        members = np.flatnonzero(after.component == label)
        frame = _frame(old, before, after, members, moved)
        if frame is None:
            continue
        rows = match_names([after.names[i] for i in members], names)
        carried, corrected, doubt = frame.carry(after.positions[members], spacing_of(old))
        new, known, appended = ~frame.shared, rows[frame.shared], rows[~frame.shared]
        change = carried[frame.shared] - frame.base
        positions[known] += np.where(measured[known, None], 0, change)
        positions[appended], component[appended] = corrected[new], frame.label
        nearest = range(1, 1 + min(_NEIGHBOURS, len(known)))
        near = KDTree(frame.base).query(carried[new], k=nearest)[1]
        errors[appended] = np.hypot(old.errors[known[near]].max(axis=1), doubt[new])
        if normals is not None:
            normals[appended] = np.nan
    placed = component != UNPLACED
    component[placed] = labels_by_size(component[placed])
    return replace(
        grown,
        positions=positions,
        component=component,
        errors=errors,
        normals=normals,
        stress=after.stress,
        n_iterations=after.n_iterations,
        verdict=after.verdict,
        uneven=old.uneven or after.uneven,
        notes=tuple(dict.fromkeys((*old.notes, *after.notes))),
    )


def _grown(old: SensorMap, names: tuple[str, ...]) -> SensorMap:
    """Append sensors without a position to a map."""
    more = len(names) - old.n_sensors

    def padded_rows(values: NDArray[Any], fill: float = np.nan) -> NDArray[Any]:
        return np.pad(values, ((0, more), (0, 0))[: values.ndim], constant_values=fill)

    return replace(
        old,
        names=names,
        positions=padded_rows(old.positions),
        component=padded_rows(old.component, UNPLACED),
        health=(*old.health, *(UNASSESSED,) * more),
        errors=padded_rows(old.errors),
        covariances=None,  # those of the old recordings alone
        normals=None if old.normals is None else padded_rows(old.normals),
    )


def _frame(
    old: SensorMap,
    before: SensorMap,
    after: SensorMap,
    members: NDArray[np.intp],
    moved: Sequence[str],
) -> _Frame | None:
    """Find the frame of a component of the map of all evidence; None if it shares too little."""
    names = [after.names[i] for i in members]
    there, then = match_names(names, old.names), match_names(names, before.names)
    labels = np.stack([old.component[there], before.component[then]])
    shared = (np.minimum(there, then) >= 0) & (labels != UNPLACED).all(axis=0)
    shared &= ~np.isin(names, moved)
    if not shared.any():
        return None
    groups, group, counts = np.unique(
        labels[:, shared], axis=1, return_inverse=True, return_counts=True
    )
    largest = int(counts.argmax())
    label = int(groups[0, largest])
    shared[shared] = group.ravel() == largest
    new, there, then = members[shared], there[shared], then[shared]
    if len(new) <= after.dimensions:
        return None
    fit = fit_similarity_robustly if len(new) >= MIN_COMPARED else fit_similarity
    to_before = fit(after.positions[new], before.positions[then])
    dimensions = old.dimensions
    source, target = padded(before.positions[then], dimensions), old.positions[there]
    to_old = fit_similarity(source, target)
    base = to_old.apply(source)
    field = target - base
    if np.sum(field**2) > (1 - _EXPLAINED) * np.sum((target - target.mean(axis=0)) ** 2):
        raise InputError(
            "the statistics belong to a map of another shape; give the file that was written with "
            "this map"
        )
    return _Frame(shared, label, to_before, to_old, base, field)


UPDATE_LEVEL = 0.001
"""Probability that chance alone marks any sensor as moved.

It is a tenth of that of a single comparison, since a map is updated many times, and the old
evidence of a sensor that moved is discarded.
"""

_CONTRADICTION = 0.01  # p value above which a recording contradicts a map
_PERMUTATIONS = 199  # the smallest p value, 1 / 200, is below the level of 1 %
_MAX_PERMUTED = 1000  # sensors; a permutation of more takes long, and so many decide the test


@dataclass(frozen=True, eq=False)
class Update(Immutable):
    """A map to which the evidence of a new recording was added, and what changed.

    Attributes
    ----------
    map : SensorMap
        In the frame, the units and the handedness of the old map: its sensors in their order, then
        the new ones.
    evidence : Evidence
        Of all recordings.
    added : tuple of str
        Sensors that are placed now and were not before.
    moved : tuple of str
        Sensors that the recording shows at another place than the map, farther than chance
        explains: they were wired or mounted elsewhere, and their old evidence was discarded.
    silent : tuple of str
        Placed sensors of the old map that the recording lacks, or that do not vary in it. Their
        evidence is kept.
    unplaced : tuple of str
        Sensors of the recording that could not be placed.
    agreement : float
        Correlation of the old and the new similarity, over pairs of sensors that did not move; NaN
        with fewer than 2 pairs.
    difference : Difference
        The old map and the updated one, in one frame. `Difference.moved` and its p values are those
        of `moves`, and `Difference.chance` is the smallest distance of a move that is looked for;
        `Difference.distance` is that between the two places of a sensor.
    moves : Moves or None
        The test of the places of the sensors; None if too few could be compared.
    notes : tuple of str
        What could not be examined, and conflicts.
    """

    map: SensorMap
    evidence: Evidence
    added: tuple[str, ...]
    moved: tuple[str, ...]
    silent: tuple[str, ...]
    unplaced: tuple[str, ...]
    agreement: float
    difference: Difference
    moves: Moves | None
    notes: tuple[str, ...]

    @property
    def found(self) -> bool:
        """Whether a sensor was added, or moved."""
        return bool(self.added or self.moved)


def update_map(
    sensor_map: SensorMap,
    evidence: Evidence,
    recording: Recording | ArrayLike | Sequence[Recording],
    *,
    drop: Iterable[str | int] = (),
    level: float = UPDATE_LEVEL,
) -> Update:
    """Add the evidence of a new recording to a map.

    Sensors that the recording shows elsewhere than the map are found first (`Moves`); what was
    known of them is discarded. The other evidence is pooled, mapped, and brought into the frame of
    the old map, which keeps what anchors, modules and a mesh corrected.

    Parameters
    ----------
    sensor_map : SensorMap
        The old map, placed or not.
    evidence : Evidence
        Of the recordings of the old map: see `gather_evidence`.
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        New and complete readings of the skin. Sensors are matched by name; it may lack some, and
        have new ones.
    drop : iterable of str or int
        Sensors of the recording to ignore.
    level : float
        Probability that chance alone marks any sensor as moved.

    Returns
    -------
    Update

    Raises
    ------
    InputError
        If the recording shares too few sensors with the map, says nothing, is part of the evidence
        already, or contradicts the map as a whole; if the evidence is not that of the map; or if
        the level is out of range.

    Warns
    -----
    AnisomapWarning
        Once for each note.
    """
    if not 0 < level < 1:
        raise InputError(f"the level must be between 0 and 1, got {level:g}")
    sensor_map.check_coordinates("on the map")
    if not spacing_of(sensor_map) > 0:
        raise InputError("the map must have two sensors at distinct positions at least")
    evidence = replace(evidence, dimensions=sensor_map.dimensions)
    runs = as_runs(recording)
    joined = join_runs(runs)
    fresh = gather_evidence(
        recording, evidence.method, evidence.dimensions, options=evidence.options, drop=drop
    )
    _check_shared(sensor_map, evidence, fresh)
    # Warnings are notes of the result.
    with warnings.catch_warnings(action="ignore", category=AnisomapWarning):
        moves = find_moves(sensor_map, evidence, fresh, level)
        moved = () if moves is None else moves.moved
        _check_agreement(sensor_map, fresh, moved)
        total = evidence.without(moved).merged(fresh)
        before, after = map_evidence(evidence), map_evidence(total)
    extra = _others(joined.names, (*sensor_map.names, *after.names))
    placed = carry_over(sensor_map, before, after, moved, extra)
    healthy = {sensor.name: sensor.status for sensor in assess(runs)}
    notes = tuple(_notes(moves))
    for note in notes:
        warnings.warn(note, AnisomapWarning, stacklevel=2)
    placed = replace(
        placed,
        health=tuple(
            healthy.get(name, status)
            for name, status in zip(placed.names, placed.health, strict=True)
        ),
        provenance={
            **sensor_map.provenance,
            "frames": total.n_frames,
            "recordings": len(total.recordings),
        },
        notes=tuple(dict.fromkeys((*placed.notes, *notes))),
    )
    once, now = (
        [name for name, known in zip(one.names, one.placed, strict=True) if known]
        for one in (sensor_map, placed)
    )
    added = _others(now, once)
    return Update(
        map=placed,
        evidence=total,
        added=added,
        moved=moved,
        silent=_others(once, fresh.names),
        unplaced=_others(joined.names, now),
        agreement=_agreement(evidence, fresh, moved),
        difference=_as_difference(sensor_map, placed, moves, added),
        moves=moves,
        notes=notes,
    )


def _others(names: Iterable[str], known: Iterable[str]) -> tuple[str, ...]:
    """Return the names that are not among known ones."""
    left_out = set(known)
    return tuple(name for name in names if name not in left_out)


def _notes(moves: Moves | None) -> Iterator[str]:
    """Yield what an update could not examine, and the sensors that moved."""
    if moves is None:
        yield (
            "too few sensors of the map are in the recording to tell whether one moved: "
            f"at least {MIN_COMPARED} are needed that are not all close together"
        )
    elif moves.moved:
        yield (
            f"{len(moves.moved)} sensors moved since the map was made, and are placed by the new "
            f"recording alone: {join_items(moves.moved)}"
        )


def _check_shared(sensor_map: SensorMap, evidence: Evidence, fresh: Evidence) -> None:
    placed = {sensor_map.names[i] for i in np.flatnonzero(sensor_map.placed)}
    known = placed & set(evidence.names)
    if len(known) <= sensor_map.dimensions:
        raise InputError(
            f"the statistics belong to another map: they share {len(known)} placed sensors with "
            "this one; give the file that was written with this map"
        )
    shared = known & set(fresh.names)
    if len(shared) <= evidence.dimensions:
        raise InputError(
            f"the recording shares {len(shared)} varying sensors with the map, and an update "
            f"needs at least {evidence.dimensions + 1}; sensors are matched by name"
        )


def _check_agreement(sensor_map: SensorMap, fresh: Evidence, moved: tuple[str, ...]) -> None:
    """Check that sensors that are near on the map are similar in the recording.

    A Mantel test of the distances on the largest component; permutations of the sensors are the
    null hypothesis.
    """
    compared = set(fresh.names) - set(moved)
    shared = [
        i
        for i, name in enumerate(sensor_map.names)
        if sensor_map.component[i] == 0 and name in compared
    ][:_MAX_PERMUTED]
    if len(shared) < MIN_COMPARED:
        return
    similarity, known = similarity_of(
        fresh, fresh.similarity, [sensor_map.names[i] for i in shared]
    )
    apart = np.where(known, 1.0 - similarity, 1.0)
    np.fill_diagonal(apart, 0.0)
    places = sensor_map.positions[shared]
    near = np.linalg.norm(places[:, None] - places, axis=2)
    try:
        found = mantel(near, apart, permutations=_PERMUTATIONS)
    except InputError as error:  # all distances are equal
        raise InputError(
            f"the recording holds no evidence about the sensors of the map: {error}"
        ) from None
    if found.p_value > _CONTRADICTION:
        raise InputError(
            "the recording contradicts the map: sensors that are near on the map are no more "
            f"similar than others (p = {found.p_value:.2g}); check that the names of the sensors "
            "are those of the map"
        )


def _as_difference(
    before: SensorMap, after: SensorMap, moves: Moves | None, added: Sequence[str]
) -> Difference:
    """Describe what an update changed as a comparison of two maps in one frame."""
    names = after.names
    old = _grown(before, names).positions
    distance = np.linalg.norm(after.positions - old, axis=1)
    listed = {} if moves is None else dict(zip(moves.names, moves.p_values.tolist(), strict=True))
    p_values = np.array([listed.get(name, np.nan) for name in names])
    return Difference(
        names=names,
        before=old,
        after=after.positions,
        distance=distance,
        p_values=p_values,
        moved=np.isin(names, () if moves is None else moves.moved),
        appeared=np.isin(names, added),
        lost=np.zeros(len(names), dtype=bool),
        compared=np.isfinite(distance),
        chance=FAR * spacing_of(before),
        spacing=spacing_of(before),
        scale=1.0,
        reflected=False,
        units=after.units,
        notes=(),
    )


def _agreement(old: Evidence, fresh: Evidence, moved: tuple[str, ...]) -> float:
    """Correlate the old and the new similarity, by the statistic that both have."""
    shared = set(fresh.names).difference(moved)
    names = [name for name in old.names if name in shared]
    key = common_similarity(old, fresh)
    (before, known), (after, known_after) = (similarity_of(e, key, names) for e in (old, fresh))
    both = np.triu(known & known_after, 1)
    first, second = before[both], after[both]
    if first.size < 2 or np.ptp(first) == 0 or np.ptp(second) == 0:
        return math.nan
    return float(np.corrcoef(first, second)[0, 1])
