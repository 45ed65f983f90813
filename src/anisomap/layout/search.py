"""Search for changes of places that explain the readings better than the stated places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from anisomap.layout.evidence import MIN_GAIN, Evidence, Move, Proposal
from anisomap.layout.judging import MIN_GROUP_GAIN, Judge, Verdict
from anisomap.layout.module_changes import Arrangement, Change
from anisomap.layout.modules import Mounting
from anisomap.layout.patches import free_moves
from anisomap.layout.sensors import cable_shifts, reassigned
from anisomap.layout.together import AGREEING, border, moved_patches, on_places, other_side
from anisomap.numerics.neighbours import linked_labels

_MAX_ROUNDS = 12
_PRICE_OF_PATCH = 100.0  # nats; by hand
_MIN_RUN_GAIN = 60.0  # nats; beside a moved patch, a run of a correct module gained 41
_LEFT = 0.5  # share of its gain that a move must keep after other moves; by hand

_WHOLE = 0.55  # of the other modules, which must be linked for a shift in space; by hand
SMALLER, SMALLER_IN_SPACE = 1.3, 2.0
"""Ratio of modules from which the larger of two contradicting parts is correct; by hand."""


def _price(change: Change) -> float:
    """Return the price of a change of modules in nats."""
    free = not set(change.slots) <= set(change.modules)
    return MIN_GROUP_GAIN * len(change.modules) * (2 if free else 1)


class Search:
    """Greedy search: all modules jointly first; then moves of other sensors, in order of gain.

    evidence: Evidence with modules unbent at stated places; after a search, with all changes.
    arranged: Arrangement after the search of modules.
    mounting: Places of modules, with patches turned as proposed.
    changes: Changes of patches and modules.
    undecided: Pairs of patches that moved relative to each other; it is uncertain which one moved.
    unsure: Modules whose orientation is not certain.
    made: Proposals that hold, for sensors that no module explains.
    """

    def __init__(self, evidence: Evidence, mounting: Mounting, judge: Judge) -> None:
        self.mounting, self.judge = mounting, judge
        self.arranged = self.evidence = evidence
        self.made: list[Proposal] = []
        self.changes: list[Change] = []
        self.unsure: list[int] = []
        self.undecided: list[tuple[list[int], list[int]]] = []
        self._explained: set[int] = set()

    def run_modules(self, *, patches: bool = True) -> Evidence:
        """Change modules, and patches if these may move; return the resulting evidence."""
        joint = Arrangement(self.evidence, self.mounting, self.judge).run()
        self._rows = any(change.row for change in joint.changes)
        moved: list[Change] = []
        for _ in range(_MAX_ROUNDS if patches else 0):
            found = self._next_patch(joint)
            if found is None:
                break
            joint = found[1]
            for first in moved:  # one may have moved next to another at a wrong place
                back = Move(first.move.sensors, first.stated)
                rest = {m for one in (*moved, found[0]) if one is not first for m in one.modules}
                if not rest & {*first.modules} and joint.evidence.gain(back) > -MIN_GROUP_GAIN:
                    moved = [one for one in moved if one is not first]
                    joint = self._with(joint, first.modules, back)
            moved.append(found[0])
        self.arranged = self.evidence = joint.evidence
        self.mounting, self.unsure = joint.mounting, joint.unsure()
        self.changes = moved + joint.changes
        for change in self.changes:
            self._explained.update(change.move.sensors.tolist())
        changed = {m for change in self.changes for m in change.modules}
        self.undecided = [pair for pair in self.undecided if not changed & {*pair[0], *pair[1]}]
        return self.evidence

    def _next_patch(self, joint: Arrangement) -> tuple[Change, Arrangement] | None:
        """Return a patch that certainly moved, and the arrangement with this patch moved."""
        self.undecided, start, mounting = [], joint.stated, joint.mounting
        for modules, move in moved_patches(start, mounting, joint.evidence):
            others, back = other_side(start, mounting, modules, move)
            # Relative motion alone does not determine which of two parts moved.
            ratio, flat = len(others) / len(modules), start.positions.shape[1] == 2
            least, smaller = (0, SMALLER) if flat else (1, SMALLER_IN_SPACE)
            shift = (move.places - start.positions[move.sensors]).mean(axis=0)
            if not flat and np.linalg.norm(shift) > start.falloff.spacing:
                rest = np.delete(np.delete(mounting.adjacent, modules, 0), modules, 1)
                if np.bincount(linked_labels(rest)).max() < _WHOLE * len(rest):
                    continue  # beside a board that moved, others fit at shifted places, too
            if ratio <= least or any({*modules} <= {*one, *two} for one, two in self.undecided):
                continue
            if ratio <= 1 / smaller:
                found = self._patch(joint, others, on_places(start, mounting, others, back) or back)
            else:
                found = self._patch(joint, modules, move)
            if found and not 1 / smaller < ratio < smaller:
                return found
            if found:
                self.undecided.append((modules, others))
        return None

    def _with(self, joint: Arrangement, modules: Sequence[int], move: Move) -> Arrangement:
        """Arrange modules again, with some of them moved as a patch."""
        turned = joint.stated.moved(move)
        mounting = joint.mounting.moved(modules, turned.positions)
        return Arrangement(turned, mounting, self.judge).run(rows=self._rows)

    def _patch(
        self, joint: Arrangement, modules: list[int], move: Move
    ) -> tuple[Change, Arrangement] | None:
        """Move a patch, then modules; return None unless the patch certainly moved."""
        stated = joint.stated.positions[move.sensors]
        if not border(joint.stated.moved(move), joint.mounting, modules) > 0:
            return None
        other = self._with(joint, modules, move)
        verdict = self.judge.weigh(
            other.evidence.moved(Move(move.sensors, stated)), move, group=True, free=True
        )
        changed = np.flatnonzero((other.evidence.positions != joint.evidence.positions).any(axis=1))
        all_moves = Move(changed, other.evidence.positions[changed])
        price, before = (sum(map(_price, one.changes)) for one in (other, joint))
        fewer = price + _PRICE_OF_PATCH < before
        fewer = fewer and joint.evidence.gain(all_moves) > -MIN_GROUP_GAIN
        left, then = (border(one.evidence, joint.mounting, modules) for one in (joint, other))
        better = then - left > AGREEING and self.judge.certainly_gains(joint.evidence, all_moves)
        if not (verdict.told and then > AGREEING and (fewer or better)):
            return None
        return Change(tuple(modules), tuple(modules), (), stated, move, verdict, True), other

    def run_sensors(self) -> None:
        """Move patches, runs of channels, and single sensors that no module explains.

        Sensors are moved alone only when no other move is left: most sensors that fit another place
        were exchanged with sensors whose readings show their places.
        """
        apart = partial(free_moves, loose=self.mounting.owner < 0, home=self.mounting.home)
        stages: list[tuple[Callable[[Evidence], list[Proposal]], ...]] = [
            (cable_shifts, reassigned, partial(apart, alone=False)),
            (partial(reassigned, alone=True),),
            (partial(apart, alone=True),),
        ]
        for _ in range(_MAX_ROUNDS):
            if not any(
                self._round([one for propose in stage for one in propose(self.evidence)])
                for stage in stages
            ):
                break
            self.evidence = self.evidence.refitted()

    def _round(self, proposals: Sequence[Proposal]) -> bool:
        changed: set[int] = set()
        for proposal in sorted(proposals, key=lambda one: -one.gain):
            sensors = proposal.move.sensors.tolist()
            least = _MIN_RUN_GAIN if proposal.kind == "shifted" else MIN_GAIN
            if proposal.gain < least or (changed | self._explained).intersection(sensors):
                continue
            if self.evidence.gain(proposal.move) < _LEFT * proposal.gain:
                continue
            if self.weigh(self.evidence, proposal.move, proposal.kind).holds:
                self.evidence = self.evidence.moved(proposal.move)
                changed.update(sensors)
                self.made.append(proposal)
        return bool(changed)

    def weigh(self, evidence: Evidence, move: Move, kind: str) -> Verdict:
        """Weigh the evidence for a move of single sensors."""
        # Without the readings of both, a swap is no stronger evidence than a free place.
        half = len(move.sensors) == 2 and not evidence.usable[move.sensors].all()
        run = kind == "shifted"
        return self.judge.weigh(evidence, move, group=run, free=kind == "moved" or half, few=run)
