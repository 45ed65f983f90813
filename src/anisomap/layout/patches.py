"""Proposals that patches and single sensors belong to free places."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import MIN_DISPLACEMENT, MIN_GAIN, Evidence, Move, Proposal
from anisomap.layout.sensors import place_gains
from anisomap.numerics.neighbours import linked_labels
from anisomap.numerics.procrustes import rotations

_MIN_GAP = 0.5  # minimum spacings between sensors of a moved patch and others
_MAX_IN_THE_WAY = 0.2  # share of a patch that may be nearer: others may be wrong, too

_MIN_PATCH = 3  # minimum sensors for an orientation
_MIN_RATIO = 2.0  # nats by which a link must favour its distance over a large one; by hand
_N_ANGLES = 24  # rotations, and as many reflections
_N_LINKS = 40  # most similar pairs of a sensor of a patch and another, which should be near
_NEAR = 2.5  # maximum spacings of such pairs
_N_TRIED = 60  # motions whose likelihood is computed
N_REFINED = 3  # best motions, which are refined
_MAX_SHARE = 0.5  # of the sensors: a patch is smaller than the remainder
_MAX_EVALUATIONS = 150  # per refinement
_SHIFT = (3.0, 10.0)  # spacings in space: patches gain by small motions, and bend with the layout
_PRECISION = 0.05  # spacings; smaller than the distances of the falloff's bins


def free_moves(
    evidence: Evidence, loose: NDArray[np.bool_], home: NDArray[np.float64], *, alone: bool
) -> list[Proposal]:
    """Propose the best place of each patch of loose sensors, or of single loose sensors.

    Loose sensors agree with no neighbour, or fit a distant place better. Pads of a module return
    only to the module.

    home (n, k): See `Mounting`.
    """
    homeless = loose & np.isnan(home[:, 0])
    patches = [patch for patch in _held_together(evidence)[1:] if homeless[patch].all()]
    patches = [patch for patch in patches if (len(patch) < _MIN_PATCH) == alone]
    best = []
    if alone:
        least = MIN_DISPLACEMENT * evidence.falloff.spacing
        far = np.linalg.norm(home - evidence.positions, axis=1) >= least
        best = [[Move(i, home[i])] for i in np.flatnonzero(loose & far)[:, None]]
        gains = place_gains(evidence)
        gains[cdist(evidence.positions, evidence.positions) < least] = 0
        patches += [*np.flatnonzero(homeless & (gains.max(axis=1) >= MIN_GAIN))[:, None]]
    largest = _MAX_SHARE * np.count_nonzero(evidence.usable)
    best += [motions(evidence, one, MIN_DISPLACEMENT)[:1] for one in patches if len(one) <= largest]
    return [Proposal(evidence.gain(move), move, "moved") for moves in best for move in moves]


def _held_together(evidence: Evidence) -> list[NDArray[np.intp]]:
    """Divide sensors into patches of near pairs with similar readings, the largest first."""
    sensors = np.flatnonzero(evidence.usable)
    inside = np.ix_(sensors, sensors)
    near = cdist(evidence.positions[sensors], evidence.positions[sensors]) <= evidence.reach
    held = near & (evidence.ratios[inside] > _MIN_RATIO) & (evidence.similarity[inside] > 0)
    label = linked_labels(held)
    groups = [sensors[label == k] for k in np.unique(label)]
    return sorted(groups, key=lambda group: (-len(group), int(group[0])))


def motions(
    evidence: Evidence,
    sensors: NDArray[np.intp],
    least: float,
    *,
    in_plane: bool = False,
    n_refined: int = N_REFINED,
) -> list[Move]:
    """Return the motions of a patch to free places, the best first.

    The patch is turned and mirrored about its centre, and moved so that similar sensors are near.

    least: Minimum move of the median sensor in spacings.
    in_plane: Whether the patch stays in its plane; in space, it is then either turned or moved.
    """
    here = evidence.positions[sensors]
    outside = np.setdiff1d(np.flatnonzero(evidence.usable), sensors)
    if not evidence.usable[sensors].any() or not outside.size:
        return []
    spacing, gains = evidence.falloff.spacing, evidence.gains(sensors, evidence.codes[None])
    tried = turns(here) if len(sensors) >= _MIN_PATCH else []
    plane = axes(here)[:2] if in_plane else np.eye(here.shape[1])
    bent, n_turned = len(plane) < here.shape[1], len(tried)
    starts = [here, *([] if bent else tried)]
    tried += _near_similar(evidence, sensors, outside, starts, plane)
    moves = sorted([(-gains(places)[0], i, places) for i, places in enumerate(tried)])
    best = [_refined(gains, places, spacing, plane) for *_, places in moves[:n_refined]]
    moves += [(-gains(places)[0], len(moves) + i, places) for i, places in enumerate(best)]
    moves.sort(key=lambda one: (bent and one[1] >= n_turned, one[0]))
    tree: Any = KDTree(evidence.positions[outside])
    shortest, longest = np.multiply(_SHIFT if bent else (0, np.inf), spacing)
    return [
        Move(sensors, places)
        for _, i, places in moves
        if np.median(np.linalg.norm(places - here, axis=1)) >= least * spacing
        and np.mean(tree.query(places)[0] < _MIN_GAP * spacing) <= _MAX_IN_THE_WAY
        and (i < n_turned or shortest <= np.linalg.norm((places - here).mean(axis=0)) <= longest)
    ]


def _near_similar(
    evidence: Evidence,
    sensors: NDArray[np.intp],
    outside: NDArray[np.intp],
    starts: list[NDArray[np.float64]],
    plane: NDArray[np.float64],
) -> list[NDArray[np.float64]]:
    """Shift a patch so that it is near the sensors that are most similar to it."""
    kept = evidence.usable[sensors]
    similarity = evidence.similarity[np.ix_(sensors[kept], outside)]
    links = np.argsort(-similarity, axis=None, kind="stable")[:_N_LINKS]
    inner, outer = np.unravel_index(links, similarity.shape)
    targets, spacing = evidence.positions[outside[outer]], evidence.falloff.spacing
    ranked = []
    for places in starts:
        offsets = (targets - places[kept][inner]) @ plane.T @ plane
        close = np.linalg.norm(offsets[:, None] - offsets, axis=2) <= _NEAR * spacing
        votes = zip(close.sum(axis=1).tolist(), offsets, strict=True)
        ranked += [(-count, places + offset) for count, offset in votes]
    ranked.sort(key=lambda one: one[0])
    return [places for _, places in ranked[:_N_TRIED]]


def axes(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the principal axes (k, k) of points in space; on flat layouts, the identity."""
    if points.shape[1] == 2:
        return np.eye(2)
    return np.asarray(np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2])


def turns(points: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Turn and mirror points (m, k) about their centre, in their plane."""
    centre, k, along = points.mean(axis=0), points.shape[1], axes(points)
    flat = (points - centre) @ along.T
    found = []
    for angle in 2 * np.pi * np.arange(_N_ANGLES) / _N_ANGLES:
        for hand in (1.0, -1.0):
            turn = np.eye(k)
            cos, sin = np.cos(angle), np.sin(angle)
            turn[:2, :2] = [[cos, -hand * sin], [sin, hand * cos]]
            found.append(flat @ turn.T @ along + centre)
    return found[1:]  # the first is the identity


def _refined(
    gains: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    guess: NDArray[np.float64],
    spacing: float,
    plane: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Refine the place, and for three or more sensors the rotation, from an initial estimate."""
    dimensions = len(plane)
    centre = guess.mean(axis=0)
    radius = max(float(np.linalg.norm(guess - centre, axis=1).max()), spacing)
    n_angles = 0 if len(guess) < _MIN_PATCH else 1 if dimensions == 2 else 3

    def placed(parameters: NDArray[np.float64]) -> NDArray[np.float64]:
        moved = guess - centre
        if n_angles:
            # A step of 1 in every parameter moves the outermost sensor by about a spacing.
            angles = parameters[dimensions:] * spacing / radius
            turn = rotations(angles[None])[0] - np.eye(dimensions)
            moved = moved + moved @ plane.T @ turn.T @ plane
        return np.asarray(moved + centre + parameters[:dimensions] @ plane * spacing)

    def loss(parameters: Any) -> float:
        return -float(gains(placed(parameters))[0])

    start = np.zeros(dimensions + n_angles)
    options: Any = {
        "initial_simplex": np.vstack([start, np.eye(len(start))]),
        "xatol": _PRECISION,
        "maxfev": _MAX_EVALUATIONS,
    }
    found: Any = minimize(loss, start, method="Nelder-Mead", options=options)
    return placed(found.x)
