"""Proposals that sensors change places: swaps, turned and exchanged modules, shifted cables.

Each function takes the evidence and returns the proposals that it finds best, whatever their gain,
so that their gains on shifted readings give the null distribution. To add a kind of fault, add one
function here and one line to `PROPOSERS`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import KDTree

from anisomap.numerics.layout.congruence import Symmetry, congruent, symmetries
from anisomap.numerics.layout.evidence import Evidence, Move, Proposal
from anisomap.numerics.layout.place_fits import MIN_GAIN, PlaceFits

_N_SLOTS = 6  # modules whose place another module may have; chosen by hand
_MIN_VOTES = 0.8  # for the place of another module, relative to its own; chosen by hand
_N_OUTSIDE = 3  # most similar sensors of other modules that vote for a place; chosen by hand
_STEPS = (1, -1, 2, -2)  # channels by which a cable may be shifted
_MIN_RUN = 4  # consecutive channels; fewer are swaps and cycles
_MAX_SUSPECTS = 200  # sensors that may be in cycles, the worst first
_N_RUNS = 5  # runs of each step that are evaluated exactly; chosen by hand


@dataclass(frozen=True, eq=False)
class ModuleShapes:
    """Groups of sensors that were mounted together.

    Attributes
    ----------
    members : tuple of ndarray of int
        Sensors of each module, in the order of its pads.
    symmetries : tuple of tuple of Symmetry
        Of each module: see `anisomap.numerics.layout.congruence.symmetries`.
    alike : ndarray of bool, shape (M, M)
        Modules of the same shape, which can be exchanged pad by pad.
    """

    members: tuple[NDArray[np.intp], ...]
    symmetries: tuple[tuple[Symmetry, ...], ...]
    alike: NDArray[np.bool_]

    @classmethod
    def of(
        cls, members: Sequence[NDArray[np.intp]], positions: NDArray[np.float64]
    ) -> ModuleShapes:
        """Describe modules, given the sensors of each and the positions of all, (n, k)."""
        shapes = [positions[inside] for inside in members]
        alike = np.array(
            [[congruent(one, other) for other in shapes] for one in shapes], dtype=bool
        ).reshape(len(members), len(members))
        return cls(tuple(members), tuple(symmetries(shape) for shape in shapes), alike & alike.T)


def swaps(evidence: Evidence, modules: ModuleShapes) -> list[Proposal]:
    """Propose the best exchange of each sensor with one other, by the readings of both."""
    return _swaps(evidence, evidence.usable)


def half_swaps(evidence: Evidence, modules: ModuleShapes) -> list[Proposal]:
    """Propose the best exchange of each sensor with one of which the readings say nothing."""
    return _swaps(evidence, ~evidence.usable)


def _swaps(evidence: Evidence, allowed: NDArray[np.bool_]) -> list[Proposal]:
    fits = PlaceFits(evidence)
    proposals = []
    for i in np.flatnonzero(evidence.usable).tolist():
        partners = fits.places_near(i)
        partners = partners[allowed[partners]]
        if partners.size:
            gains = fits.gains(i, partners) + fits.gains_at(i, partners)
            best = int(gains.argmax())
            pair = np.array([i, partners[best]])
            places = evidence.positions[pair[::-1]]
            proposals.append(Proposal(float(gains[best]), Move(pair, places)))
    return proposals


def cycles(evidence: Evidence, modules: ModuleShapes) -> list[Proposal]:
    """Propose cycles of sensors that each have the place of the next.

    Sensors that fit another place better than their own are assigned to each other's places.
    """
    fits = PlaceFits(evidence)
    best = fits.best_gains()
    suspects = np.argsort(-best, kind="stable")[:_MAX_SUSPECTS]
    suspects = np.sort(suspects[best[suspects] >= MIN_GAIN])
    if not suspects.size:
        return []
    gains = np.stack([fits.gains(i, suspects) for i in suspects.tolist()])
    np.fill_diagonal(gains, 0.0)
    assigned = linear_sum_assignment(-gains)[1]
    proposals = []
    left = set(range(len(suspects)))
    while left:
        cycle = [left.pop()]
        while (following := int(assigned[cycle[-1]])) != cycle[0]:
            cycle.append(following)
            left.discard(following)
        if len(cycle) > 1:
            sensors = suspects[cycle]
            move = Move(sensors, evidence.positions[np.roll(sensors, -1)])
            proposals.append(Proposal(evidence.gain(move), move))
    return proposals


def turns(evidence: Evidence, modules: ModuleShapes) -> list[Proposal]:
    """Propose the best rotation or reflection of each module on its own places."""
    proposals = []
    for members, images in zip(modules.members, modules.symmetries, strict=True):
        moves = turned_moves(evidence.positions, members, images)
        if moves:
            proposals.append(replace(_best(evidence, moves), alternatives=moves))
    return proposals


def turned_moves(
    positions: NDArray[np.float64], members: NDArray[np.intp], images: Sequence[Symmetry]
) -> tuple[Move, ...]:
    """Return the moves of a module onto its own places, one for each symmetry."""
    return tuple(Move(members, positions[members][image.order]) for image in images)


def exchanges(evidence: Evidence, modules: ModuleShapes) -> list[Proposal]:
    """Propose the best exchange of each module with another of its shape, in any orientation."""
    label = np.full(len(evidence.positions), -1)
    for k, members in enumerate(modules.members):
        label[members] = k
    nearby = KDTree(evidence.positions)
    proposals = []
    for k, members in enumerate(modules.members):
        votes: Counter[int] = Counter()
        for i in members[evidence.usable[members]].tolist():
            row = np.where(evidence.usable & (label != k), evidence.similarity[i], -np.inf)
            for j in np.argsort(-row, kind="stable")[:_N_OUTSIDE].tolist():
                around = nearby.query_ball_point(evidence.positions[j], evidence.reach)
                votes.update(set(label[around].tolist()))
        slots = [
            m
            for m, count in votes.most_common()
            if m not in (-1, k) and modules.alike[k, m] and count >= _MIN_VOTES * votes[k]
        ]
        found = [_exchange(evidence, modules, k, m) for m in slots[:_N_SLOTS]]
        if found:
            proposals.append(max(found, key=lambda proposal: proposal.gain))
    return proposals


def cable_shifts(evidence: Evidence, modules: ModuleShapes) -> list[Proposal]:
    """Propose the best run of consecutive sensors that have each other's places, shifted.

    The gain of every run is the sum of its gains by pair, from two-dimensional cumulative sums.
    """
    n_sensors = len(evidence.positions)
    everyone = np.arange(n_sensors)
    proposals = []
    for step in _STEPS:
        if n_sensors < _MIN_RUN + abs(step):
            continue
        places = np.roll(evidence.positions, -step, axis=0)
        outside = evidence.likelihood_at(everyone, places) - evidence.likelihood
        inside = evidence.moved(Move(everyone, places)).likelihood - evidence.likelihood
        # Of the run a to b: gains to all sensors, less those inside, which move, too.
        single = np.concatenate([[0.0], outside.sum(axis=1).cumsum()])
        within = np.zeros((n_sensors + 1, n_sensors + 1))
        within[1:, 1:] = (inside / 2 - outside).cumsum(axis=0).cumsum(axis=1)
        start, stop = np.triu_indices(n_sensors + 1, _MIN_RUN)
        gains = single[stop] - single[start]
        gains += within[stop, stop] - within[start, stop] - within[stop, start]
        gains += within[start, start]
        best = np.argsort(-gains, kind="stable")[:_N_RUNS]
        found = _best(
            evidence,
            [_closed_run(evidence, int(start[k]), int(stop[k]), step) for k in best],
        )
        alternatives = shifted_moves(evidence.positions, found.move.sensors)
        proposals.append(replace(found, alternatives=alternatives))
    return proposals


def shifted_moves(positions: NDArray[np.float64], run: NDArray[np.intp]) -> tuple[Move, ...]:
    """Return the moves of a run of sensors to each other's places, one for each step."""
    return tuple(Move(run, np.roll(positions[run], -step, axis=0)) for step in _STEPS)


PROPOSERS: Mapping[str, Callable[[Evidence, ModuleShapes], list[Proposal]]] = MappingProxyType(
    {
        "exchanges": exchanges,
        "turns": turns,
        "cable shifts": cable_shifts,
        "cycles": cycles,
        "swaps": swaps,
    }
)
"""All functions that propose permutations of places."""


def _best(evidence: Evidence, moves: Sequence[Move]) -> Proposal:
    return max(
        (Proposal(evidence.gain(move), move) for move in moves), key=lambda proposal: proposal.gain
    )


def _exchange(evidence: Evidence, modules: ModuleShapes, first: int, second: int) -> Proposal:
    """Exchange two modules: each in the orientation that is best given the others, together."""
    one, two = modules.members[first], modules.members[second]
    outside = np.ones(len(evidence.positions), dtype=bool)
    outside[one] = outside[two] = False
    chosen = []
    for sensors, slot, images in (
        (one, two, modules.symmetries[second]),
        (two, one, modules.symmetries[first]),
    ):
        places = [evidence.positions[slot]]
        places += [evidence.positions[slot][image.order] for image in images]
        fits = [evidence.likelihood_at(sensors, at)[:, outside].sum() for at in places]
        chosen.append(places[int(np.argmax(fits))])
    move = Move(np.concatenate([one, two]), np.concatenate(chosen))
    return Proposal(evidence.gain(move), move)


def _closed_run(evidence: Evidence, start: int, stop: int, step: int) -> Move:
    """Shift the places of a run; sensors at its end take the places that are left over."""
    if step > 0:
        stop = min(stop + step, len(evidence.positions))
    else:
        start = max(start + step, 0)
    run = np.arange(start, stop)
    return Move(run, np.roll(evidence.positions[run], -step, axis=0))
