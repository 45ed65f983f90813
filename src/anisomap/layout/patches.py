"""Proposals that patches and single sensors belong to places where no sensor is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import MIN_GAIN, Evidence, Move, Proposal
from anisomap.layout.sensors import place_gains
from anisomap.numerics.procrustes import fit_similarity, rotations

_MIN_DISPLACEMENT = 3.0  # spacings: contacts of unequal reach pull patches by up to 2.5 spacings
_MIN_GAP = 0.5  # spacings between sensors of a moved patch and others, which are not in its way
_MAX_IN_THE_WAY = 0.2  # share of a patch that may come nearer: others may be wrong, too

_MIN_PATCH = 3  # sensors, which have an orientation
_MIN_RATIO = 2.0  # nats by which a link must favour its distance over a large one; by hand
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


def is_possible(evidence: Evidence, move: Move, least: float = _MIN_DISPLACEMENT) -> bool:
    """Return whether a patch moves far enough, to where no other sensors are.

    least: Spacings by which the median sensor moves.
    """
    spacing = evidence.falloff.spacing
    distance = np.linalg.norm(move.places - evidence.positions[move.sensors], axis=1)
    others = np.ones(len(evidence.positions), dtype=bool)
    others[move.sensors] = False
    nearest = KDTree(evidence.positions[others & evidence.usable]).query(move.places)[0]
    in_the_way = float(np.mean(nearest < _MIN_GAP * spacing))
    return bool(np.median(distance) >= least * spacing and in_the_way <= _MAX_IN_THE_WAY)


def _held_together(evidence: Evidence, sensors: NDArray[np.intp]) -> list[NDArray[np.intp]]:
    """Divide sensors into groups connected by near pairs with similar readings."""
    places = evidence.positions[sensors]
    distances = cdist(places, places)
    similarity = evidence.similarity[np.ix_(sensors, sensors)]
    ratio = evidence.ratios[np.ix_(sensors, sensors)]
    near = (distances <= evidence.reach) & (ratio > _MIN_RATIO) & (similarity > 0)
    graph: Any = csr_array(near)
    label = connected_components(graph, directed=False)[1]
    groups = [sensors[label == k] for k in range(int(label.max(initial=-1)) + 1)]
    return sorted(groups, key=lambda group: (-len(group), int(group[0])))


def patch_moves(evidence: Evidence) -> list[Proposal]:
    """Propose the best place of each patch of three and more sensors, moved as a whole."""
    apart = [patch for patch in patches(evidence)[1:] if len(patch) >= _MIN_PATCH]
    return _rigid_moves(evidence, apart)


def single_moves(evidence: Evidence) -> list[Proposal]:
    """Propose the best place of single sensors, and of two.

    Candidates agree with no neighbour, or fit a place that is not near theirs better.
    """
    small = [patch for patch in patches(evidence)[1:] if len(patch) < _MIN_PATCH]
    least = _MIN_DISPLACEMENT * evidence.falloff.spacing
    gains, distances = place_gains(evidence), cdist(evidence.positions, evidence.positions)
    gains[distances < least] = 0
    near = distances <= evidence.reach
    better = [
        i
        for i in np.flatnonzero(gains.max(axis=1) >= MIN_GAIN).tolist()
        if gains[i, near[evidence.similar(i)].any(axis=0)].max(initial=0) >= MIN_GAIN
    ]
    apart = {i for patch in small for i in patch.tolist()}
    single = [np.array([i]) for i in better if i not in apart]
    return _rigid_moves(evidence, small + single)


def _rigid_moves(evidence: Evidence, groups: list[NDArray[np.intp]]) -> list[Proposal]:
    largest = _MAX_SHARE * np.count_nonzero(evidence.usable)
    found = [_best_place(evidence, patch) for patch in groups if len(patch) <= largest]
    return [proposal for proposal in found if proposal is not None]


def _best_place(evidence: Evidence, patch: NDArray[np.intp]) -> Proposal | None:
    """Find the best place of a patch: moved as it is, or where its similar sensors turn it."""
    inside = np.zeros(len(evidence.positions), dtype=bool)
    inside[patch] = True
    here = evidence.positions[patch]
    starts, targets, known = [], np.zeros_like(here), np.zeros(len(patch))
    for row, i in enumerate(patch.tolist()):
        similar = evidence.similar(i)
        outside = similar[~inside[similar]]
        if not outside.size:
            continue
        weights = np.maximum(evidence.similarity[i, outside], 1e-6)
        targets[row] = np.average(evidence.positions[outside], axis=0, weights=weights)
        known[row] = float(weights.max())
        if row % -(-len(patch) // _MAX_TRIED) == 0:
            offsets = [*(evidence.positions[outside[:2]] - evidence.positions[i])]
            starts += [here + offset for offset in (*offsets, targets[row] - here[row])]
    tried = [(evidence.gain(Move(patch, places)), places) for places in starts]
    tried.sort(key=lambda pair: -pair[0])
    chosen = [places for _, places in tried[:_N_STARTS]]
    if np.count_nonzero(known) > here.shape[1]:
        hands = (False, True) if here.shape[1] == 2 else (False,)
        fits = [fit_similarity(here, targets, known, scaling=False, reflection=h) for h in hands]
        chosen += [fit.apply(here) for fit in fits]
    found = [refined(evidence, patch, places) for places in chosen]
    return max(found, key=lambda proposal: proposal.gain) if found else None


def refined(evidence: Evidence, patch: NDArray[np.intp], guess: NDArray[np.float64]) -> Proposal:
    """Refine the place, and the rotation of three and more sensors, from a first guess."""
    spacing, dimensions = evidence.falloff.spacing, guess.shape[1]
    centre = guess.mean(axis=0)
    radius = max(float(np.linalg.norm(guess - centre, axis=1).max()), spacing)
    n_angles = 0 if len(patch) < _MIN_PATCH else 1 if dimensions == 2 else 3

    def placed(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        moved = guess - centre
        if len(parameters) > dimensions:
            # A step of 1 in every parameter moves the outermost sensor by about a spacing.
            angles = parameters[dimensions:] * spacing / radius
            moved = moved @ rotations(angles[None])[0].T
        return np.asarray(moved + centre + parameters[:dimensions] * spacing)

    def loss(parameters: Any) -> float:
        return -evidence.gain(Move(patch, placed(parameters)))

    def fit(n_parameters: int) -> Proposal:
        options: Any = {
            "initial_simplex": np.vstack([np.zeros(n_parameters), np.eye(n_parameters)]),
            "xatol": _PRECISION,
            "maxfev": _MAX_EVALUATIONS,
        }
        start = np.zeros(n_parameters)
        found: Any = minimize(loss, start, method="Nelder-Mead", options=options)
        return Proposal(-float(found.fun), Move(patch, placed(found.x)))

    translated = fit(dimensions)
    if not n_angles:
        return translated
    turned = fit(dimensions + n_angles)
    return turned if turned.gain > translated.gain + MIN_GAIN else translated
