"""Search for the changes of places that explain the readings better than the stated places."""

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
from anisomap.layout.together import AGREEING, MovedPatch, border, moved_patches

_MAX_ROUNDS = 12
_PRICE_OF_PATCH = 100.0  # nats; by hand
_LEFT = 0.5  # share of its gain that a move must keep after others have been made; by hand


def _price(change: Change) -> float:
    """Return the nats that a change of modules costs."""
    free = not set(change.slots) <= set(change.modules)
    return MIN_GROUP_GAIN * len(change.modules) * (2 if free else 1)


class Search:
    """Greedy search: modules first, all together; then moves of others, in order of their gain.

    evidence: With modules unbent at their stated places; after a search, with all changes.
    arranged: After the search of modules.
    mounting: Where modules are, patches turned as proposed.
    changes: Of patches and modules.
    unsure: Modules whose orientation the readings leave open.
    made: Proposals for sensors that no module explains, which hold.
    """

    def __init__(self, evidence: Evidence, mounting: Mounting, judge: Judge) -> None:
        self.mounting, self.judge = mounting, judge
        self.arranged = self.evidence = evidence
        self.made: list[Proposal] = []
        self.changes: list[Change] = []
        self.unsure: list[int] = []
        self._explained: set[int] = set()

    def run_modules(self, *, patches: bool = True) -> Evidence:
        """Change modules, and patches of them if they are to move; return the evidence then."""
        start = self.evidence
        joint = Arrangement(start, self.mounting, self.judge)
        self.evidence, self.changes = joint.run()
        moved: list[Change] = []
        for _ in range(_MAX_ROUNDS if patches else 0):
            for patch in moved_patches(start, self.mounting, self.evidence):
                turned = start.moved(patch.move)
                if not border(turned, self.mounting.members, patch.modules) > 0:
                    continue
                mounting = self.mounting.moved(patch.modules, turned.positions)
                other = Arrangement(turned, mounting, self.judge)
                evidence, changes = other.run()
                move, modules = patch.move, patch.modules
                stated = start.positions[move.sensors]
                before = evidence.moved(Move(move.sensors, stated))
                verdict = self.judge.weigh(before, move, group=True, free=True)
                # Few pads are at the border: their agreement with others tells less than all pads.
                beside = border(evidence, mounting.members, patch.modules) > AGREEING
                if verdict.told and beside and self._better(evidence, changes, patch):
                    moved.append(
                        Change(modules, modules, (), stated, move, patch.second, verdict, True)
                    )
                    start, joint, self.mounting = turned, other, mounting
                    self.evidence, self.changes = evidence, changes
                    break
            else:
                break
        self.changes = moved + self.changes
        self.unsure = joint.unsure()
        for change in self.changes:
            self._explained.update(change.move.sensors.tolist())
        self.arranged = self.evidence
        return self.evidence

    def _better(self, evidence: Evidence, changes: Sequence[Change], patch: MovedPatch) -> bool:
        """Return whether a further patch explains the readings better, or as well by less."""
        changed = np.flatnonzero((evidence.positions != self.evidence.positions).any(axis=1))
        move = Move(changed, evidence.positions[changed])
        price = sum(map(_price, changes)) + _PRICE_OF_PATCH
        if price < sum(map(_price, self.changes)) and self.evidence.gain(move) > -MIN_GROUP_GAIN:
            return True
        # Else modules one by one must leave the border contradicted.
        left = border(self.evidence, self.mounting.members, patch.modules) < 0
        return left and self.judge.certainly_gains(self.evidence, move)

    def run_sensors(self) -> None:
        """Move patches, runs of channels, and single sensors that no module explains.

        Sensors are moved alone once no other move is left: most that fit another place have changed
        places with others that say where they belong.
        """
        loose = np.ones(len(self.evidence.usable), dtype=bool)
        loose[[i for inside in self.mounting.members for i in inside.tolist()]] = False
        apart = partial(free_moves, loose=loose, home=self.mounting.home)
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
            if proposal.gain < MIN_GAIN or (changed | self._explained).intersection(sensors):
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
