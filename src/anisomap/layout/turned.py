"""Patches, groups of adjacent modules, that are turned or mirrored as a whole."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import Evidence, Move
from anisomap.layout.modules import Mounting
from anisomap.layout.patches import refined

_AGREEING = 0.35
"""Least evidence that two modules are adjacent, as a share of what is expected if they are.

In right layouts of the iCub's torso it is 0.5 and more, around a turned patch 0.05 and less.
"""

_MAX_SHARE = 0.5  # of the sensors: a patch is smaller than what it is turned against
_N_ANGLES = 12  # turns, and as many reflections, from which the best are refined
_N_STARTS = 3
_SAME = 0.6  # spacings of pads: turned patches of bent layouts fit their places less than exactly


@dataclass(frozen=True, eq=False)
class TurnedPatch:
    """A patch in the orientation that explains the readings best.

    tried: Moves among which it was chosen, the best first.
    """

    modules: tuple[int, ...]
    move: Move
    tried: tuple[Move, ...]


def bonds(evidence: Evidence, mounting: Mounting) -> tuple[NDArray[np.float64], ...]:
    """Return the evidence that modules are adjacent, and what is expected if they are, (M, M).

    It is the log-likelihood ratio of the similarities of near pads to those of distant pads.
    """
    falloff, bins = evidence.falloff, evidence.bins
    near = evidence.known & (cdist(evidence.positions, evidence.positions) <= evidence.reach)
    first, second = np.nonzero(near)
    here = bins[first, second]
    far = np.full_like(here, len(falloff.level) - 1)
    inside = np.zeros((mounting.n_modules, len(near)))
    for m, members in enumerate(mounting.members):
        inside[m, members] = 1
    found = []
    for similarity in (evidence.similarity[first, second], falloff.level[here]):
        ratio = np.zeros(near.shape)
        ratio[first, second] = falloff.log_likelihood(similarity, here)
        ratio[first, second] -= falloff.log_likelihood(similarity, far)
        total = inside @ ratio @ inside.T
        np.fill_diagonal(total, 0)
        found.append(total)
    return tuple(found)


def held_together(evidence: Evidence, mounting: Mounting) -> list[list[int]]:
    """Divide modules into patches whose readings agree with the layout, the largest first.

    Greedy additive edge contraction: Keuper et al. (2015), ICCV, 1751-1759.
    """
    found, expected = bonds(evidence, mounting)
    weights = found - _AGREEING * expected
    groups = [[m] for m in range(mounting.n_modules)]
    while len(groups) > 1:
        np.fill_diagonal(weights, -np.inf)
        a, b = sorted(map(int, np.unravel_index(weights.argmax(), weights.shape)))
        if weights[a, b] <= 0:
            break
        groups[a] = sorted(groups[a] + groups.pop(b))
        weights[a] += weights[b]
        weights[:, a] = weights[a]
        weights = np.delete(np.delete(weights, b, 0), b, 1)
    return sorted(groups, key=lambda group: -len(group))


def turned_patches(evidence: Evidence, mounting: Mounting) -> list[TurnedPatch]:
    """Propose the best orientation of each patch of two modules and more about its middle."""
    found = []
    for group in held_together(evidence, mounting)[1:]:
        sensors = np.concatenate([mounting.members[m] for m in group])
        if len(group) < 2 or len(sensors) > _MAX_SHARE * np.count_nonzero(evidence.usable):
            continue
        here = evidence.positions[sensors]
        before = evidence.likelihood_at(sensors, here)
        moves = [Move(sensors, places) for places in _turns(here)]
        moves.sort(key=lambda move: -evidence.gain(move, before))
        best = [refined(evidence, sensors, move.places).move for move in moves[:_N_STARTS]]
        best = [Move(sensors, _on_places(mounting, group, move.places)) for move in best]
        best.sort(key=lambda move: -evidence.gain(move, before))
        found.append(TurnedPatch(tuple(group), best[0], (*best, *moves)))
    return found


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
    mounting: Mounting, modules: list[int], places: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the places of modules of the patch if each has that of one, else places as given."""
    found, taken = [], set()
    ends = np.cumsum([len(mounting.members[m]) for m in modules])[:-1]
    for m, there in zip(modules, np.split(places, ends), strict=True):
        options = [
            (float(np.sqrt(((at - there) ** 2).sum(axis=1).mean())), slot, at)
            for slot in modules
            for at in (mounting.places(m, slot, o) for o in range(len(mounting.orientations)))
        ]
        off, slot, at = min(options, key=lambda option: option[0])
        if off > _SAME * mounting.pitch or slot in taken:
            return places
        taken.add(slot)
        found.append(at)
    return np.concatenate(found)
