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
from anisomap.layout.sensors import PlaceFits
from anisomap.numerics.procrustes import fit_similarity, rotations

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


def patch_moves(evidence: Evidence) -> list[Proposal]:
    """Propose the best place of each patch of three and more sensors, moved as a whole."""
    apart = [patch for patch in patches(evidence)[1:] if len(patch) >= _MIN_PATCH]
    return _rigid_moves(evidence, apart) + _translated(evidence)


def single_moves(evidence: Evidence) -> list[Proposal]:
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
            _refined(evidence, patch, evidence.positions[patch] + offset)
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
    before = evidence.likelihood_at(patch, here)
    tried = [(evidence.gain(Move(patch, places), before), places) for places in starts]
    tried.sort(key=lambda pair: -pair[0])
    chosen = [places for _, places in tried[:_N_STARTS]]
    if np.count_nonzero(known) > here.shape[1]:
        hands = (False, True) if here.shape[1] == 2 else (False,)
        fits = [fit_similarity(here, targets, known, scaling=False, reflection=h) for h in hands]
        chosen += [fit.apply(here) for fit in fits]
    refined = [_refined(evidence, patch, places) for places in chosen]
    return max(refined, key=lambda proposal: proposal.gain) if refined else None


def _refined(evidence: Evidence, patch: NDArray[np.intp], guess: NDArray[np.float64]) -> Proposal:
    """Refine the place, and the rotation of three and more sensors, from a first guess."""
    spacing, dimensions = evidence.falloff.spacing, guess.shape[1]
    centre = guess.mean(axis=0)
    radius = max(float(np.linalg.norm(guess - centre, axis=1).max()), spacing)
    n_angles = 0 if len(patch) < _MIN_PATCH else 1 if dimensions == 2 else 3
    before = evidence.likelihood_at(patch, evidence.positions[patch])

    def placed(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        moved = guess - centre
        if len(parameters) > dimensions:
            # A step of 1 in every parameter moves the outermost sensor by about a spacing.
            angles = parameters[dimensions:] * spacing / radius
            moved = moved @ rotations(angles[None])[0].T
        return np.asarray(moved + centre + parameters[:dimensions] * spacing)

    def loss(parameters: Any) -> float:
        return -evidence.gain(Move(patch, placed(parameters)), before)

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
