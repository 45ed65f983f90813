"""Check of stated positions against the readings of a recording."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from anisomap.base.wording import join_items
from anisomap.errors import InputError
from anisomap.evaluation.scoring import check_distances
from anisomap.health.recording_faults.copies import copied_groups
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.layout.evidence import REACH, Evidence, Move, neighbour_spacing
from anisomap.layout.explanation import explain, explain_modules, motion, span
from anisomap.layout.findings import (
    CONSISTENT,
    CONTRADICTING,
    DEAD,
    KINDS,
    NOT_CONSISTENT,
    NOT_TESTED,
    OK,
    REJECTED,
    UNKNOWN,
    LayoutCheck,
    LayoutFinding,
    ModuleChange,
    at_positions,
)
from anisomap.layout.judging import Judge, agreement, own_agreement
from anisomap.layout.module_changes import Change
from anisomap.layout.modules import Mounting, find_modules, orientation
from anisomap.layout.readings import N_SHIFTS, ReadingStatistics, reading_statistics
from anisomap.layout.search import Search
from anisomap.layout.together import AGREEING, bonds, unsure_patches
from anisomap.layout.whole import ScanOrder, agreement_as_a_whole, best_rival, own_images
from anisomap.names import match_names, match_sensors
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.neighbours import linked_labels
from anisomap.placement.modules import Modules
from anisomap.recording import Recording, join_runs
from anisomap.sensor_map import SensorMap

logger = logging.getLogger(__name__)

MIN_SENSORS = 4
"""Minimum number of sensors that can be tested."""

_LEAST_SENSITIVE = 0.05  # quantile of contacts of sensors relative to their neighbours
_MAX_NAMED = 8
_MAX_P = 0.01  # of a layout that explains the readings better than shuffled layouts
_HALF_WRONG = 0.25  # share of the agreement if half of the sensors are shuffled
_MANY_WRONG = 0.5  # the same for three tenths; correct layouts of real skins have 0.76 and more
_MIN_TESTED = 0.5  # share of the sensors of a finding, or of all, that must be tested
_PATCH_CONTACTS = 10  # of the median tested sensor; with 6 to 8, correct patches gain by moving
_PAIRED = 0.2  # share of sensors that repeat others if contacts occur in pairs
_HARDLY_TOLD = (2, 3)  # spacings: readings of nearer sensors may be equal
_SAME = 0.01  # spacings; differences of places by rounding


def check_layout(
    layout: SensorMap | ArrayLike,
    recording: Recording | ArrayLike | Sequence[Recording],
    *,
    modules: Modules | int | None = None,
    n_shifts: int = N_SHIFTS,
    statistics: ReadingStatistics | None = None,
    rng: np.random.Generator | int | None = None,
) -> LayoutCheck:
    """Find the sensors that do not fit their stated positions.

    Parameters
    ----------
    layout : SensorMap or array_like of shape (N, 2) or (N, 3)
        Stated positions. A map is matched with the recording by sensor names, else by numbers in
        the names, or by order if one side has no names, with a note.
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        At least 40 frames, without missing readings (see `Recording.complete`).
    modules : Modules or int, optional
        Modules of the layout, or the number of channels of each. By default, repeated shapes are
        modules: see `anisomap.layout.find_modules`. A template is fitted to all modules; without
        a template, only modules of one shape are used.
    n_shifts : int
        Number of circular shifts of the null distribution; at least 1.
    statistics : ReadingStatistics, optional
        Statistics of all sensors of the recording, from `anisomap.layout.reading_statistics`, to
        check several layouts against one recording. By default, computed with `n_shifts` shifts.
    rng : numpy.random.Generator or int, optional
        Draws the circular shifts. 0 by default.

    Returns
    -------
    LayoutCheck

    Raises
    ------
    InputError
        If sensors cannot be matched, positions are not in 2 or 3 dimensions or coincide, readings
        are missing, fewer than 4 sensors can be tested, or there is no shift.

    Notes
    -----
    First, the layout is compared with shuffled layouts. It is rejected as a whole if it explains
    the readings no better, or if at least half of the sensors seem to be at wrong places.

    The evidence is the decrease of the similarity of two sensors with their distance on the layout.
    A change of places must increase the log-likelihood of all similarities beyond its standard
    error, and the mean similarity of sensors to their neighbours. Small displacements are not
    found, because sensors closer than 2 to 3 spacings may have similar readings. Sensors are not
    tested if they have fewer than 5 contacts, or are related to others no more than after a shift.
    """
    if n_shifts < 1:
        raise InputError(f"n_shifts must be at least 1, got {n_shifts}")
    stated = layout if isinstance(layout, SensorMap) else _as_layout(layout)
    joined = replace(join_runs(recording), starts=()).complete()  # all sensors in all frames
    if stated.dimensions not in (2, 3):
        raise InputError(f"a layout must have 2 or 3 coordinates, got {stated.dimensions}")
    rows, columns, notes = _matched(stated, joined)
    positions = stated.positions[rows]
    check_distances(positions, "the layout")
    found = find_modules(stated, modules)
    if not neighbour_spacing(positions) > 0:
        raise InputError("most sensors of the layout have the same position; there is no distance")
    generator = np.random.default_rng(0 if rng is None else rng)
    logger.info("comparing readings with positions")
    with limited_blas(len(rows)):
        known = statistics or reading_statistics(joined.readings, generator, n_shifts=n_shifts)
        part = joined.select(columns)
        return _Checked(
            stated,
            rows,
            joined.signals.contacts[columns],
            constant=~joined.varying()[columns],
            copies=[one.sensors for one in copied_groups(part)],
            modules=found,
            statistics=known.select(columns),
            rng=generator,
            notes=notes,
        ).result()


@dataclass(eq=False)
class _Checked:
    """The steps of a check; sensors are numbered as matched columns.

    rows: Rows of the sensors in the layout.
    contacts: Number of contacts of each sensor.
    constant: Whether each sensor is constant.
    copies: Groups of sensors that read the same wire.
    """

    layout: SensorMap
    rows: NDArray[np.intp]
    contacts: NDArray[np.intp]
    constant: NDArray[np.bool_]
    copies: Sequence[Sequence[int]]
    modules: Modules
    statistics: ReadingStatistics
    rng: np.random.Generator
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        self.positions = self.layout.positions[self.rows]
        self.names = [self.layout.names[i] for i in self.rows]
        inside = self.modules.select(self.rows)
        self.mounting = Mounting.of(inside, self.positions, self.layout.units)
        n = self.mounting.n_modules
        self.unbent = self.mounting.arranged(self.positions, np.arange(n), np.zeros(n, int))
        self.spacing = neighbour_spacing(self.unbent)
        self.usable = self.statistics.tested & (self.contacts >= MIN_CONTACTS)
        self.findings: list[LayoutFinding] = []
        near: Any = KDTree(self.unbent).query_ball_point(self.unbent, REACH * self.spacing)
        self.neighbours = [[j for j in found if j != i] for i, found in enumerate(near)]

    def result(self) -> LayoutCheck:
        """Perform all steps."""
        self._find_dead()
        paired = self._find_doubled()
        n_usable = int(np.count_nonzero(self.usable))
        if n_usable < MIN_SENSORS:
            raise InputError(
                f"{n_usable} of {len(self.rows)} sensors are related to other sensors beyond "
                f"chance, but a check needs {MIN_SENSORS}; record more contacts"
            )
        similarity = self.statistics.similarity
        evidence = Evidence.of(similarity, self.unbent, self.usable, self.spacing)
        self.told = bool(np.mean(self.usable) >= _MIN_TESTED)
        self.enough = bool(np.median(self.contacts[self.usable]) >= _PATCH_CONTACTS)
        self.agreement = own_agreement(evidence)
        self.p, self.explained = agreement_as_a_whole(evidence, self.rng)
        judge = Judge(self.statistics, evidence, few=not self.enough)
        rival = best_rival(evidence, judge)
        if rival and rival.better and not paired and self._fits(rival.evidence, _MANY_WRONG):
            return self._in_another_order(rival.order)
        search = Search(evidence, self.mounting, judge)
        if paired or not self._fits(search.run_modules(patches=self.enough), _HALF_WRONG):
            lacking = "contains contacts at pairs of places, two at a time" if paired else ""
            return self._as_a_whole(lacking)
        search.run_sensors()
        logger.info("weighing the evidence")
        proposed = self._explain(search)
        self._find_overlaps(search.evidence)
        # A symmetric layout with a sensor at a wrong place is not an image of itself.
        rival = best_rival(search.evidence, judge)
        if rival is not None and not rival.worse:
            return self._as_a_whole(f"fits {rival.order.text} about as well as the stated order")
        if any(finding.kind != DEAD for finding in self.findings):
            return self._summary(proposed, NOT_CONSISTENT)
        if not self.told or self.explained < _MANY_WRONG:
            return self._as_a_whole()
        self._tell_limits(search)
        return self._summary(proposed, CONSISTENT)

    def _tell_limits(self, search: Search) -> None:
        """Add notes on ambiguities of a consistent layout."""
        near = " and ".join(f"{length * self.spacing:.3g}" for length in _HARDLY_TOLD)
        unit = f" {self.layout.units}" if self.layout.units else ""
        notes = [
            f"not tested: shifts of sensors and modules by less than 2 to 3 spacings ({near}{unit})"
        ]
        if not self.enough:
            notes.append(f"not tested with fewer than {_PATCH_CONTACTS} contacts: moved patches")
        if search.unsure:
            notes.append(
                "modules whose orientation this recording cannot test: "
                f"{len(search.unsure)} ({self._listed(search.unsure)})"
            )
        apart = unsure_patches(search.evidence, search.mounting)
        if apart:
            notes.append(
                "separate patches of modules whose orientation this recording cannot test begin "
                f"with modules {self._listed(patch[0] for patch in apart)}"
            )
        if not self.mounting.members and self.positions.shape[1] == 3:
            notes.append(
                "no modules were detected, so no orientations were tested: if there are modules, "
                "define them (--module-size, and --module-layout if they are bent)"
            )
        n_images = own_images(self.positions, self.spacing)
        if n_images:
            notes.append(
                "the layout is symmetric; rotations and reflections that fit the recording equally "
                f"well: {n_images}"
            )
        self.notes += tuple(notes)

    def _fits(self, evidence: Evidence, least: float) -> bool:
        """Return whether places explain enough of the readings to exclude many wrong places."""
        p, explained = agreement_as_a_whole(evidence, self.rng)
        return p <= _MAX_P and explained >= least

    def _as_a_whole(self, lacking: str = "") -> LayoutCheck:
        """Judge a layout that explains too little for findings on single sensors.

        lacking: Reason why the recording does not test the layout.
        """
        told = self.told and not lacking
        self.findings = [finding for finding in self.findings if finding.kind == DEAD]
        tested = int(self.usable.sum())
        text = (
            "the whole layout is rejected; no single sensors are listed, since about "
            f"{1 - max(0.0, self.explained) ** 0.5:.0%} of them are at wrong places: check that "
            "the layout belongs to this skin, and the order of its sensors"
            if told
            else f"the recording {lacking or f'tests only {tested} of {len(self.rows)} sensors'}; "
            "touch all sensors more, evenly, and one place at a time"
        )
        self.usable = np.zeros_like(self.usable)
        self.notes = (text, *self.notes)
        return self._summary(self.positions, REJECTED if told else UNKNOWN)

    def _in_another_order(self, order: ScanOrder) -> LayoutCheck:
        """Report that the order of the sensors differs from the layout."""
        places = self.positions[order.order]
        distance = np.linalg.norm(places - self.positions, axis=1)
        changed = np.flatnonzero(distance > 0)
        text = f"all {len(distance)} sensors are in {order.text}"
        finding = LayoutFinding(
            "shifted" if order.step else "reversed",
            changed,
            text,
            displacement=float(np.median(distance[changed])),
            agreement_stated=_mean(self.agreement),
        )
        self.findings.append(finding)
        self.notes += ("check the corrected layout again: this finding hides smaller ones",)
        return self._summary(places, NOT_CONSISTENT)

    def _find_dead(self) -> None:
        """Find constant sensors that should have been touched like their neighbours.

        Sensors differ in sensitivity: the least sensitive of the other sensors determine the
        expected number of contacts, relative to neighbours.
        """
        around = np.array(
            [np.median(self.contacts[near]) if near else 0.0 for near in self.neighbours]
        )
        alive = (self.contacts > 0) & (around > 0)
        if not alive.any():
            return
        least = float(np.quantile(self.contacts[alive] / around[alive], _LEAST_SENSITIVE))
        for i in np.flatnonzero(self.constant & (around * least >= MIN_CONTACTS)).tolist():
            text = (
                f"{self.names[i]} is constant, although its neighbours were touched "
                f"{around[i]:.0f} times"
            )
            self.findings.append(LayoutFinding(DEAD, np.array([i]), text))

    def _find_doubled(self) -> bool:
        """Report sensors of the same wire, except the one that fits its place best.

        Return whether contacts occur in pairs: then many sensors repeat others, and so do their
        neighbours.
        """
        pairs = []
        for group in self.copies:
            fits = {}
            for i in group:
                near = [j for j in self.neighbours[i] if j not in group and self.usable[j]]
                if self.usable[i]:
                    similar = self.statistics.similarity[i, near]
                    fits[i] = float(similar.mean()) if near else -1.0
            source, *others = sorted(fits, key=lambda i: -fits[i]) or [-1]
            pairs += [(copy, source) for copy in others]
        partner = dict(pairs) | {source: copy for copy, source in pairs}
        beside = [
            any(partner.get(k) in self.neighbours[source] for k in self.neighbours[copy])
            for copy, source in pairs
        ]
        if sum(beside) >= _PAIRED * np.count_nonzero(self.usable):
            return True
        for copy, source in pairs:
            text = f"{self.names[copy]} repeats the readings of {self.names[source]}"
            self.findings.append(LayoutFinding("doubled", np.array([copy]), text))
            self.usable[copy] = False
        return False

    def _explain(self, search: Search) -> NDArray[np.float64]:
        """Explain the new places, and return the places that the final evidence supports."""
        proposed = search.evidence.positions.copy()
        for kind, text, changes in explain_modules(
            search.changes, search.mounting, self.names, self.usable
        ):
            self._add(kind, text, changes, search.evidence)
        for one, other in search.undecided:
            text = (
                f"modules {self._listed(one)} contradict modules {self._listed(other)} at their "
                "border, and which of them are at wrong places cannot be told"
            )
            sensors = np.concatenate([self.mounting.members[m] for m in one + other])
            self.findings.append(LayoutFinding(CONTRADICTING, sensors, text))
        stated = search.arranged.positions
        for kind, text, sensors in explain(stated, proposed, self.spacing, search.made, self.names):
            self._add_sensors(kind, text, sensors, search, proposed)
        return self._as_stated(proposed)

    def _listed(self, modules: Iterable[int]) -> str:
        """Return the names of modules."""
        return join_items([span(self.mounting.members[m], self.names) for m in modules], _MAX_NAMED)

    def _add(self, kind: str, text: str, changes: Sequence[Change], evidence: Evidence) -> None:
        """Add a finding on changes, of modules or others, with a common cause."""
        agreements = []
        for change in changes:
            sensors = change.move.sensors
            before = evidence.moved(Move(sensors, change.stated))
            tried = (change.stated, change.move.places)
            agreements.append([_mean(agreement(before, sensors, places)) for places in tried])
        stated, there = np.mean(agreements, axis=0).tolist()
        sensors = np.concatenate([change.move.sensors for change in changes])
        distance = np.linalg.norm(
            np.concatenate([change.move.places - change.stated for change in changes]), axis=1
        )
        changed = distance > _SAME * self.spacing
        finding = LayoutFinding(
            kind,
            sensors[changed],
            text,
            displacement=float(np.median(distance[changed])),
            agreement_stated=stated,
            agreement_proposed=there,
            gain=sum(change.verdict.gain for change in changes),
            z=min(change.verdict.z for change in changes),
            modules=tuple(one for change in changes for one in self._turned(change)),
        )
        self.findings.append(finding)

    def _turned(self, change: Change) -> Iterator[ModuleChange]:
        """Yield the resulting orientation of each module of a change."""
        if not change.modules:
            return
        ends = np.cumsum([len(self.mounting.members[m]) for m in change.modules])[:-1]
        halves = (np.split(places, ends) for places in (change.stated, change.move.places))
        for m, before, after in zip(change.modules, *halves, strict=True):
            label = self.modules.labels[self.modules.index[self.rows[self.mounting.members[m][0]]]]
            pads = self.mounting.orientations[0].places[self.mounting.pads[m]]
            chosen = dict(zip(change.modules, change.turns, strict=False)).get(m, 0)
            way = self.mounting.orientations[chosen]
            (old, was), (new, there) = (orientation(pads, at) for at in (before, after))
            if way.backwards:
                new, there = old, was
            mirror, angle = was != there, (new - old + 180) % 360 - 180
            if before.shape[1] > 2:
                mirror = way.reflected
                angle = 0.0 if mirror else motion(before, after)[1]
            angle, old, new = (0.0 + round(one, 1) for one in (angle, old, new))
            yield ModuleChange(label, angle, mirror, old, new)

    def _find_overlaps(self, evidence: Evidence) -> None:
        """Report unexplained overlaps of modules; of two, the one that agrees with fewer others."""
        moved = [i for one in self.findings if one.kind != DEAD for i in one.sensors.tolist()]
        # Wrong pads are not among the members of their module, but move its fit.
        module = self.modules.index[self.rows]
        ours = [module[members[0]] for members in self.mounting.members]
        changed = set(np.flatnonzero(np.isin(ours, module[moved])).tolist())
        left = [one for one in self.mounting.overlaps if not changed & {*one[:2]}]
        if not left:
            return
        found, expected = bonds(evidence, self.mounting)
        label = linked_labels(found > AGREEING * expected)
        size = np.bincount(label)[label]
        while left:
            counts = Counter(m for a, b, _ in left for m in (a, b))
            worst = {m: -_mean(self.agreement[self.mounting.members[m]]) for m in counts}
            m = max(counts, key=lambda m: (-size[m], counts[m], worst[m]))
            others = sorted((length, b if a == m else a) for a, b, length in left if m in (a, b))
            left = [one for one in left if m not in one[:2]]
            text = (
                f"module {self._listed([m])} is {others[0][0]:.3g} from "
                f"{self._listed(other for _, other in others)}, but adjacent modules of this shape "
                f"are {self.mounting.clearance:.3g} apart"
            )
            told = 2 * size[m] <= size[others[0][1]]
            both = [m] if told else [m, others[0][1]]
            sensors = np.concatenate([self.mounting.members[one] for one in both])
            kind = "overlapping" if told else CONTRADICTING
            self.findings.append(LayoutFinding(kind, sensors, text))

    def _add_sensors(
        self,
        kind: str,
        text: str,
        sensors: NDArray[np.intp],
        search: Search,
        proposed: NDArray[np.float64],
    ) -> None:
        """Add a finding on sensors that no module explains, or undo the move."""
        stated, there = search.arranged.positions[sensors], proposed[sensors]
        move, back = Move(sensors, there), Move(sensors, stated)
        verdict = search.weigh(search.evidence.moved(back), move, kind)
        moved = sensors[(there != stated).any(axis=1)]
        if not (verdict.holds and np.mean(self.usable[moved]) >= _MIN_TESTED):
            proposed[sensors] = stated
            return
        untested = [self.names[i] for i in moved if not self.usable[i]]
        caveat = f" ({join_items(untested, _MAX_NAMED)} not tested)" if untested else ""
        change = Change((), (), (), stated, move, verdict)
        self._add(kind, text + caveat, [change], search.evidence)

    def _as_stated(self, proposed: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return proposed places, replaced by exact stated places of the same or other sensors."""
        apart, owner = map(np.asarray, KDTree(self.positions).query(proposed))
        taken = apart[:, None] <= _SAME * self.spacing
        found = np.where(taken, self.positions[owner], proposed)
        return np.where((proposed == self.unbent).all(axis=1)[:, None], self.positions, found)

    def _summary(self, proposed: NDArray[np.float64], verdict: str) -> LayoutCheck:
        n_sensors = self.layout.n_sensors
        status = np.full(n_sensors, NOT_TESTED, dtype=object)
        status[self.rows[self.usable]] = OK
        order = list(KINDS)
        findings = sorted(self.findings, key=lambda f: (order.index(f.kind), int(f.sensors.min())))
        for finding in reversed(findings):  # a dead sensor may have the place of another
            status[self.rows[finding.sensors]] = finding.kind
        untested = [self.layout.names[i] for i in np.flatnonzero(status == NOT_TESTED)]
        if untested and len(untested) < n_sensors:
            self.notes += (
                f"sensors that this recording cannot test: {len(untested)} of {n_sensors} "
                f"({join_items(untested, _MAX_NAMED)})",
            )
        positions = self.layout.positions.copy()
        positions[self.rows] = proposed
        values = np.full(n_sensors, np.nan)
        values[self.rows] = np.where(self.usable, self.agreement, np.nan)
        values.setflags(write=False)
        return LayoutCheck(
            self.layout,
            at_positions(self.layout, positions),
            tuple(status.tolist()),
            tuple(replace(f, sensors=self.rows[f.sensors]) for f in findings),
            values,
            self.modules.index,
            self.spacing,
            self.p,
            self.explained,
            verdict,
            self.notes,
        )


def _as_layout(positions: ArrayLike) -> SensorMap:
    try:
        return SensorMap(np.asarray(positions, dtype=np.float64), units="")
    except (TypeError, ValueError) as error:
        raise InputError(
            f"a layout must be a SensorMap or an array of shape (N, 2) or (N, 3): {error}"
        ) from None


def _matched(
    layout: SensorMap, recording: Recording
) -> tuple[NDArray[np.intp], NDArray[np.intp], tuple[str, ...]]:
    """Return rows of the layout, columns of the same sensors, and notes."""
    columns, notes = match_sensors(layout.names, recording.names, "layout and recording")
    missing = np.flatnonzero(match_names(recording.names, layout.names) < 0)
    if missing.size and not notes:
        listed = join_items([recording.names[i] for i in missing], _MAX_NAMED)
        notes = (f"sensors of the recording that the layout lacks: {missing.size} ({listed})",)
    rows = np.flatnonzero((columns >= 0) & layout.placed)
    if len(rows) < MIN_SENSORS:
        raise InputError(
            f"a check needs at least {MIN_SENSORS} sensors with a position and readings, got "
            f"{len(rows)}"
        )
    rows = rows[np.argsort(columns[rows], kind="stable")]
    return rows, columns[rows], notes


def _mean(values: NDArray[np.float64]) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if known.size else float("nan")
