"""Patches (groups of adjacent modules) that are turned, mirrored or shifted as a whole."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import MIN_GAIN, Evidence, Move
from anisomap.layout.judging import MIN_GROUP_GAIN, around
from anisomap.layout.modules import Mounting
from anisomap.layout.patches import N_REFINED, motions, turns
from anisomap.numerics.neighbours import linked_labels
from anisomap.numerics.procrustes import fit_similarity

AGREEING = 0.35
"""Minimum evidence that two modules are adjacent, relative to the evidence expected if they are.

In correct layouts of the iCub's torso, it is 0.5 and more; around a turned patch, 0.05 and less.
"""

_MAX_SHARE = 0.5  # of the sensors: a patch is smaller than the remainder
_N_GROUPS = 8  # smallest contradicted groups
_N_BEST = 3  # patches tried
_LEAST_MOVE = 2.0  # minimum move of the median sensor in spacings
_SAME = 0.6  # spacings of pads: turned patches of bent layouts fit their places less than exactly
_PULL = 1.0  # the same, on flat layouts: contacts of unequal reach pull patches
_NEARLY = 0.9  # of its gain: a patch on places of modules is nearly as good as at the best place
_LEAST = 4  # modules of a patch; correct boards of three also fit beside wrong modules
_TRUSTED = 0.8  # of the expected evidence of others, in space: torso and arm .88, meshes .44 to .55
_FAR = 3.0  # spacings by which the outermost sensor moves: smaller turns can hardly be detected


def moved_patches(
    evidence: Evidence, mounting: Mounting, arranged: Evidence
) -> list[tuple[list[int], Move]]:
    """Propose modules that fit better turned, mirrored or shifted as a patch, the best first.

    arranged: Evidence with modules moved separately. Contradicted groups in it are also patches;
        unchanged groups that agree with adjacent modules in it are correct.
    """
    largest = _MAX_SHARE * np.count_nonzero(evidence.usable)
    found: list[tuple[float, list[int], Move]] = []
    flat, pairs = evidence.positions.shape[1] == 2, bonds(evidence, mounting)
    groups = _contradicted(*pairs)
    if flat:  # in space, modules alone move to free places only
        alone = bonds(arranged, mounting)[0].sum(axis=1) < 0
        groups += [[m] for m in np.flatnonzero(alone).tolist()]
    for group in sorted(groups, key=len)[:_N_GROUPS]:
        sensors = np.concatenate([mounting.members[m] for m in group])
        changed = (arranged.positions[sensors] != evidence.positions[sensors]).any()
        agrees = not changed and border(arranged, mounting, group) > AGREEING
        rest, expected = np.delete(np.delete(pairs, group, 1), group, 2).sum(axis=(1, 2))
        trusted = (flat or rest > _TRUSTED * expected) and (len(group) >= _LEAST or len(group) == 1)
        if agrees or len(sensors) > largest or not trusted:
            continue
        found.append((0.0, group, Move(sensors, evidence.positions[sensors])))
    for n_refined in (1, N_REFINED):
        better = [_best_motion(evidence, group, move, n_refined) for _, group, move in found]
        found = sorted((one for one in better if one), key=lambda one: -one[0])[:_N_BEST]
    return [(g, to) for _, g, one in found if (to := on_places(evidence, mounting, g, one))]


def _best_motion(
    evidence: Evidence, modules: list[int], move: Move, n_refined: int
) -> tuple[float, list[int], Move] | None:
    """Return the best motion of a patch in its plane, by its gain there: bodies are cut open."""
    moves = motions(evidence, move.sensors, _LEAST_MOVE, in_plane=True, n_refined=n_refined)
    if not moves:
        return None
    beside = around(evidence, move).gains(move.sensors, evidence.codes[None])
    gains = np.concatenate([beside(one.places) for one in moves])
    worth, best = gains.max() - MIN_GROUP_GAIN * len(modules), gains >= _NEARLY * gains.max()
    return (float(worth), modules, moves[best.argmax()]) if worth >= 0 else None


def bonds(evidence: Evidence, mounting: Mounting) -> NDArray[np.float64]:
    """Return the evidence that modules are adjacent, and its expectation if they are, (2, M, M).

    It is the log-likelihood ratio of the similarities of pads if near, relative to distant pads.
    """
    near = evidence.known & (cdist(evidence.positions, evidence.positions) <= evidence.reach)
    modules = np.arange(mounting.n_modules)
    inside = (mounting.owner == modules[:, None]).astype(float)
    ratios = np.stack([evidence.ratios, evidence.falloff.expected[evidence.bins]])
    total = np.asarray(inside @ np.where(near, ratios, 0) @ inside.T)
    total[:, modules, modules] = 0
    return total


def border(evidence: Evidence, mounting: Mounting, modules: Sequence[int]) -> float:
    """Return the evidence that some modules are adjacent to the others, relative to expectation.

    It is about 1 if they are, and about -1 if they are elsewhere; NaN without near modules.
    """
    found, expected = (
        float(np.delete(one[list(modules)], modules, axis=1).sum())
        for one in bonds(evidence, mounting)
    )
    return found / expected if expected > 0 else float("nan")


def other_side(
    evidence: Evidence, mounting: Mounting, modules: list[int], move: Move
) -> tuple[list[int], Move]:
    """Return groups of agreeing modules that contradict modules, and their reverse motion."""
    found, expected = bonds(evidence, mounting)
    against, agreeing = found[modules].sum(axis=0), found > AGREEING * expected
    agreeing[modules], agreeing[:, modules], against[modules] = False, False, 0
    label = linked_labels(agreeing)
    others = np.flatnonzero(np.bincount(label, against)[label] < 0).tolist()
    sensors = np.concatenate([np.empty(0, int), *(mounting.members[m] for m in others)])
    here = evidence.positions[move.sensors]
    back = fit_similarity(move.places, here, scaling=False, reflection=None)
    return others, Move(sensors, back.apply(evidence.positions[sensors]))


def unsure_patches(evidence: Evidence, mounting: Mounting) -> list[list[int]]:
    """Return the patches separate from a larger one that fit nearly as well turned or mirrored."""
    if mounting.n_modules < 2:
        return []
    label = linked_labels(mounting.adjacent)
    groups = [np.flatnonzero(label == k).tolist() for k in np.unique(label)]
    least = _FAR * evidence.falloff.spacing
    found = []
    for group in sorted(groups, key=lambda one: -len(one))[1:]:
        sensors = np.concatenate([mounting.members[m] for m in group])
        here = evidence.positions[sensors]
        far = [
            places for places in turns(here) if np.linalg.norm(places - here, axis=1).max() > least
        ]
        gains = [evidence.gain(Move(sensors, places)) for places in far]
        if len(group) > 1 and max(gains, default=-np.inf) > -MIN_GAIN:
            found.append(group)
    return found


def _contradicted(found: NDArray[np.float64], expected: NDArray[np.float64]) -> list[list[int]]:
    """Return the groups of modules that agree with each other, but with no adjacent module.

    found, expected (M, M): See `bonds`.
    Greedy additive edge contraction: Keuper et al. (2015), ICCV, 1751-1759.
    """
    weights = found - AGREEING * expected
    groups = [[m] for m in range(len(found))]
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


def on_places(
    evidence: Evidence, mounting: Mounting, modules: list[int], move: Move
) -> Move | None:
    """Return a motion; on flat layouts, with a module on or next to the place of a module.

    None if all modules stay at their own places, since each is then turned separately.
    """
    ends = np.cumsum([len(mounting.members[m]) for m in modules])[:-1]
    moved = list(zip(modules, np.split(move.places, ends), strict=True))
    off = [_apart(mounting.shapes[m][:, mounting.pads[m]], there).min() for m, there in moved]
    if max(off) <= _SAME * mounting.pitch:
        return None
    if evidence.positions.shape[1] > 2:
        return move
    others = mounting.without(modules, evidence.positions)
    shapes = np.concatenate([mounting.shapes[modules], others.shapes[others.n_modules :]])
    ways = [o for o, one in enumerate(mounting.orientations) if one.fits and not one.backwards]
    exact = []
    for m, there in moved:
        at = shapes[:, ways][:, :, mounting.pads[m]].reshape(-1, *there.shape)
        for near in at[_apart(at, there) <= _PULL * mounting.pitch]:
            fit = fit_similarity(there, near, scaling=False, reflection=False)
            exact.append(Move(move.sensors, fit.apply(move.places)))
    best = max(exact, key=evidence.gain, default=move)
    return best if evidence.gain(best) > _NEARLY * evidence.gain(move) else move


def _apart(places: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the root mean square distances of sets of places (n, m, k) from others (m, k)."""
    return np.asarray(np.sqrt(((places - others) ** 2).sum(axis=2).mean(axis=1)))
