"""Joint search for the places and orientations of all modules of a layout."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap.layout.borders import AGREEING, border
from anisomap.layout.evidence import MIN_GAIN, Evidence, Move
from anisomap.layout.judging import MIN_GROUP_GAIN, Judge, Verdict
from anisomap.layout.modules import Mounting

MIN_TESTED = 4
"""Least number of tested pads that orient a module; three fitted wrong ones by chance."""

_FAR = 4.0  # spacings between two modules up to which they orient each other; chosen by hand
_MAX_ROUNDS = 12
_N_SWEEPS = 60
_DAMPING = 0.5
_N_SLOTS = 8  # places, beside its own, that a module may have; chosen by hand
_MIN_DISPLACEMENT = 3.0  # spacings to a free place: contacts of unequal reach pull by up to 2.5


Placed: TypeAlias = tuple[int, int, int]
"""A module, its slot and its orientation."""


@dataclass(frozen=True, eq=False)
class Change:
    """Modules at other places, or in another orientation at their own.

    modules: One, or several of which each has the place of the next, or that move together.
    slots, turns: The proposed ones of these modules.
    stated: Places before, (m, k).
    move: From the stated places to the proposed ones.
    second: From the stated places to the second best ones.
    """

    modules: tuple[int, ...]
    slots: tuple[int, ...]
    turns: tuple[int, ...]
    stated: NDArray[np.float64]
    move: Move
    second: Move
    verdict: Verdict
    together: bool = False


class JointSearch:
    """Minimises the energy, the negative log-likelihood, over places and orientations of modules.

    The orientations of all modules together are a Markov random field. Where a whole patch is
    mirrored, no module gains by being turned alone; so the energy is minimised by belief
    propagation (min-sum), and from there by iterated conditional modes. Pearl (1988),
    Probabilistic Reasoning in Intelligent Systems; Besag (1986), JRSS B 48: 259-302.

    evidence: With modules unbent at their stated places.
    """

    def __init__(self, evidence: Evidence, mounting: Mounting, judge: Judge) -> None:
        self._stated, self._mounting, self._judge = evidence, mounting, judge
        self._members = mounting.members
        self._slot, self._turn = np.arange(mounting.n_modules), np.zeros(mounting.n_modules, int)
        usable = evidence.usable
        self._tested = np.array([usable[m].sum() >= MIN_TESTED for m in self._members], bool)
        loose = usable.copy()
        loose[np.concatenate([*self._members, [0][:0]]).astype(np.intp)] = False
        self._loose = np.flatnonzero(loose)

    def run(self) -> tuple[Evidence, list[Change]]:
        """Return the evidence after all changes that hold, and these."""
        if not self._tested.any() or len(self._tested) < 2:
            return self._stated, []
        for _ in range(_MAX_ROUNDS):
            before = np.concatenate([self._slot, self._turn])
            self._orient(self._arranged())
            self._exchange(self._arranged())
            if np.array_equal(before, [*self._slot, *self._turn]):
                break
        return self._changes()

    def unsure(self) -> list[int]:
        """Return the modules that fit another orientation nearly as well."""
        evidence = self._arranged()
        found = []
        for m, inside in enumerate(self._members):
            moves = [
                Move(inside, places)
                for turn, places in enumerate(self._images(m, self._slot[m]))
                if turn != self._turn[m]
            ]
            least = min((-evidence.gain(move) for move in moves), default=np.inf)
            if least < MIN_GAIN:
                found.append(m)
        return found

    def _arranged(self) -> Evidence:
        """Return the evidence with all modules at their present places."""
        positions = self._stated.positions.copy()
        for m, inside in enumerate(self._members):
            positions[inside] = self._places(m, self._slot[m], self._turn[m])
        return replace(self._stated, positions=positions).refitted()

    def _places(self, module: int, slot: int, turn: int) -> NDArray[np.float64]:
        if slot == module and turn == 0:
            return self._stated.positions[self._members[module]]
        return self._mounting.places(module, slot, turn)

    def _images(self, module: int, slot: int) -> NDArray[np.float64]:
        """Return the places of a module in each orientation, (O, m, k)."""
        turns = range(len(self._mounting.orientations))
        return np.stack([self._places(module, slot, turn) for turn in turns])

    def _orient(self, evidence: Evidence) -> None:
        images = [self._images(m, slot) for m, slot in enumerate(self._slot.tolist())]
        field = _Field.of(evidence, self._members, images, self._loose)
        starts = (field.modes(field.propagated()), field.modes(self._turn))
        self._turn = min(starts, key=field.energy)

    def _exchange(self, evidence: Evidence) -> None:
        """Exchange pairs of modules, the best first; without any, move some to free places."""
        fits = {
            (m, slot): self._fit_at(evidence, m, slot)
            for m in np.flatnonzero(self._tested).tolist()
            for slot in self._likely_slots(evidence, m)
        }
        wanted = [key for key, (gain, _) in fits.items() if gain >= MIN_GAIN]
        holder = {int(slot): m for m, slot in enumerate(self._slot)}
        pairs: list[tuple[float, list[Placed]]] = []
        free: list[tuple[float, list[Placed]]] = []
        for m, slot in wanted:
            gain, turn = fits[m, slot]
            if slot not in holder:
                free.append((gain, [(m, slot, turn)]))
                continue
            back = (holder[slot], int(self._slot[m]))
            further, returned = fits.get(back) or self._fit_at(evidence, *back)
            pairs.append((gain + further, [(m, slot, turn), (*back, returned)]))
        if not self._accept(pairs):
            self._accept(free)

    def _accept(self, proposals: list[tuple[float, list[Placed]]]) -> bool:
        """Place modules as proposed, the best first, each once; return whether any was."""
        changed: set[int] = set()
        for gain, placed in sorted(proposals, key=lambda one: -one[0]):
            modules = {m for m, _, _ in placed}
            if gain < MIN_GROUP_GAIN or changed & modules:
                continue
            evidence, move = self._arranged(), self._move(placed)
            holds = evidence.gain(move) >= MIN_GROUP_GAIN
            if holds and len(placed) == 1:
                # A free place is near anything, and must be right by all criteria. A module that
                # agrees with those around it stays.
                m, slot, _ = placed[0]
                elsewhere = not border(evidence, self._members, [m]) > -AGREEING
                turns = range(len(self._mounting.orientations))
                every = [self._move([(m, slot, turn)]) for turn in turns]
                holds = elsewhere and self._judge.weigh(evidence, move, every, rigid=True).holds
            if holds:
                changed |= modules
                for m, slot, turn in placed:
                    self._slot[m], self._turn[m] = slot, turn
        return bool(changed)

    def _likely_slots(self, evidence: Evidence, module: int) -> list[int]:
        """Return the slots around which the sensors are that are most similar to a module."""
        sensors = self._members[module]
        others = evidence.usable.copy()
        others[sensors] = False
        similarity = evidence.similarity[sensors[evidence.usable[sensors]]].mean(axis=0)
        middles, spacing = self._mounting.middles, evidence.falloff.spacing
        radius = evidence.reach + self._mounting.pitch
        near = (cdist(middles, evidence.positions) <= radius) * others
        votes = np.asarray(near @ similarity) / np.maximum(near.sum(axis=1), MIN_TESTED)
        far = np.linalg.norm(middles - middles[module], axis=1) >= _MIN_DISPLACEMENT * spacing
        far[self._slot] = True
        far[self._slot[module]] = False
        slots = np.argsort(np.where(far, -votes, np.inf), kind="stable")[:_N_SLOTS]
        return [int(slot) for slot in slots if far[slot]]

    def _fit_at(self, evidence: Evidence, module: int, slot: int) -> tuple[float, int]:
        """Return the gain of a module in a slot, without the one that is there, and its turn."""
        sensors = self._members[module]
        others = evidence.usable.copy()
        others[sensors] = False
        for m in np.flatnonzero(self._slot == slot).tolist():
            others[self._members[m]] = False
        here = evidence.likelihood_at(sensors, evidence.positions[sensors])[:, others].sum()
        images = self._images(module, slot)
        there = [evidence.likelihood_at(sensors, at)[:, others].sum() for at in images]
        turn = int(np.argmax(there))
        return float(there[turn] - here), turn

    def _move(self, moved: list[Placed]) -> Move:
        sensors = np.concatenate([self._members[m] for m, _, _ in moved])
        return Move(sensors, np.concatenate([self._places(*one) for one in moved]))

    def _changes(self) -> tuple[Evidence, list[Change]]:
        """Undo the changes that do not hold, the weakest first, and return the others."""
        own = np.arange(len(self._slot))
        while True:
            evidence = self._arranged()
            changed = {m: int(self._slot[m]) for m in np.flatnonzero(self._slot != own).tolist()}
            groups = [tuple(chain) for chain in _chains(changed, own)]
            groups += [(m,) for m in np.flatnonzero(self._turn != 0).tolist() if m not in changed]
            found = [self._weighed(evidence, group) for group in groups]
            wrong = [
                one
                for one in found
                if not one.verdict.holds or not self._tested[list(one.modules)].all()
            ]
            if not wrong:
                return evidence, found
            untested = [one for one in wrong if not self._tested[list(one.modules)].any()]
            weakest = min(untested or wrong, key=lambda one: one.verdict.z)
            for m in weakest.modules:
                self._slot[m], self._turn[m] = m, 0

    def _weighed(self, evidence: Evidence, group: tuple[int, ...]) -> Change:
        """Weigh a change against the stated places, with all others as proposed."""
        back = self._move([(m, m, 0) for m in group])
        before = evidence.moved(back)
        turns = range(len(self._mounting.orientations))
        tried = []
        for other in turns:  # each module turned further by the same
            moved = [
                (m, int(self._slot[m]), (int(self._turn[m]) + other) % len(turns)) for m in group
            ]
            tried.append(self._move(moved))
        move, *others = tried
        second = max(others, key=before.gain) if others else move
        slots = tuple(int(self._slot[m]) for m in group)
        rigid = not set(slots) <= set(group)
        in_place = slots == group
        verdict = self._judge.weigh(before, move, tried, rigid=rigid, in_place=in_place)
        turned = tuple(int(self._turn[m]) for m in group)
        return Change(group, slots, turned, back.places, move, second, verdict)


def _chains(target: dict[int, int], slot: NDArray[np.intp]) -> list[list[int]]:
    """Divide modules with other targets into chains, each of which has the place of the next."""
    holder = {int(s): m for m, s in enumerate(slot.tolist())}
    following = {m: holder.get(s, -1) for m, s in target.items() if s != int(slot[m])}
    found: list[list[int]] = []
    left = set(following)
    starts = sorted(left - set(following.values())) + sorted(left)
    for start in starts:
        chain = []
        here = start
        while here in left:
            left.discard(here)
            chain.append(here)
            here = following[here]
        if chain:
            found.append(chain)
    return found


@dataclass(frozen=True, eq=False)
class _Field:
    """A Markov random field of modules with O orientations each.

    alone (M, O): Energy of each module with sensors on no module.
    first, second (E,): Modules of each directed edge; edge e and ``reverse[e]`` are opposite.
    energy_of (E, O, O): Energy of the pairs of sensors of two modules.
    """

    alone: NDArray[np.float64]
    first: NDArray[np.intp]
    second: NDArray[np.intp]
    energies: NDArray[np.float64]

    @classmethod
    def of(
        cls,
        evidence: Evidence,
        members: tuple[NDArray[np.intp], ...],
        images: list[NDArray[np.float64]],
        loose: NDArray[np.intp],
    ) -> _Field:
        """Compute the energies of modules whose sensors, those tested, are at images (O, m, k)."""
        kept = [evidence.usable[inside] for inside in members]
        sensors = [inside[chosen] for inside, chosen in zip(members, kept, strict=True)]
        at = [image[:, chosen] for image, chosen in zip(images, kept, strict=True)]
        n_turns, k = at[0].shape[0], at[0].shape[2]

        def energy(
            m: int, others: NDArray[np.intp], places: NDArray[np.float64]
        ) -> NDArray[np.float64]:
            """Return the energy with others at places (Q, q, k): (O, Q)."""
            distances = cdist(at[m].reshape(-1, k), places.reshape(-1, k))
            shape = (n_turns, len(sensors[m]), len(places), len(others))
            bins = evidence.falloff.bins(distances).reshape(shape)
            similarity = evidence.similarity[np.ix_(sensors[m], others)][None, :, None, :]
            likelihood = evidence.falloff.log_likelihood(similarity, bins)
            return np.asarray(-likelihood.sum(axis=(1, 3)))

        here = evidence.positions[loose][None]
        alone = np.stack([energy(m, loose, here)[:, 0] for m in range(len(members))])
        middle = np.stack([image.mean(axis=(0, 1)) for image in images])
        radius = [
            np.linalg.norm(image - c, axis=2).max() for image, c in zip(images, middle, strict=True)
        ]
        far = _FAR * evidence.falloff.spacing + np.add.outer(radius, radius)
        known = np.array([one.any() for one in kept])
        near = (cdist(middle, middle) <= far) & np.outer(known, known)
        first, second = np.nonzero(np.triu(near, 1))
        pairs = zip(first.tolist(), second.tolist(), strict=True)
        found = [energy(a, sensors[b], at[b]) for a, b in pairs]
        energies = np.array(found).reshape(len(found), n_turns, n_turns)
        return cls(
            alone,
            np.concatenate([first, second]),
            np.concatenate([second, first]),
            np.concatenate([energies, energies.transpose(0, 2, 1)]),
        )

    def energy(self, turns: NDArray[np.intp]) -> float:
        """Return the energy of all modules."""
        pairs = self.energies[np.arange(len(self.first)), turns[self.first], turns[self.second]]
        return float(self.alone[np.arange(len(turns)), turns].sum() + pairs.sum() / 2)

    def propagated(self) -> NDArray[np.intp]:
        """Return the orientations of least energy by belief propagation, (M,)."""
        n_edges = len(self.first)
        reverse = np.roll(np.arange(n_edges), n_edges // 2)
        messages = np.zeros((n_edges, self.alone.shape[1]))

        def beliefs() -> NDArray[np.float64]:
            total = self.alone.copy()
            np.add.at(total, self.second, messages)
            return total

        for _ in range(_N_SWEEPS):
            outgoing = beliefs()[self.first] - messages[reverse]
            sent = (outgoing[:, :, None] + self.energies).min(axis=1)
            sent -= sent.min(axis=1, keepdims=True)
            messages = _DAMPING * messages + (1 - _DAMPING) * sent
        return np.asarray(beliefs().argmin(axis=1))

    def modes(self, turns: NDArray[np.intp]) -> NDArray[np.intp]:
        """Turn the module that gains most, until none gains (iterated conditional modes)."""
        turns = turns.copy()
        modules = np.arange(len(turns))
        for _ in range(10 * len(turns)):
            total = self.alone.copy()
            np.add.at(
                total, self.first, self.energies[np.arange(len(self.first)), :, turns[self.second]]
            )
            gains = total[modules, turns] - total.min(axis=1)
            best = int(gains.argmax())
            if gains[best] <= 0:
                break
            turns[best] = int(total[best].argmin())
        return turns
