"""Search for the changes of places that explain the readings better than the stated places."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.layout.arranging import Arrangement, Change
from anisomap.layout.evidence import MIN_GAIN, Evidence, Move, Proposal
from anisomap.layout.judging import MIN_GROUP_GAIN, MIN_Z, Judge, Verdict
from anisomap.layout.modules import Mounting
from anisomap.layout.patches import (
    is_possible,
    patch_moves,
    single_moves,
    without_smaller_patches,
)
from anisomap.layout.sensors import cable_shifts, half_reassigned, reassigned
from anisomap.layout.together import (
    AGREEING,
    MovedPatch,
    border,
    moved_patches,
)

_MAX_ROUNDS = 12
_PRICE_OF_PATCH = 100.0  # nats; by hand
_LEFT = 0.5  # share of its gain that a move must keep after others have been made; by hand

Proposer: TypeAlias = Callable[[Evidence], list[Proposal]]

PERMUTING: tuple[Proposer, ...] = (cable_shifts, reassigned)
"""All functions that propose permutations of places."""

SEARCHES: tuple[tuple[Proposer, ...], ...] = (
    (cable_shifts, reassigned, patch_moves),
    (half_reassigned,),
    (single_moves,),
)
"""Functions that propose moves; those of one sensor are each used once no other move is left.

Most sensors that fit another place have changed places with others that say where they belong.
"""
_OF_PATCHES = (patch_moves, single_moves)  # searches that do not permute places


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
    rigid: Groups of sensors that were moved to places where no sensor is.
    """

    def __init__(self, evidence: Evidence, mounting: Mounting, judge: Judge) -> None:
        self.mounting, self.judge = mounting, judge
        self.arranged = self.evidence = evidence
        self.rigid: list[NDArray[np.intp]] = []
        self.changes: list[Change] = []
        self.unsure: list[int] = []
        self._explained: set[int] = set()

    def run_modules(self) -> Evidence:
        """Change modules and patches of them, and return the evidence then."""
        start = self.evidence
        joint = Arrangement(start, self.mounting, self.judge)
        self.evidence, self.changes = joint.run()
        patches: list[Change] = []
        for _ in range(_MAX_ROUNDS):
            for patch in moved_patches(start, self.mounting):
                turned = start.moved(patch.move)
                mounting = self.mounting.moved(patch.modules, turned.positions)
                other = Arrangement(turned, mounting, self.judge)
                evidence, changes = other.run()
                change = self._turned(evidence, start, patch)
                # Few pads are at the border: their agreement with others tells less than all pads.
                told = change.verdict.gain >= change.verdict.least and change.verdict.z >= MIN_Z
                beside = border(evidence, mounting.members, patch.modules) > AGREEING
                if told and beside and self._better(evidence, changes, patch):
                    patches.append(change)
                    start, joint, self.mounting = turned, other, mounting
                    self.evidence, self.changes = evidence, changes
                    break
            else:
                break
        self.changes = patches + self.changes
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

    def _turned(self, evidence: Evidence, start: Evidence, patch: MovedPatch) -> Change:
        """Weigh a turn of a patch, with all other modules as proposed after it."""
        stated = start.positions[patch.move.sensors]
        before = evidence.moved(Move(patch.move.sensors, stated))
        verdict = self.judge.weigh(before, patch.move, patch.tried, rigid=True)
        modules, move = patch.modules, patch.move
        return Change(modules, modules, (), stated, move, patch.second, verdict, together=True)

    def run_sensors(self) -> None:
        """Move patches, runs of channels, and single sensors that no module explains."""
        for _ in range(_MAX_ROUNDS):
            if not any(map(self._round, SEARCHES)):
                break
            self.evidence = self.evidence.refitted()

    def _round(self, searches: Sequence[Proposer]) -> bool:
        proposals = [
            (proposal, search)
            for search in searches
            for proposal in search(self.evidence)
            if proposal.gain >= MIN_GAIN
        ]
        proposals.sort(key=lambda pair: -pair[0].gain)
        changed: set[int] = set()
        for proposal, search in proposals:
            sensors = proposal.move.sensors.tolist()
            if changed.intersection(sensors) or self._explained.intersection(sensors):
                continue
            if self.evidence.gain(proposal.move) < _LEFT * proposal.gain:
                continue
            # Without the readings of both, a swap is no stronger evidence than a free place.
            rigid = search not in PERMUTING
            if rigid and not is_possible(self.evidence, proposal.move):
                continue
            verdict = self.weigh(self.evidence, proposal.move, proposal.alternatives, rigid=rigid)
            if verdict.holds:
                self.evidence = self.evidence.moved(proposal.move)
                changed.update(sensors)
                if search in _OF_PATCHES:
                    self.rigid.append(proposal.move.sensors)
        return bool(changed)

    def weigh(
        self,
        evidence: Evidence,
        move: Move,
        alternatives: Sequence[Move] = (),
        *,
        rigid: bool = False,
    ) -> Verdict:
        """Weigh the evidence for a move: see `Judge.weigh`."""
        if rigid:
            evidence = without_smaller_patches(evidence, move)
        return self.judge.weigh(evidence, move, alternatives, rigid=rigid)
