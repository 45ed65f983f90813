"""Check of stated positions against the readings of a recording."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from anisomap.base.defaults import N_SHIFTS
from anisomap.base.wording import html_table, join_items
from anisomap.errors import InputError
from anisomap.evaluation.scoring import check_distances
from anisomap.health.recording_faults.copies import copied_groups
from anisomap.health.sensors import MIN_CONTACTS
from anisomap.layout.explanation import explain, module_members
from anisomap.numerics.compiled.parallel import limited_blas
from anisomap.numerics.layout.chance import (
    ReadingStatistics,
    agreement,
    agreement_as_a_whole,
    own_agreement,
    reading_statistics,
)
from anisomap.numerics.layout.evidence import REACH, Move, neighbour_spacing
from anisomap.numerics.layout.moves import ModuleShapes
from anisomap.numerics.layout.search import Search
from anisomap.placement.modules import NO_MODULE, Modules
from anisomap.recording import Recording, as_runs, join_runs, match_names, match_sensors
from anisomap.sensor_map import SensorMap

OK = "ok"
"""Status of a tested sensor that reads as its place says."""

NOT_TESTED = "not tested"
"""Status of a sensor without evidence in the recording, or without a stated position."""

KINDS: Mapping[str, str] = MappingProxyType(
    {
        "turned": "a module that is rotated on its own places",
        "mirrored": "a module that is a mirror image of what the layout states",
        "exchanged": "modules that have each other's places",
        "shifted": "a run of consecutive sensors that each have the place of the next",
        "swapped": "two sensors that have each other's places",
        "cycle": "three and more sensors that each have the place of another of them",
        "moved": "sensors that belong to a place where no other sensor is",
        "doubled": "a sensor that repeats the readings of another",
        "dead": "a sensor that stays constant while its neighbours are touched",
    }
)
"""Kinds of findings."""


CONSISTENT, NOT_CONSISTENT = "consistent", "not consistent"
CONTRADICTED, UNKNOWN = "contradicted as a whole", "unknown"
"""Verdicts on a layout; after the last two, no single sensor is accused."""


@dataclass(frozen=True, eq=False)
class LayoutFinding:
    """Sensors whose readings contradict their positions, and what would explain this.

    Attributes
    ----------
    kind : str
        A key of `KINDS`.
    sensors : ndarray of int
        Rows of the layout.
    explanation : str
    displacement : float
        Median distance between the stated and the proposed places, in units of the layout; NaN if
        no place is proposed.
    agreement_stated, agreement_proposed : float
        Mean similarity of the sensors to those around their stated and their proposed places; NaN
        if there are none.
    chance : float
        Largest gain of agreement by a free choice of places after circular shifts in time; NaN
        if no place is proposed.
    gain : float
        Increase of the log-likelihood of all similarities, in nats; NaN if no place is proposed.
    """

    kind: str
    sensors: NDArray[np.intp]
    explanation: str
    displacement: float = float("nan")
    agreement_stated: float = float("nan")
    agreement_proposed: float = float("nan")
    chance: float = float("nan")
    gain: float = float("nan")


@dataclass(frozen=True, eq=False, repr=False)
class LayoutCheck:
    """Result of `check_layout`.

    Attributes
    ----------
    layout : SensorMap
        The layout that was checked.
    corrected : SensorMap
        The same with the proposed places; equal if none are proposed.
    status : tuple of str
        Of each sensor of the layout: a key of `KINDS`, ``"ok"``, or ``"not tested"``.
    findings : tuple of LayoutFinding
        Ordered by kind as in `KINDS`, then by the first sensor.
    agreement : ndarray of shape (N,)
        Mean similarity of each sensor to those around its stated place; NaN if it is not tested
        or has no neighbour within 2.6 spacings.
    module : ndarray of int, shape (N,)
        Module of each sensor, from 0; -1 without one.
    spacing : float
        Median distance between neighbours, in units of the layout.
    p : float
        Probability that a layout whose sensors are shuffled agrees with the readings as well.
    explained : float
        Agreement of the layout beyond that of shuffled ones, over the highest possible: about 1 for
        a right layout, 0 for a shuffled one, 0.25 if half of the sensors are shuffled.
    verdict : str
        ``"consistent"``, ``"not consistent"``: readings contradict the positions of the sensors in
        findings; ``"contradicted as a whole"``: those of half of the sensors or more, which makes
        single sensors uncertain; or ``"unknown"``: the readings say too little.
    notes : tuple of str
        What was not tested, and other caveats.
    """

    layout: SensorMap
    corrected: SensorMap
    status: tuple[str, ...]
    findings: tuple[LayoutFinding, ...]
    agreement: NDArray[np.float64]
    module: NDArray[np.intp]
    spacing: float
    p: float = float("nan")
    explained: float = float("nan")
    verdict: str = CONSISTENT
    notes: tuple[str, ...] = ()

    @property
    def consistent(self) -> bool:
        """Whether the layout explains the readings, and nothing was found."""
        return self.verdict == CONSISTENT

    @property
    def n_tested(self) -> int:
        """Number of sensors that were tested."""
        return sum(status != NOT_TESTED for status in self.status)

    @property
    def n_modules(self) -> int:
        """Number of modules."""
        return int(self.module.max(initial=-1)) + 1

    @property
    def accused(self) -> NDArray[np.bool_]:
        """Mask of the sensors in findings, shape (N,)."""
        return np.array([status not in (OK, NOT_TESTED) for status in self.status], dtype=bool)

    def names(self, finding: LayoutFinding) -> tuple[str, ...]:
        """Return the names of the sensors of a finding."""
        return tuple(self.layout.names[i] for i in finding.sensors)

    def __repr__(self) -> str:
        return (
            f"<LayoutCheck: {self.verdict}, {int(self.accused.sum())} of {self.n_tested} tested "
            f"sensors accused, {self.layout.n_sensors} in the layout>"
        )

    def _repr_html_(self) -> str:
        rows: dict[str, object] = {
            "sensors tested": f"{self.n_tested} of {self.layout.n_sensors}",
            "modules": self.n_modules,
            "verdict": self.verdict,
        }
        rows |= {
            f"{i}: {finding.kind}": finding.explanation
            for i, finding in enumerate(self.findings, 1)
        }
        return html_table("LayoutCheck", rows)


def at_positions(layout: SensorMap, positions: NDArray[np.float64]) -> SensorMap:
    """Return a layout with other positions for the sensors that have one.

    A sensor with another position takes the normal of the nearest stated place, if normals are
    known.
    """
    normals = layout.normals
    placed = np.flatnonzero(layout.placed)
    changed = placed[(positions[placed] != layout.positions[placed]).any(axis=1)]
    if normals is not None and changed.size:
        nearest = KDTree(layout.positions[placed]).query(positions[changed])[1]
        normals = normals.copy()
        normals[changed] = normals[placed[nearest]]
    moved = np.where(layout.placed[:, None], positions, np.nan)
    return replace(layout, positions=moved, normals=normals)


logger = logging.getLogger(__name__)

MIN_SENSORS = 4
"""Minimum number of sensors that can be tested."""

_LEAST_SENSITIVE = 0.05  # quantile of the contacts of sensors, relative to their neighbours
_MAX_NAMED = 8
_MAX_P = 0.01  # of a layout that explains the readings better than shuffled ones
_HALF_WRONG = 0.25  # share of the agreement that is left if half of the sensors are shuffled
_MANY_WRONG = 0.5  # the same of three tenths; right layouts of real skins have 0.76 and more
_MIN_TESTED = 0.5  # share of the sensors of a finding, or of all, that must be tested


def check_layout(
    layout: SensorMap | ArrayLike,
    recording: Recording | ArrayLike | Sequence[Recording],
    *,
    modules: Modules | int | None = None,
    n_shifts: int = N_SHIFTS,
    statistics: ReadingStatistics | None = None,
    rng: np.random.Generator | int | None = None,
) -> LayoutCheck:
    """Find the sensors whose readings contradict their stated positions.

    Parameters
    ----------
    layout : SensorMap or array_like of shape (N, 2) or (N, 3)
        Stated positions. A map is matched with the recording by sensor names; if no name is shared
        and the numbers of sensors agree, by order, with a note.
    recording : Recording, array_like of shape (T, N), or sequence of Recording
        At least 40 frames, without missing readings (see `Recording.complete`).
    modules : Modules or int, optional
        Modules of the layout, or the number of channels of each; by default, modules are found as
        rigid repeats: see `anisomap.layout.module_members`.
    n_shifts : int
        Number of circular shifts of the null distribution; at least 1.
    statistics : ReadingStatistics, optional
        Of all sensors of the recording, from
        `anisomap.numerics.layout.chance.reading_statistics`, to check several layouts against
        one recording, in place of `n_shifts` shifts of it. Computed by default.
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
    First, the layout is compared with shuffled ones. If it explains the readings no better, or so
    little that half of the sensors or more are elsewhere, no single sensor is accused.

    The evidence is how the similarity of two sensors falls with their distance on the layout. A
    proposed change of places must raise the log-likelihood of all similarities, also in both
    halves of the recording; and it must raise the agreement of the sensors with those around
    them, the mean rank correlation, by more than a free choice of places raises it after circular
    shifts in time. Two sensors closer than 2 to 3 spacings may read alike, so that small
    displacements are not found. Sensors with fewer than 5 contacts are not tested, nor are those
    that agree with others no more than after a shift.
    """
    if n_shifts < 1:
        raise InputError(f"n_shifts must be at least 1, got {n_shifts}")
    stated = layout if isinstance(layout, SensorMap) else _as_layout(layout)
    joined = join_runs(as_runs(recording)).complete()
    if stated.dimensions not in (2, 3):
        raise InputError(f"a layout must have 2 or 3 coordinates, got {stated.dimensions}")
    rows, columns, notes = _matched(stated, joined)
    positions = stated.positions[rows]
    check_distances(positions, "the layout")
    members = module_members(stated, modules)
    spacing = neighbour_spacing(positions)
    if not spacing > 0:
        raise InputError("most sensors of the layout have the same position; there is no distance")
    generator = np.random.default_rng(0 if rng is None else rng)
    logger.info("comparing readings with positions")
    with limited_blas(len(rows)):
        known = statistics or reading_statistics(joined.readings, generator, n_shifts=n_shifts)
        part = joined.select(columns)
        checked = _Checked(
            stated,
            rows,
            joined.signals.contacts[columns],
            constant=~joined.varying()[columns],
            copies=[one.sensors for one in copied_groups(part)],
            spacing=spacing,
            members=members,
            statistics=known.select(columns),
            rng=generator,
            notes=notes,
        )
        return checked.result()


@dataclass(eq=False)
class _Checked:
    """The steps of a check; sensors are numbered as in the columns that were matched.

    rows: Of the sensors, in the layout.
    contacts: Of each sensor.
    constant: Whether each is.
    copies: Groups of sensors that read one wire.
    members: Rows of the layout that each module has.
    """

    layout: SensorMap
    rows: NDArray[np.intp]
    contacts: NDArray[np.intp]
    constant: NDArray[np.bool_]
    copies: Sequence[Sequence[int]]
    spacing: float
    members: Sequence[NDArray[np.intp]]
    statistics: ReadingStatistics
    rng: np.random.Generator
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        self.positions = self.layout.positions[self.rows]
        self.names = [self.layout.names[i] for i in self.rows]
        column = np.full(self.layout.n_sensors, -1)
        column[self.rows] = np.arange(len(self.rows))
        self.label = np.full(self.layout.n_sensors, NO_MODULE)
        for k, inside in enumerate(self.members):
            self.label[inside] = k
        present = [column[inside][column[inside] >= 0] for inside in self.members]
        self.modules = ModuleShapes.of([one for one in present if len(one)], self.positions)
        self.usable = self.statistics.tested & (self.contacts >= MIN_CONTACTS)
        self.findings: list[LayoutFinding] = []
        near: Any = KDTree(self.positions).query_ball_point(self.positions, REACH * self.spacing)
        self.neighbours = [[j for j in found if j != i] for i, found in enumerate(near)]

    def result(self) -> LayoutCheck:
        """Carry out all steps."""
        self._find_dead()
        self._find_doubled()
        if np.count_nonzero(self.usable) < MIN_SENSORS:
            raise InputError(
                f"only {np.count_nonzero(self.usable)} of {len(self.rows)} sensors are related to "
                f"others beyond chance, and a check needs {MIN_SENSORS}; record more contacts"
            )
        search = Search(self.statistics, self.positions, self.usable, self.spacing, self.modules)
        self.agreement = own_agreement(search.evidence)
        self.p, self.explained = agreement_as_a_whole(search.evidence, self.rng)
        if self.p > _MAX_P or self.explained < _HALF_WRONG:
            return self._as_a_whole()
        search.run()
        logger.info("weighing the evidence")
        proposed = self._explain(search)
        if not self.findings and self.explained < _MANY_WRONG:
            return self._as_a_whole()
        return self._summary(proposed, NOT_CONSISTENT if self.findings else CONSISTENT)

    def _as_a_whole(self) -> LayoutCheck:
        """Judge a layout that explains too little for accusations of single sensors."""
        told = np.mean(self.usable) >= _MIN_TESTED
        self.findings = []
        self.usable[:] = False
        text = (
            f"about {1 - max(0.0, self.explained) ** 0.5:.0%} of the sensors are not where the "
            "layout states, too many to name: check that the layout belongs to this skin, and "
            "the order of its sensors"
            if told
            else "the recording says too little about the sensors: touch them more, and more evenly"
        )
        self.notes = (text, *self.notes)
        return self._summary(self.positions, CONTRADICTED if told else UNKNOWN)

    def _find_dead(self) -> None:
        """Find constant sensors that should have been touched, as their neighbours were.

        Sensors differ in sensitivity: at least as many contacts are expected as the least sensitive
        of the others have, relative to their neighbours.
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
            self.findings.append(LayoutFinding("dead", np.array([i]), text))

    def _find_doubled(self) -> None:
        """Report those sensors of one wire that fit their places less than another."""
        for group in self.copies:
            fits = {}
            for i in group:
                near = [j for j in self.neighbours[i] if j not in group and self.usable[j]]
                if self.usable[i]:
                    similar = self.statistics.similarity[i, near]
                    fits[i] = float(similar.mean()) if near else -1.0
            source, *others = sorted(fits, key=lambda i: -fits[i]) or [-1]
            for copy in others:
                text = f"{self.names[copy]} repeats the readings of {self.names[source]}"
                self.findings.append(LayoutFinding("doubled", np.array([copy]), text))
                self.usable[copy] = False

    def _explain(self, search: Search) -> NDArray[np.float64]:
        """Explain the new places, keep what the final evidence supports, and return the places."""
        evidence = search.evidence
        proposed = evidence.positions.copy()
        explained = explain(
            self.positions,
            proposed,
            self.modules,
            spacing=self.spacing,
            rigid=search.rigid,
            names=self.names,
        )
        for group in explained:
            sensors = group.sensors
            move = Move(sensors, proposed[sensors])
            before = evidence.moved(Move(sensors, self.positions[sensors]))
            verdict = search.judge(before, move, group.alternatives, rigid=group.kind == "moved")
            stated, there = (
                _mean(agreement(before, sensors, places[sensors]))
                for places in (self.positions, proposed)
            )
            distance = np.linalg.norm(move.places - self.positions[sensors], axis=1)
            changed = distance > 0
            # A few tested sensors do not accuse many others.
            told = np.mean(self.usable[sensors[changed]]) >= _MIN_TESTED
            if not (told and verdict.holds and there > stated):
                proposed[sensors] = self.positions[sensors]
                continue
            untested = [self.names[i] for i in sensors[changed] if not self.usable[i]]
            caveat = f" ({join_items(untested, _MAX_NAMED)} not tested)" if untested else ""
            finding = LayoutFinding(
                group.kind,
                sensors[changed],
                group.text + caveat,
                displacement=float(np.median(distance[changed])),
                agreement_stated=stated,
                agreement_proposed=there,
                chance=verdict.chance,
                gain=verdict.gain,
            )
            self.findings.append(finding)
        return proposed

    def _summary(self, proposed: NDArray[np.float64], verdict: str) -> LayoutCheck:
        n_sensors = self.layout.n_sensors
        status = [NOT_TESTED] * n_sensors
        for column in np.flatnonzero(self.usable):
            status[self.rows[column]] = OK
        order = list(KINDS)
        findings = sorted(self.findings, key=lambda f: (order.index(f.kind), int(f.sensors.min())))
        for finding in findings:
            for column in finding.sensors:
                status[self.rows[column]] = finding.kind
        untested = [self.layout.names[i] for i in range(n_sensors) if status[i] == NOT_TESTED]
        if untested and len(untested) < n_sensors:
            self.notes += (
                f"{len(untested)} of {n_sensors} sensors are not tested, since the recording says "
                f"nothing about them: {join_items(untested, _MAX_NAMED)}",
            )
        positions = self.layout.positions.copy()
        positions[self.rows] = proposed
        values = np.full(n_sensors, np.nan)
        values[self.rows] = np.where(self.usable, self.agreement, np.nan)
        values.setflags(write=False)
        self.label.setflags(write=False)
        return LayoutCheck(
            self.layout,
            at_positions(self.layout, positions),
            tuple(status),
            tuple(replace(f, sensors=self.rows[f.sensors]) for f in findings),
            values,
            self.label,
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
    """Return rows of the layout, the columns of the same sensors, and notes."""
    columns, notes = match_sensors(layout.names, recording.names, "layout and recording")
    missing = np.flatnonzero(match_names(recording.names, layout.names) < 0)
    if missing.size and not notes:
        listed = join_items([recording.names[i] for i in missing], _MAX_NAMED)
        notes = (f"{missing.size} sensors of the recording have no position: {listed}",)
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
