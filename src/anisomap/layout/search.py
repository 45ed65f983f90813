"""Search for the changes of places that explain the readings better than the stated places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from anisomap.layout.evidence import MIN_GAIN, Evidence, Move, Proposal
from anisomap.layout.judging import MIN_GROUP_GAIN, Judge, Verdict, around
from anisomap.layout.module_changes import Arrangement, Change
from anisomap.layout.modules import Mounting
from anisomap.layout.patches import free_moves
from anisomap.layout.sensors import cable_shifts, reassigned
from anisomap.layout.together import AGREEING, border, moved_patches

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
            held = []
            for modules, (move, second) in moved_patches(start, self.mounting, self.evidence):
                turned, own = start.moved(move), tuple(modules)
                if not border(turned, self.mounting.members, modules) > 0:
                    continue
                mounting = self.mounting.moved(modules, turned.positions)
                other = Arrangement(turned, mounting, self.judge)
                evidence, changes = other.run()
                stated = start.positions[move.sensors]
                before = evidence.moved(Move(move.sensors, stated))
                verdict = self.judge.weigh(before, move, group=True, free=True)
                # Few pads are at the border: their agreement with others tells less than all pads.
                beside = border(evidence, mounting.members, modules) > AGREEING
                one = Change(own, own, (), stated, move, second, verdict, True)
                worth = self._worth(evidence, one, changes)
                if verdict.told and beside and worth > -np.inf:
                    held.append((worth, one, turned, other, mounting, evidence, changes))
            if not held:
                break
            first = held[0][1].modules
            rivals = [each for each in held[1:] if not set(first) & set(each[1].modules)]
            _, one, start, joint, self.mounting, self.evidence, self.changes = max(
                [held[0], *rivals], key=lambda each: each[0]
            )
            moved.append(one)
        self.changes = moved + self.changes
        self.unsure = joint.unsure()
        for change in self.changes:
            self._explained.update(change.move.sensors.tolist())
        self.arranged = self.evidence
        return self.evidence

    def _worth(self, evidence: Evidence, patch: Change, changes: Sequence[Change]) -> float:
        """Return what a further patch gains at its price, if it explains more, or as well by less.

        Of two parts of a patch that moved against each other, the smaller one is worth more.
        """
        changed = np.flatnonzero((evidence.positions != self.evidence.positions).any(axis=1))
        move = Move(changed, evidence.positions[changed])
        price, before = sum(map(_price, changes)), sum(map(_price, self.changes))
        fewer = price + _PRICE_OF_PATCH < before and self.evidence.gain(move) > -MIN_GROUP_GAIN
        # Else modules one by one must leave the border contradicted.
        left = border(self.evidence, self.mounting.members, patch.modules) < 0
        if not (fewer or (left and self.judge.certainly_gains(self.evidence, move))):
            return -np.inf
        return around(self.evidence, move).gain(move) - price - _price(patch)

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
