"""Proposals that single sensors, or runs of sensors, have the places of others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import MIN_GAIN, Evidence, Move, Proposal

MAX_STEP = 2
"""Maximum shift of a cable in channels."""

_MIN_RUN = 4  # consecutive channels; fewer are swaps and cycles
_N_RUNS = 5  # runs of each step that are evaluated exactly; chosen by hand
_N_BINS = 20  # of distances, up to about 10 spacings: further sensors hardly distinguish places
_PRICE = 0.7 * MIN_GAIN  # of each moved sensor
_DISTINCT = 2.5  # spacings: nearer places can hardly be distinguished


def chains(following: Mapping[int, int]) -> list[list[int]]:
    """Divide the keys of a one-to-one map into open chains and cycles.

    The last value of an open chain is not a key.
    """
    found: list[list[int]] = []
    left = set(following)
    for start in [*sorted(left - set(following.values())), *sorted(left)]:
        chain = []
        here = start
        while here in left:
            left.discard(here)
            chain.append(here)
            here = following[here]
        if chain:
            found.append(chain)
    return found


def place_gains(evidence: Evidence) -> NDArray[np.float32]:
    """Return the gain of each usable sensor at the place of each other sensor, which moves, (n, n).

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


def reassigned(evidence: Evidence, *, alone: bool = False) -> list[Proposal]:
    """Propose exchanges and cycles of sensors, by an optimal assignment of all sensors to places.

    alone: Instead, exchange sensors with sensors without evidence in the readings, if no other
        place fits better.
    """
    gains = place_gains(evidence)
    near = cdist(evidence.positions, evidence.positions) < _DISTINCT * evidence.falloff.spacing
    gains[near] = -2 * MIN_GAIN
    if alone:
        best = gains.argmax(axis=1)
        found = evidence.usable & ~evidence.usable[best] & (gains.max(axis=1) > 0)
        groups = [np.array([i, best[i]]) for i in np.flatnonzero(found).tolist()]
    else:
        sensors = np.flatnonzero(evidence.usable)
        gains = gains[np.ix_(sensors, sensors)]
        np.fill_diagonal(gains, _PRICE)
        gains -= _PRICE
        target = linear_sum_assignment(-gains)[1]
        both = gains + gains.T
        np.fill_diagonal(both, -np.inf)
        pairs = {(min(pair), max(pair)) for pair in enumerate(both.argmax(axis=1).tolist())}
        following = {i: int(t) for i, t in enumerate(target.tolist()) if i != t}
        longer = [cycle for cycle in chains(following) if len(cycle) > 2]
        groups = [sensors[list(one)] for one in [*sorted(pairs), *longer]]
    moves = [Move(one, evidence.positions[np.roll(one, -1)]) for one in groups]
    return [Proposal(evidence.gain(move), move) for move in moves]


def cable_shifts(evidence: Evidence) -> list[Proposal]:
    """Propose the best shifted run of consecutive sensors.

    The gain of each run is the sum of gains of pairs, from two-dimensional cumulative sums.
    """
    n_sensors = len(evidence.positions)
    everyone = np.arange(n_sensors)
    proposals = []
    for step in (1, -1, MAX_STEP, -MAX_STEP):
        if n_sensors < _MIN_RUN + abs(step):
            continue
        places = np.roll(evidence.positions, -step, axis=0)
        bins = evidence.falloff.bins(cdist(places, evidence.positions))
        alone = np.where(evidence.known, evidence.falloff.ratio(evidence.codes, bins), 0)
        outside = alone - evidence.ratios
        inside = evidence.moved(Move(everyone, places)).ratios - evidence.ratios
        # Of the run a to b: gains to all sensors, minus gains to sensors inside, which also move.
        single = np.concatenate([[0.0], outside.sum(axis=1, dtype=float).cumsum()])
        within = np.zeros((n_sensors + 1, n_sensors + 1))
        within[1:, 1:] = (inside / 2 - outside).astype(float).cumsum(axis=0).cumsum(axis=1)
        start, stop = np.triu_indices(n_sensors + 1, _MIN_RUN)
        gains = single[stop] - single[start]
        gains += within[stop, stop] - within[start, stop] - within[stop, start]
        gains += within[start, start]
        best = np.argsort(-gains, kind="stable")[:_N_RUNS]
        proposed = []
        for k in best:
            # Sensors at the end of a run take the remaining places.
            run = np.arange(max(0, start[k] + min(step, 0)), min(stop[k] + max(step, 0), n_sensors))
            move = Move(run, np.roll(evidence.positions[run], -step, axis=0))
            proposed.append(Proposal(evidence.gain(move), move, "shifted"))
        proposals.append(max(proposed, key=lambda one: one.gain))
    return proposals
