"""Proposals that sensors have other places: those of others, or places that no sensor has yet.

Each function takes the evidence and returns the proposals that it finds best, whatever their gain,
so that their gains on shifted readings give the null distribution. To add a kind of fault, add one
function here and one line to `PROPOSERS`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment, minimize
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from anisomap.numerics.layout.congruence import Symmetry, congruent, symmetries
from anisomap.numerics.layout.evidence import MIN_GAIN, Evidence, Move, PlaceFits, Proposal
from anisomap.numerics.procrustes import rotations

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

    members: Sensors of each module, in the order of its pads.
    symmetries: Of each module: see `anisomap.numerics.layout.congruence.symmetries`.
    alike: Modules of the same shape, which can be exchanged pad by pad.
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
            gains = fits.gains(i, partners) + fits.gains(partners, i)
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


Proposer: TypeAlias = Callable[[Evidence, ModuleShapes], list[Proposal]]

PROPOSERS: tuple[Proposer, ...] = (exchanges, turns, cable_shifts, cycles, swaps)
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


_MIN_DISPLACEMENT = 3.0  # spacings: contacts of unequal reach pull patches by up to 2.5 spacings
_MIN_GAP = 0.5  # spacings between sensors of a moved patch and others, which are not in its way
_MAX_IN_THE_WAY = 0.2  # share of a patch that may come nearer: others may be wrong, too

_MIN_PATCH = 3  # sensors, which have an orientation
_MIN_RATIO = 2.0  # nats by which a link must favour its distance over a large one; by hand
_STRETCHED = 3.5  # spacings; larger than the distance of second neighbours; chosen by hand
_REACH_BIN = 3  # bin of 2.25 to 2.75 spacings: pairs that are more similar should be neighbours
_VOTE_RADIUS = 1.5  # spacings within which votes for a translation agree; chosen by hand
_MAX_MODES = 6  # translations that are tried
_MAX_SWEEPS = 40
_N_STARTS = 3  # best translations that are refined; chosen by hand
_MAX_TRIED = 60  # sensors of a patch that propose translations
_MAX_SHARE = 0.5  # of the sensors: a patch is smaller than what it is placed against
_MAX_EVALUATIONS = 150  # per refinement
_PRECISION = 0.05  # spacings; smaller than the distances of the falloff's bins


def patches(evidence: Evidence) -> list[NDArray[np.intp]]:
    """Divide sensors into patches that neighbours with similar readings hold together."""
    return _held_together(evidence, np.flatnonzero(evidence.usable))


def without_smaller_patches(evidence: Evidence, move: Move) -> Evidence:
    """Return the evidence of the moved sensors, and of patches that are no smaller than they are.

    Similarities to a smaller patch are explained as well if that one is at a wrong place.
    """
    usable = np.zeros_like(evidence.usable)
    for patch in patches(evidence):
        usable[patch] = len(patch) >= len(move.sensors)
    usable[move.sensors] = evidence.usable[move.sensors]
    return replace(evidence, usable=usable)


def is_possible(evidence: Evidence, move: Move) -> bool:
    """Return whether a patch moves far enough, to where no other sensors are."""
    spacing = evidence.falloff.spacing
    distance = np.linalg.norm(move.places - evidence.positions[move.sensors], axis=1)
    others = np.ones(len(evidence.positions), dtype=bool)
    others[move.sensors] = False
    nearest = KDTree(evidence.positions[others & evidence.usable]).query(move.places)[0]
    in_the_way = float(np.mean(nearest < _MIN_GAP * spacing))
    return bool(
        np.median(distance) >= _MIN_DISPLACEMENT * spacing and in_the_way <= _MAX_IN_THE_WAY
    )


def _held_together(evidence: Evidence, sensors: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Divide sensors into groups connected by near pairs with similar readings."""
    places = evidence.positions[sensors]
    distances = cdist(places, places)
    similarity = evidence.similarity[np.ix_(sensors, sensors)]
    falloff = evidence.falloff
    bins = falloff.bins(distances)
    far = np.full_like(bins, len(falloff.level) - 1)
    ratio = falloff.log_likelihood(similarity, bins) - falloff.log_likelihood(similarity, far)
    near = (distances <= evidence.reach) & (ratio > _MIN_RATIO) & (similarity > 0)
    graph: Any = csr_array(near)
    label = connected_components(graph, directed=False)[1]
    groups = [sensors[label == k] for k in range(int(label.max(initial=-1)) + 1)]
    return sorted(groups, key=lambda group: (-len(group), int(group[0])))


def patch_moves(evidence: Evidence, modules: ModuleShapes) -> list[Proposal]:
    """Propose the best place of each patch of three and more sensors, moved as a whole."""
    apart = [patch for patch in patches(evidence)[1:] if len(patch) >= _MIN_PATCH]
    return _rigid_moves(evidence, apart) + _translated(evidence)


def single_moves(evidence: Evidence, modules: ModuleShapes) -> list[Proposal]:
    """Propose the best place of single sensors, and of two.

    Candidates agree with no neighbour, or fit a place that is not near theirs better.
    """
    small = [patch for patch in patches(evidence)[1:] if len(patch) < _MIN_PATCH]
    least = _MIN_DISPLACEMENT * evidence.falloff.spacing
    better = np.flatnonzero(PlaceFits(evidence).best_gains(least) >= MIN_GAIN)
    apart = {i for patch in small for i in patch.tolist()}
    single = [np.array([i]) for i in better.tolist() if i not in apart]
    return _rigid_moves(evidence, small + single)


def _rigid_moves(evidence: Evidence, groups: list[NDArray[np.intp]]) -> list[Proposal]:
    largest = _MAX_SHARE * np.count_nonzero(evidence.usable)
    found = [_best_place(evidence, patch) for patch in groups if len(patch) <= largest]
    return [proposal for proposal in found if proposal is not None]


def _translated(evidence: Evidence) -> list[Proposal]:
    """Propose patches that one translation brings near the sensors similar to them.

    Pairs that are similar but far apart vote for the translation between them. For each of the
    translations with most votes, sensors join or leave the patch as long as that raises the
    log-likelihood: iterated conditional modes, Besag (1986), Journal of the Royal Statistical
    Society B 48: 259-302.
    """
    voters, offsets = _stretched_pairs(evidence)
    largest = _MAX_SHARE * np.count_nonzero(evidence.usable)
    proposals = []
    for offset in _modes(offsets, evidence.falloff.spacing):
        close = np.linalg.norm(offsets - offset, axis=1) <= _VOTE_RADIUS * evidence.falloff.spacing
        grown = _grown(evidence, offset, np.unique(voters[close]))
        proposals += [
            _refined(evidence, patch, offset)
            for patch in _held_together(evidence, grown)
            if _MIN_PATCH <= len(patch) <= largest
        ]
    return proposals


def _stretched_pairs(evidence: Evidence) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return sensors, and the vectors to similar ones that are not near them."""
    voters: list[int] = []
    vectors = [np.empty((0, evidence.positions.shape[1]))]
    for i in np.flatnonzero(evidence.usable).tolist():
        similar = evidence.similar(i)
        vector = evidence.positions[similar] - evidence.positions[i]
        far = np.linalg.norm(vector, axis=1) > _STRETCHED * evidence.falloff.spacing
        far &= evidence.similarity[i, similar] > evidence.falloff.level[_REACH_BIN]
        voters += [i] * int(np.count_nonzero(far))
        vectors.append(vector[far])
    return np.array(voters, dtype=np.intp), np.concatenate(vectors)


def _modes(offsets: NDArray[np.float64], spacing: float) -> list[NDArray[np.float64]]:
    """Return the means of the largest clusters of vectors."""
    left = offsets
    found: list[NDArray[np.float64]] = []
    while len(found) < _MAX_MODES and len(left):
        tree = KDTree(left)
        near: Any = tree.query_ball_point(left, _VOTE_RADIUS * spacing)
        largest: list[int] = max(near, key=len)
        if len(largest) < _MIN_PATCH:
            break
        mode = left[largest].mean(axis=0)
        found.append(mode)
        left = left[np.linalg.norm(left - mode, axis=1) > 2 * _VOTE_RADIUS * spacing]
    return found


def _grown(
    evidence: Evidence, offset: NDArray[np.float64], first: NDArray[np.intp]
) -> NDArray[np.intp]:
    """Grow or shrink a patch that is translated, until no sensor gains by joining or leaving."""
    everyone = np.arange(len(evidence.positions))
    # Pairs of which the first is translated, and the second is not.
    apart = evidence.likelihood_at(everyone, evidence.positions + offset)
    together = evidence.likelihood
    inside = np.zeros(len(everyone), dtype=bool)
    inside[first] = True
    for _ in range(_MAX_SWEEPS):
        joined = (together - apart.T)[:, inside].sum(axis=1)
        joined += (apart - together)[:, ~inside].sum(axis=1)
        flips = np.where(inside, -joined, joined)
        wrong = np.flatnonzero((flips > 0) & evidence.usable)
        if not wrong.size:
            break
        # Half of them at a time: neighbours that all flip at once would flip back.
        worst = wrong[np.argsort(-flips[wrong], kind="stable")]
        chosen = worst[: -(-len(worst) // 2)]
        inside[chosen] = ~inside[chosen]
    return np.flatnonzero(inside)


def _best_place(evidence: Evidence, patch: NDArray[np.intp]) -> Proposal | None:
    starts = []
    inside = np.zeros(len(evidence.positions), dtype=bool)
    inside[patch] = True
    here = evidence.positions[patch]
    for i in patch[:: -(-len(patch) // _MAX_TRIED)].tolist():
        similar = evidence.similar(i)
        outside = similar[~inside[similar]]
        if not outside.size:
            continue
        offsets = list(evidence.positions[outside[:2]] - evidence.positions[i])
        weights = np.maximum(evidence.similarity[i, outside], 1e-6)
        middle = np.average(evidence.positions[outside], axis=0, weights=weights)
        offsets.append(middle - evidence.positions[i])
        starts += offsets
    before = evidence.likelihood_at(patch, here)
    tried = [(evidence.gain(Move(patch, here + offset), before), offset) for offset in starts]
    tried.sort(key=lambda pair: -pair[0])
    refined = [_refined(evidence, patch, offset) for _, offset in tried[:_N_STARTS]]
    return max(refined, key=lambda proposal: proposal.gain) if refined else None


def _refined(evidence: Evidence, patch: NDArray[np.intp], offset: NDArray[np.float64]) -> Proposal:
    """Refine a translation, and the rotation of three and more sensors, from a first guess."""
    here = evidence.positions[patch]
    spacing, dimensions = evidence.falloff.spacing, here.shape[1]
    centre = here.mean(axis=0)
    radius = max(float(np.linalg.norm(here - centre, axis=1).max()), spacing)
    n_angles = 0 if len(patch) < _MIN_PATCH else 1 if dimensions == 2 else 3

    before = evidence.likelihood_at(patch, here)

    def placed(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        moved = here - centre
        if len(parameters) > dimensions:
            # A step of 1 in every parameter moves the outermost sensor by about a spacing.
            angles = parameters[dimensions:] * spacing / radius
            moved = moved @ rotations(angles[None])[0].T
        return np.asarray(moved + centre + parameters[:dimensions] * spacing)

    def loss(parameters: Any) -> float:
        return -evidence.gain(Move(patch, placed(parameters)), before)

    def fit(start: NDArray[np.float64]) -> Proposal:
        options: Any = {
            "initial_simplex": np.vstack([start, start + np.eye(len(start))]),
            "xatol": _PRECISION,
            "maxfev": _MAX_EVALUATIONS,
        }
        found: Any = minimize(loss, start, method="Nelder-Mead", options=options)
        return Proposal(-float(found.fun), Move(patch, placed(found.x)))

    translated = fit(offset / spacing)
    if not n_angles:
        return translated
    turned = fit(np.concatenate([offset / spacing, np.zeros(n_angles)]))
    return turned if turned.gain > translated.gain + MIN_GAIN else translated
