"""Patches, groups of adjacent modules, that are turned or mirrored as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from anisomap.layout.borders import AGREEING, bonds
from anisomap.layout.evidence import MIN_GAIN, Evidence, Move
from anisomap.layout.judging import MIN_GROUP_GAIN
from anisomap.layout.modules import Mounting

_MAX_SHARE = 0.5  # of the sensors: a patch is smaller than what it is turned against
_N_ANGLES = 72  # turns, and as many reflections
_N_BEST = 3  # patches that are tried
_SAME = 0.6  # spacings of pads: turned patches of bent layouts fit their places less than exactly
_FAR = 3.0  # spacings by which the outermost sensor moves: smaller turns are hardly told


@dataclass(frozen=True, eq=False)
class TurnedPatch:
    """A patch in the orientation that explains the readings best.

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


def turned_patches(evidence: Evidence, mounting: Mounting) -> list[TurnedPatch]:
    """Propose patches that fit better turned or mirrored about their middle, the best first."""
    largest = _MAX_SHARE * np.count_nonzero(evidence.usable)
    found = []
    for group in _contradicted(evidence, mounting):
        if sum(len(mounting.members[m]) for m in group) > largest:
            continue
        moves = _turned(evidence, mounting, group)
        if (gain := evidence.gain(moves[0])) >= MIN_GROUP_GAIN:
            found.append((gain, group, moves))
    found.sort(key=lambda one: -one[0])
    best = [_on_places(evidence, mounting, group, moves) for _, group, moves in found[:_N_BEST]]
    return [patch for patch in best if patch is not None]


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
        far = [
            move
            for move in _turned(evidence, mounting, group)
            if _farthest(move.places, evidence.positions[move.sensors]) > least
        ]
        if len(group) > 1 and far and evidence.gain(far[0]) > -MIN_GAIN:
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


def _turned(evidence: Evidence, mounting: Mounting, modules: list[int]) -> list[Move]:
    """Turn and mirror modules about their middle, the best first."""
    sensors = np.concatenate([mounting.members[m] for m in modules])
    here = evidence.positions[sensors]
    before = evidence.likelihood_at(sensors, here)
    moves = [Move(sensors, places) for places in _turns(here)]
    return sorted(moves, key=lambda move: -evidence.gain(move, before))


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
) -> TurnedPatch | None:
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
    least = _FAR * evidence.falloff.spacing
    others = [move for move in moves if _farthest(move.places, moves[0].places) > least]
    return TurnedPatch(tuple(modules), tuple(moves), (others or moves[1:])[0])


def _farthest(places: NDArray[np.float64], others: NDArray[np.float64]) -> float:
    """Return the largest distance between two places of a sensor."""
    return float(np.linalg.norm(places - others, axis=1).max())
