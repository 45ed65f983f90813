"""Patches, groups of adjacent modules, that are turned, mirrored or shifted as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import MIN_GAIN, Evidence, Move
from anisomap.layout.judging import MIN_GROUP_GAIN
from anisomap.layout.modules import Mounting
from anisomap.layout.patches import is_possible, refined
from anisomap.numerics.procrustes import fit_similarity

AGREEING = 0.35
"""Least evidence that two modules are adjacent, as a share of what is expected if they are.

In right layouts of the iCub's torso it is 0.5 and more, around a turned patch 0.05 and less, and of
modules that are elsewhere -0.6 and less.
"""

_MAX_SHARE = 0.5  # of the sensors: a patch is smaller than what it is moved against
_N_GROUPS = 8  # the smallest groups that are contradicted
_N_BEST = 3  # patches that are tried
_N_ANGLES = 24  # turns, and as many reflections
_N_LINKS = 40  # most similar pairs of a sensor of a patch and another, which should be near
_NEAR = 2.5  # spacings up to which such pairs are
_N_TRIED = 60  # motions of which the likelihood is computed
_N_REFINED = 3  # of these, the best
_LEAST = 2.0  # spacings by which the median sensor moves
_SAME = 0.6  # spacings of pads: turned patches of bent layouts fit their places less than exactly
_FAR = 3.0  # spacings by which the outermost sensor moves: smaller turns are hardly told


@dataclass(frozen=True, eq=False)
class MovedPatch:
    """A patch at the place that explains the readings best.

    tried: Moves among which it was chosen, the best first.
    second: The best of those that differ from it by more than readings hardly tell.
    """

    modules: tuple[int, ...]
    tried: tuple[Move, ...]
    second: Move

    @property
    def move(self) -> Move:
        """The best move."""
        return self.tried[0]


def moved_patches(evidence: Evidence, mounting: Mounting) -> list[MovedPatch]:
    """Propose patches that fit better turned, mirrored or shifted, the best first."""
    largest = _MAX_SHARE * np.count_nonzero(evidence.usable)
    found = []
    for group in sorted(_contradicted(evidence, mounting), key=len)[:_N_GROUPS]:
        sensors = np.concatenate([mounting.members[m] for m in group])
        if len(sensors) > largest:
            continue
        # Layouts in space are bent: there, patches gain by any small motion.
        moves = _motions(evidence, sensors, shifted=evidence.positions.shape[1] == 2)
        if moves and (gain := evidence.gain(moves[0])) >= MIN_GROUP_GAIN:
            found.append((gain / len(group), group, moves))
    # The one of two groups at a border that gains more for each of its modules is wrong.
    found.sort(key=lambda one: -one[0])
    found = found[:_N_BEST]
    best = [_on_places(evidence, mounting, group, moves) for _, group, moves in found]
    return [patch for patch in best if patch is not None]


def bonds(
    evidence: Evidence, members: Sequence[NDArray[np.intp]]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the evidence that modules are adjacent, and what is expected if they are, (M, M).

    It is the log-likelihood ratio of the similarities of near pads to those of distant pads.

    members: Sensors of each module.
    """
    near = evidence.known & (cdist(evidence.positions, evidence.positions) <= evidence.reach)
    inside = np.zeros((len(members), len(near)))
    for m, sensors in enumerate(members):
        inside[m, sensors] = 1

    def summed(ratios: NDArray[np.float32]) -> NDArray[np.float64]:
        total = inside @ np.where(near, ratios, 0) @ inside.T
        np.fill_diagonal(total, 0)
        return np.asarray(total)

    return summed(evidence.ratios), summed(evidence.falloff.expected[evidence.bins])


def border(
    evidence: Evidence, members: Sequence[NDArray[np.intp]], modules: Sequence[int]
) -> float:
    """Return the evidence that some modules are beside the others, over what is expected.

    It is about 1 if they are, and about -1 if they are elsewhere; NaN without any others near.
    """
    found, expected = (
        float(np.delete(one[list(modules)], modules, axis=1).sum())
        for one in bonds(evidence, members)
    )
    return found / expected if expected > 0 else float("nan")


def unsure_patches(evidence: Evidence, mounting: Mounting) -> list[list[int]]:
    """Return the patches apart from a larger one that fit nearly as well turned or mirrored."""
    if mounting.n_modules < 2:
        return []
    graph: Any = csr_array(mounting.adjacent)
    n_groups, label = connected_components(graph, directed=False)
    groups = [np.flatnonzero(label == k).tolist() for k in range(n_groups)]
    least = _FAR * evidence.falloff.spacing
    found = []
    for group in sorted(groups, key=lambda one: -len(one))[1:]:
        sensors = np.concatenate([mounting.members[m] for m in group])
        here = evidence.positions[sensors]
        far = [places for places in _turns(here) if _farthest(places, here) > least]
        gains = [evidence.gain(Move(sensors, places)) for places in far]
        if len(group) > 1 and max(gains, default=-np.inf) > -MIN_GAIN:
            found.append(group)
    return found


def _contradicted(evidence: Evidence, mounting: Mounting) -> list[list[int]]:
    """Return the groups of modules that agree with each other, but with none around them.

    Greedy additive edge contraction: Keuper et al. (2015), ICCV, 1751-1759.
    """
    found, expected = bonds(evidence, mounting.members)
    weights = found - AGREEING * expected
    groups = [[m] for m in range(mounting.n_modules)]
    contradicted = []
    while len(groups) > 1:
        np.fill_diagonal(weights, -np.inf)
        a, b = sorted(map(int, np.unravel_index(weights.argmax(), weights.shape)))
        if weights[a, b] <= 0:
            break
        groups[a] = sorted(groups[a] + groups.pop(b))
        weights[a] += weights[b]
        weights[:, a] = weights[a]
        weights = np.delete(np.delete(weights, b, 0), b, 1)
        if np.delete(found[groups[a]], groups[a], axis=1).sum() < 0:
            contradicted.append(groups[a])
    return contradicted


def _beside(evidence: Evidence, mounting: Mounting, modules: list[int], move: Move) -> list[Move]:
    """Return motions near one after which a module is beside others exactly as these are."""
    rest = [m for m in range(mounting.n_modules) if m not in modules]
    others = mounting.part(rest).with_free_slots(
        np.delete(evidence.positions, move.sensors, axis=0)
    )
    ends = np.cumsum([len(mounting.members[m]) for m in modules])[:-1]
    ways = [one.places for one in mounting.orientations if one.fits and not one.backwards]
    found = []
    for m, there in zip(modules, np.split(move.places, ends), strict=True):
        for slot in range(len(rest), len(others.frames)):
            frame, centre = others.frames[slot, :2], others.centres[slot]
            for places in ways:
                at = places[mounting.pads[m]] @ frame + centre
                if np.sqrt(((at - there) ** 2).sum(axis=1).mean()) <= _SAME * mounting.pitch:
                    fit = fit_similarity(there, at, scaling=False, reflection=False)
                    found.append(Move(move.sensors, fit.apply(move.places)))
    return found


def _motions(evidence: Evidence, sensors: NDArray[np.intp], *, shifted: bool = True) -> list[Move]:
    """Return the motions of a patch to where no other sensors are, the best first.

    Turned and mirrored about its middle, it stays, or, if it may be shifted, moves such that
    similar sensors are near.
    """
    here = evidence.positions[sensors]
    kept = evidence.usable[sensors]
    others = evidence.usable.copy()
    others[sensors] = False
    outside = np.flatnonzero(others)
    if not kept.any() or not outside.size:
        return []
    turned_places = _turns(here)
    moves = [Move(sensors, turned) for turned in turned_places]
    if shifted:
        starts = [here, *turned_places]
        moves += [Move(sensors, at) for at in _near_similar(evidence, sensors, outside, starts)]
    moves.sort(key=lambda move: -evidence.gain(move))
    if shifted:
        moves += [refined(evidence, sensors, one.places).move for one in moves[:_N_REFINED]]
        moves.sort(key=lambda move: -evidence.gain(move))
    return [move for move in moves if is_possible(evidence, move, _LEAST)]


def _near_similar(
    evidence: Evidence,
    sensors: NDArray[np.intp],
    outside: NDArray[np.intp],
    starts: list[NDArray[np.float64]],
) -> list[NDArray[np.float64]]:
    """Shift a patch from places such that it is near the sensors that are most similar to it."""
    kept = evidence.usable[sensors]
    similarity = evidence.similarity[np.ix_(sensors[kept], outside)]
    links = np.argsort(-similarity, axis=None, kind="stable")[:_N_LINKS]
    inner, outer = np.unravel_index(links, similarity.shape)
    targets, spacing = evidence.positions[outside[outer]], evidence.falloff.spacing
    ranked = []
    for places in starts:
        offsets = targets - places[kept][inner]
        close = np.linalg.norm(offsets[:, None] - offsets, axis=2) <= _NEAR * spacing
        votes = zip(close.sum(axis=1).tolist(), offsets, strict=True)
        ranked += [(-count, places + offset) for count, offset in votes]
    ranked.sort(key=lambda one: one[0])
    return [places for _, places in ranked[:_N_TRIED]]


def _turns(points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Turn and mirror points (m, k) about their middle, in their plane."""
    centre, k = points.mean(axis=0), points.shape[1]
    axes = np.eye(k) if k == 2 else np.linalg.svd(points - centre, full_matrices=False)[2]
    flat = (points - centre) @ axes.T
    found = []
    for angle in 2 * np.pi * np.arange(_N_ANGLES) / _N_ANGLES:
        for hand in (1.0, -1.0):
            turn = np.eye(k)
            cos, sin = np.cos(angle), np.sin(angle)
            turn[:2, :2] = [[cos, -hand * sin], [sin, hand * cos]]
            if angle > 0 or hand < 0:
                found.append(flat @ turn.T @ axes + centre)
    return found


def _on_places(
    evidence: Evidence, mounting: Mounting, modules: list[int], moves: list[Move]
) -> MovedPatch | None:
    """Return the best move, with each module on a place of one of them if all are near one.

    None if that is its own: then each module is turned by itself.
    """
    sensors, slots, found = moves[0].sensors, [], []
    ends = np.cumsum([len(mounting.members[m]) for m in modules])[:-1]
    for m, there in zip(modules, np.split(moves[0].places, ends), strict=True):
        options = [
            (float(np.sqrt(((at - there) ** 2).sum(axis=1).mean())), slot, at)
            for slot in modules
            for at in (mounting.places(m, slot, o) for o in range(len(mounting.orientations)))
        ]
        off, slot, at = min(options, key=lambda option: option[0])
        if off <= _SAME * mounting.pitch:
            slots.append(slot)
            found.append(at)
    if slots == modules:
        return None
    if set(slots) == set(modules):
        onto = Move(sensors, np.concatenate(found))
        if evidence.gain(onto) > evidence.gain(moves[0]) - MIN_GAIN:
            moves = [onto, *moves]
    elif evidence.positions.shape[1] == 2:
        exact = _beside(evidence, mounting, modules, moves[0])
        best = max(exact, key=evidence.gain, default=moves[0])
        if evidence.gain(best) > evidence.gain(moves[0]) - MIN_GAIN:
            moves = [best, *moves]
    least = _FAR * evidence.falloff.spacing
    others = [move for move in moves if _farthest(move.places, moves[0].places) > least]
    return MovedPatch(tuple(modules), tuple(moves), (others or moves[1:])[0])


def _farthest(places: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    """Return the largest distance between two places of a sensor."""
    return float(np.linalg.norm(places - others, axis=1).max())
