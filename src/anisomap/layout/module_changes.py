"""Search for the places and orientations of all modules that explain the readings best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import MIN_DISPLACEMENT, MIN_GAIN, Evidence, Move
from anisomap.layout.flips import Orientations
from anisomap.layout.judging import MIN_GROUP_GAIN, MIN_Z, Judge, Verdict
from anisomap.layout.modules import Mounting
from anisomap.layout.sensors import chains
from anisomap.layout.together import AGREEING, bonds, border
from anisomap.numerics.neighbours import linked_labels

MIN_TESTED = 4
"""Minimum number of tested pads for an orientation; three fitted wrong orientations by chance."""

MIN_RUN = 4  # modules in reverse order; two are exchanged
_MAX_ROUNDS = 12
_N_SLOTS = 12  # places, besides its own, that a module may take; chosen by hand
_FAR = 9.0  # spacings beyond which sensors are no evidence of a place
_BESIDE = 0.1  # minimum evidence that a changed module is adjacent to others, relative to expected
_NONE = -1e6


@dataclass(frozen=True, eq=False)
class Change:
    """Modules at other places, or in another orientation at their own places.

    modules: One module, several of which each has the place of the next, or a joint move.
    slots, turns: Proposed slots and orientations of these modules.
    stated: Places before, (m, k).
    move: Move from the stated to the proposed places.
    """

    modules: tuple[int, ...]
    slots: tuple[int, ...]
    turns: tuple[int, ...]
    stated: NDArray[np.float64]
    move: Move
    verdict: Verdict
    together: bool = False

    @property
    def row(self) -> bool:
        """Whether a row of modules is in reverse order."""
        return len(self.modules) >= MIN_RUN and self.slots == self.modules[::-1]


class Arrangement:
    """Search for a slot and an orientation of each module, starting from the stated ones.

    Orientations are improved by chains of flips, and slots by a linear assignment in which each
    change has a price, alternately. Then, changes that do not hold are undone, the weakest first.

    stated: Evidence with modules unbent at their stated places.
    evidence, changes: Evidence after all changes that hold, and these changes.
    """

    def __init__(self, evidence: Evidence, mounting: Mounting, judge: Judge) -> None:
        self.stated, self.mounting, self._judge = evidence, mounting, judge
        self.evidence, self.changes = evidence, list[Change]()
        self._members = mounting.members
        self._slot, self._turn = np.arange(mounting.n_modules), np.zeros(mounting.n_modules, int)
        self._falloff = evidence.falloff
        self._tested = np.array(
            [evidence.usable[m].sum() >= MIN_TESTED for m in self._members], bool
        )

    def run(self, *, rows: bool = True) -> Arrangement:
        """Make all changes that hold, and return the arrangement.

        rows: Whether to search for rows of modules in reverse order.
        """
        if not self._tested.any() or len(self._tested) < 2:
            return self
        if rows:
            self._reverse(self.stated)
        calm = False
        for _ in range(_MAX_ROUNDS):
            before = np.concatenate([self._slot, self._turn])
            if not calm:
                self._falloff = self._arranged().refitted().falloff
                self._orient(self._arranged())
            self._reassign(self._arranged(), free=calm)
            same = np.array_equal(before, [*self._slot, *self._turn])
            if same and calm:
                break
            calm = same  # moves to free places follow when no exchange is left
        self.evidence, self.changes = self._changes()
        return self

    def unsure(self) -> list[int]:
        """Return the modules that fit another orientation nearly as well."""
        evidence = self._arranged()
        found = []
        for m, inside in enumerate(self._members):
            moves = [
                Move(inside, places)
                for turn, places in enumerate(self._images(m))
                if turn != self._turn[m] and self.mounting.orientations[turn].fits
            ]
            if min((-evidence.gain(move) for move in moves), default=np.inf) < MIN_GAIN:
                found.append(m)
        return found

    def _arranged(self) -> Evidence:
        """Return the evidence with all modules at their present places."""
        positions = self.mounting.arranged(self.stated.positions, self._slot, self._turn)
        return replace(self.stated, positions=positions, falloff=self._falloff)

    def _images(self, module: int) -> NDArray[np.float64]:
        """Return the places of a module in each orientation at its present slot, (O, m, k)."""
        return np.asarray(self.mounting.shapes[self._slot[module]][:, self.mounting.pads[module]])

    def _orient(self, evidence: Evidence) -> None:
        images = [self._images(m) for m in range(len(self._slot))]
        ways = self.mounting.orientations
        price = np.array([MIN_GAIN if one.fits else 2 * MIN_GAIN for one in ways])
        price[0] = 0
        field = Orientations.of(evidence, self._members, images, self._tested, price)
        self._turn = field.best(self._turn)

    def _fits(self, evidence: Evidence, wanted: NDArray[np.bool_]) -> tuple[Any, Any]:
        """Return the best fits of modules in requested slots, and the orientations.

        wanted (M, S) -> the log-likelihood ratio, and the orientation, both (M, S).
        """
        fits, turns = np.full(wanted.shape, _NONE), np.zeros(wanted.shape, int)
        ways = [
            o for o, one in enumerate(self.mounting.orientations) if one.fits and not one.backwards
        ]
        home = self.mounting.owner
        owner = np.where(home >= 0, self._slot[home], -1)
        spacing, middles = evidence.falloff.spacing, self.mounting.middles
        for s in np.flatnonzero(wanted.any(axis=0)).tolist():
            away = np.linalg.norm(evidence.positions - middles[s], axis=1)
            others = np.flatnonzero(evidence.usable & (away < _FAR * spacing) & (owner != s))
            if len(others) < MIN_TESTED:
                continue
            modules = np.flatnonzero(wanted[:, s]).tolist()
            inside = np.concatenate([self._members[m] for m in modules])
            pads = np.concatenate([self.mounting.pads[m] for m in modules])
            own = home[inside]
            apart = (own[:, None] != home[others]) & evidence.usable[inside][:, None]
            codes = evidence.codes[np.ix_(inside, others)]
            starts = np.flatnonzero(np.diff(own, prepend=-1))
            values = []
            for way in ways:
                distances = cdist(self.mounting.shapes[s, way], evidence.positions[others])
                bins = evidence.falloff.bins(distances)[pads]
                ratios = np.where(apart, evidence.falloff.ratio(codes, bins), 0)
                values.append(np.add.reduceat(ratios.sum(axis=1), starts))
            best = np.argmax(values, axis=0)
            fits[modules, s] = np.max(values, axis=0)
            turns[modules, s] = np.array(ways)[best]
        return fits, turns

    def _likely(self, evidence: Evidence, n_slots: int) -> NDArray[np.bool_]:
        """Mark the slots surrounded by the sensors that are most similar to each module."""
        usable = evidence.usable
        radius = evidence.reach + self.mounting.pitch
        around = cdist(self.mounting.middles[:n_slots], evidence.positions) <= radius
        weights = around * usable
        similar = np.zeros((len(self._members), len(usable)))
        for m, inside in enumerate(self._members):
            if usable[inside].any():
                similar[m] = evidence.similarity[inside[usable[inside]]].mean(axis=0)
            similar[m, inside] = 0
        votes = similar @ weights.T / np.maximum(weights.sum(axis=1), MIN_TESTED)
        middles, spacing = self.mounting.middles, evidence.falloff.spacing
        away = cdist(middles[self._slot], middles[:n_slots])
        near = (away > 0) & (away < MIN_DISPLACEMENT * spacing)
        near[:, : len(self._slot)] = False  # adjacent modules may be exchanged
        votes[near] = -np.inf
        rank = np.argsort(np.argsort(-votes, axis=1, kind="stable"), axis=1, kind="stable")
        likely = rank < _N_SLOTS
        stay = np.flatnonzero(self._slot < n_slots)
        likely[stay, self._slot[stay]] = True
        return np.asarray(likely & self._tested[:, None])

    def _reassign(self, evidence: Evidence, *, free: bool) -> None:
        """Assign modules to slots, optionally free ones, and make the changes that hold."""
        n_modules = len(self._slot)
        n_slots = len(self.mounting.frames) if free else n_modules
        wanted = np.zeros((n_modules, len(self.mounting.frames)), bool)
        wanted[:, :n_slots] = self._likely(evidence, n_slots)
        fits, turns = self._fits(evidence, wanted)
        modules = np.arange(n_modules)
        fits[modules, self._slot] += 2 * MIN_GAIN
        fits[:, n_modules:] -= MIN_GAIN
        fits[modules[~self._tested], self._slot[~self._tested]] = -_NONE
        new = linear_sum_assignment(-fits)[1]
        changed = {m: int(new[m]) for m in np.flatnonzero(new != self._slot).tolist()}
        own = fits[modules, self._slot]
        there = fits[:, self._slot] - own[:, None]
        both = np.triu(there + there.T, 1)
        best = np.argsort(-both, axis=None)[: np.count_nonzero(both > 0)]
        pairs = np.column_stack(np.unravel_index(best, both.shape)).tolist()
        tried = [{a: int(self._slot[b]), b: int(self._slot[a])} for a, b in pairs]
        tried += [{m: changed[m] for m in chain} for chain in _chains(changed, self._slot)]
        if free:
            there, expected = bonds(evidence, self.mounting).sum(axis=2)
            lost = (there <= -AGREEING * expected)[:, None] & (fits > _NONE)
            gains = np.where(lost, fits - own[:, None], 0)
            gains[:, :n_modules] = 0
            best = np.argsort(-gains, axis=None)[: np.count_nonzero(gains > MIN_GROUP_GAIN)]
            tried += [{m: s} for m, s in zip(*np.unravel_index(best, gains.shape), strict=True)]
        moved: set[int] = set()
        for target in tried:
            if not moved & set(target):
                placed = [(int(m), int(s), int(turns[m, s])) for m, s in target.items()]
                if self._accept(placed):
                    moved.update(target)

    def _reverse(self, evidence: Evidence) -> None:
        """Reverse the order of the row of modules with the greatest gain, if it is certain."""
        sensors = np.concatenate(self._members)
        kept = evidence.usable[sensors]
        pads, sensors = np.concatenate(self.mounting.pads)[kept], sensors[kept]
        module = self.mounting.owner[sensors]
        n_modules, n_pads = len(self._members), self.mounting.seats.shape[1]
        at = self.mounting.seats[:n_modules].reshape(-1, evidence.positions.shape[1])
        falloff = evidence.falloff
        between = falloff.bins(cdist(at, at))
        stated = falloff.bins(cdist(at, evidence.positions[sensors]))
        codes = evidence.codes[np.ix_(sensors, sensors)]
        before = evidence.ratios[np.ix_(sensors, sensors)]
        of_module = np.eye(n_modules, dtype=np.float32)[module]
        best, row = MIN_GROUP_GAIN, range(0)
        for middle in range(MIN_RUN - 1, 2 * n_modules - MIN_RUN):
            low, high = max(0, middle - n_modules + 1), min(middle, n_modules - 1)
            inside = np.flatnonzero((module >= low) & (module <= high))
            place = (middle - module[inside]) * n_pads + pads[inside]
            one = falloff.ratio(codes[inside], stated[place]) - before[inside]
            within = np.ix_(inside, inside)
            two = falloff.ratio(codes[within], between[np.ix_(place, place)]) - before[within]
            own = of_module[inside, low : high + 1]
            apart, both = own.T @ one[:, inside] @ own, own.T @ two @ own
            total = own.T @ one.sum(axis=1)
            for skipped in range((high - low + 1 - MIN_RUN) // 2 + 1):
                if middle == n_modules - 1 and 2 * (high - low + 1 - 2 * skipped) > n_modules:
                    continue  # a symmetric layout is its own image in reverse order
                run = slice(skipped, high - low + 1 - skipped)
                gain = total[run].sum() - apart[run, run].sum() + both[run, run].sum() / 2
                if gain > best:
                    best, row = gain, range(low + skipped, high + 1 - skipped)
        self._accept([(m, row[0] + row[-1] - m, 0) for m in row if 2 * m != row[0] + row[-1]])

    def _accept(self, placed: list[tuple[int, int, int]]) -> bool:
        """Place modules as proposed if the gain is certain; return whether they were placed."""
        if not placed:
            return False
        evidence, move = self._arranged(), self._move(placed)
        if not self._judge.certainly_gains(evidence, move):
            return False
        held = set(self._slot.tolist())
        if any(slot not in held for _, slot, _ in placed):
            # A free place must be correct by all criteria. A module that agrees with adjacent
            # modules is not moved.
            lost = not border(evidence, self.mounting, [m for m, _, _ in placed]) > -AGREEING
            if not (lost and self._judge.weigh(evidence, move, group=True, free=True).holds):
                return False
        for m, slot, turn in placed:
            self._slot[m], self._turn[m] = slot, turn
        return True

    def _move(self, moved: list[tuple[int, int, int]]) -> Move:
        sensors = np.concatenate([self._members[m] for m, _, _ in moved])
        return Move(sensors, np.concatenate([self.mounting.places(*one) for one in moved]))

    def _changes(self) -> tuple[Evidence, list[Change]]:
        """Undo the changes that do not hold, the weakest first, and return the others."""
        own = np.arange(len(self._slot))
        self._falloff = self._arranged().refitted().falloff
        while True:
            evidence = self._arranged()
            changed = {m: int(self._slot[m]) for m in np.flatnonzero(self._slot != own).tolist()}
            groups = [tuple(chain) for chain in _chains(changed, own)]
            groups += [(m,) for m in np.flatnonzero(self._turn != 0).tolist() if m not in changed]
            found = self._as_groups(evidence, [self._weighed(evidence, one) for one in groups])
            found = self._as_rows(evidence, found)
            # Modules that agree with no adjacent module are elsewhere, in any orientation.
            there, expected = bonds(evidence, self.mounting).sum(axis=2)
            wrong = []
            for one in found:
                some = list(one.modules)
                beside = there[some].sum() >= _BESIDE * expected[some].sum()
                if one.slots != one.modules and not one.row:  # correct ones beside wrong ones
                    beside = bool((there[some] >= AGREEING * expected[some]).all())
                if not set(one.slots) <= set(some):
                    # On bodies cut open, a module also fits beside others across the cut.
                    before = evidence.moved(Move(one.move.sensors, one.stated))
                    against = np.delete(bonds(before, self.mounting)[0][some], some, axis=1)
                    beside &= -np.minimum(against, 0).sum() >= one.verdict.gain / 2
                tested = one.row or self._tested[some].all()
                if not (one.verdict.holds and beside and tested):
                    wrong.append(one)
            if not wrong:
                return evidence, found
            untested = [one for one in wrong if not self._tested[list(one.modules)].any()]
            weakest = min(untested or wrong, key=lambda one: one.verdict.z)
            for m in weakest.modules:
                self._slot[m], self._turn[m] = m, 0

    def _weighed(self, evidence: Evidence, group: tuple[int, ...]) -> Change:
        """Weigh a change against the stated places, with all other changes made."""
        back = self._move([(m, m, 0) for m in group])
        before = evidence.moved(back)
        move = self._move([(m, int(self._slot[m]), int(self._turn[m])) for m in group])
        slots = tuple(int(self._slot[m]) for m in group)
        free = not set(slots) <= set(group)
        in_place = slots == group
        verdict = self._judge.weigh(
            before, move, group=True, free=free, few=not free, in_place=in_place
        )
        turned = tuple(int(self._turn[m]) for m in group)
        return Change(group, slots, turned, back.places, move, verdict)

    def _as_groups(self, evidence: Evidence, changes: list[Change]) -> list[Change]:
        """Give equal flips of adjacent modules, a single fault, their common certainty.

        Each must still gain enough separately.
        """
        found = list(changes)
        for group in alike(changes, self.mounting):
            sensors = np.concatenate([changes[i].move.sensors for i in group])
            stated = np.concatenate([changes[i].stated for i in group])
            move = Move(sensors, evidence.positions[sensors])
            gain, z = self._judge.gain(evidence.moved(Move(sensors, stated)), move)
            for i in group if gain >= MIN_GROUP_GAIN and z >= MIN_Z else []:
                better = replace(changes[i].verdict, z=max(z, changes[i].verdict.z))
                found[i] = replace(changes[i], verdict=better)
        return found

    def _as_rows(self, evidence: Evidence, changes: list[Change]) -> list[Change]:
        """Join the exchanges that reverse a row of modules, a single fault; each is reported.

        Modules at the end of a row may agree with no adjacent module, and some may be silent.
        """
        pairs = {
            (min(one.modules), max(one.modules)): one
            for one in changes
            if len(one.modules) == 2 and one.slots == one.modules[::-1] and one.verdict.told
        }
        rows: dict[tuple[int, int], tuple[int, ...]] = {}
        for a, b in sorted(pairs, key=lambda pair: pair[1] - pair[0]):
            inner = rows.get((a + 1, b - 1), ())
            if len(inner) == (b - a - 1) // 2 * 2:  # up to the centre
                rows.pop((a + 1, b - 1), None)
                rows[a, b] = (a, *inner, b)
        found = list(changes)
        for row in rows.values():
            if len(row) >= MIN_RUN:
                one = self._weighed(evidence, row)
                found = [other for other in found if not set(other.modules) <= set(row)]
                found.append(replace(one, verdict=replace(one.verdict, agrees=True)))
        return found


def alike(changes: Sequence[Change], mounting: Mounting) -> list[list[int]]:
    """Group the changes of modules at their own places by patches with a common fault."""
    alone = [i for i, one in enumerate(changes) if one.slots == one.modules and not one.together]
    if not alone:
        return []
    modules = [changes[i].modules[0] for i in alone]
    faults = np.zeros((len(alone), 3))
    for fault, i, m in zip(faults, alone, modules, strict=True):
        way, frame = mounting.orientations[changes[i].turns[0]], mounting.frames[m]
        # In space, adjacent modules have the same outer side.
        hand = float(np.sign(np.linalg.det(frame))) if len(frame) == 2 else 1.0
        fault[:] = way.reflected, 0 if way.reflected else round(hand * way.angle), way.backwards
    same = (faults[:, None] == faults).all(axis=2) & mounting.adjacent[np.ix_(modules, modules)]
    label = linked_labels(same)
    return [[alone[i] for i in np.flatnonzero(label == k)] for k in np.unique(label)]


def _chains(target: Mapping[int, int], slot: NDArray[np.intp]) -> list[list[int]]:
    """Divide modules with other targets into chains, in which each has the place of the next."""
    holder = {s: m for m, s in enumerate(slot.tolist())}
    return chains({m: holder.get(s, -1) for m, s in target.items() if s != slot[m]})
