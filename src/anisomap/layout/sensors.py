"""Proposals that single sensors, and runs of them, have the places of others."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import MIN_GAIN, Evidence, Move, Proposal

STEPS = (1, -1, 2, -2)
"""Channels by which a cable may be shifted."""

_MIN_RUN = 4  # consecutive channels; fewer are swaps and cycles
_N_RUNS = 5  # runs of each step that are evaluated exactly; chosen by hand
_N_BINS = 20  # of distances, to about 10 spacings: farther sensors hardly tell places apart
_PRICE = 0.7 * MIN_GAIN  # of each sensor that is moved
_DISTINCT = 2.5  # spacings: nearer places are hardly told apart


def place_gains(evidence: Evidence) -> NDArray[np.float32]:
    """Return the gain of each usable sensor at the place of each other, which leaves it, (n, n).

    Rows of other sensors, and the diagonal, are 0.
    """
    falloff, near = evidence.falloff, evidence.bins
    n = len(near)
    there = np.zeros((n, n), np.float32)
    for b in range(_N_BINS):
        ratios = np.where(evidence.known, falloff.table[b][evidence.codes], np.float32(0))
        at: Any = csr_array((near == b).astype(np.float32))
        there += (at @ ratios).T
        if b == 0:
            there -= ratios  # the sensor that leaves the place
    here = np.where(near < _N_BINS, evidence.ratios, 0)
    gains = there - (here.sum(axis=1)[:, None] - here)
    gains[~evidence.usable] = 0
    np.fill_diagonal(gains, 0)
    return np.asarray(gains)


def reassigned(evidence: Evidence) -> list[Proposal]:
    """Propose exchanges and cycles of sensors, by one assignment of all to each other's places."""
    sensors = np.flatnonzero(evidence.usable)
    gains = _distinct_gains(evidence)[np.ix_(sensors, sensors)]
    np.fill_diagonal(gains, _PRICE)
    gains -= _PRICE
    target = linear_sum_assignment(-gains)[1]
    both = gains + gains.T
    np.fill_diagonal(both, -np.inf)
    pairs = {(min(pair), max(pair)) for pair in enumerate(both.argmax(axis=1).tolist())}
    groups = [list(pair) for pair in sorted(pairs) if both[pair] > 0]
    groups += [cycle for cycle in _cycles(target) if len(cycle) > 2]
    return _proposals(evidence, [sensors[group] for group in groups])


def half_reassigned(evidence: Evidence) -> list[Proposal]:
    """Propose exchanges with sensors of which the readings say nothing, if no place fits better."""
    gains = _distinct_gains(evidence)
    best = gains.argmax(axis=1)
    found = np.flatnonzero(evidence.usable & ~evidence.usable[best] & (gains.max(axis=1) > 0))
    return _proposals(evidence, [np.array([i, best[i]]) for i in found.tolist()])


def _distinct_gains(evidence: Evidence) -> NDArray[np.float32]:
    """Return the `place_gains`, negative where places are hardly told apart."""
    gains = place_gains(evidence)
    near = cdist(evidence.positions, evidence.positions) < _DISTINCT * evidence.falloff.spacing
    gains[near] = -2 * MIN_GAIN
    return gains


def _proposals(evidence: Evidence, groups: list[NDArray[np.intp]]) -> list[Proposal]:
    """Propose that each sensor of a group has the place of the next."""
    moves = [Move(one, evidence.positions[np.roll(one, -1)]) for one in groups]
    return [Proposal(evidence.gain(move), move) for move in moves]


def _cycles(target: NDArray[np.intp]) -> list[list[int]]:
    """Return the cycles of a permutation, without those of one element."""
    found, left = [], set(np.flatnonzero(target != np.arange(len(target))).tolist())
    while left:
        cycle = [left.pop()]
        while (following := int(target[cycle[-1]])) != cycle[0]:
            cycle.append(following)
            left.discard(following)
        found.append(cycle)
    return found


def cable_shifts(evidence: Evidence) -> list[Proposal]:
    """Propose the best run of consecutive sensors that have each other's places, shifted.

    The gain of every run is the sum of its gains by pair, from two-dimensional cumulative sums.
    """
    n_sensors = len(evidence.positions)
    everyone = np.arange(n_sensors)
    proposals = []
    for step in STEPS:
        if n_sensors < _MIN_RUN + abs(step):
            continue
        places = np.roll(evidence.positions, -step, axis=0)
        outside = evidence.ratios_at(everyone, places) - evidence.ratios
        inside = evidence.moved(Move(everyone, places)).ratios - evidence.ratios
        # Of the run a to b: gains to all sensors, less those inside, which move, too.
        single = np.concatenate([[0.0], outside.sum(axis=1, dtype=float).cumsum()])
        within = np.zeros((n_sensors + 1, n_sensors + 1))
        within[1:, 1:] = (inside / 2 - outside).astype(float).cumsum(axis=0).cumsum(axis=1)
        start, stop = np.triu_indices(n_sensors + 1, _MIN_RUN)
        gains = single[stop] - single[start]
        gains += within[stop, stop] - within[start, stop] - within[stop, start]
        gains += within[start, start]
        best = np.argsort(-gains, kind="stable")[:_N_RUNS]
        moves = [_closed_run(evidence, int(start[k]), int(stop[k]), step) for k in best]
        found = max((Proposal(evidence.gain(m), m) for m in moves), key=lambda one: one.gain)
        alternatives = shifted_moves(evidence.positions, found.move.sensors)
        proposals.append(replace(found, alternatives=alternatives))
    return proposals


def shifted_moves(positions: NDArray[np.float64], run: NDArray[np.intp]) -> tuple[Move, ...]:
    """Return the moves of a run of sensors to each other's places, one for each step."""
    return tuple(Move(run, np.roll(positions[run], -step, axis=0)) for step in STEPS)


def _closed_run(evidence: Evidence, start: int, stop: int, step: int) -> Move:
    """Shift the places of a run; sensors at its end take the places that are left over."""
    if step > 0:
        stop = min(stop + step, len(evidence.positions))
    else:
        start = max(start + step, 0)
    run = np.arange(start, stop)
    return Move(run, np.roll(evidence.positions[run], -step, axis=0))
