"""Proposals that single sensors, and runs of them, have the places of others.

Each function takes the evidence and returns the proposals that it finds best, whatever their gain.
To add a kind of fault, add one function here and one line to `anisomap.layout.search`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import MIN_GAIN, Evidence, Move, Proposal

STEPS = (1, -1, 2, -2)
"""Channels by which a cable may be shifted."""

_MIN_RUN = 4  # consecutive channels; fewer are swaps and cycles
_MAX_SUSPECTS = 200  # sensors that may be in cycles, the worst first
_N_RUNS = 5  # runs of each step that are evaluated exactly; chosen by hand


class PlaceFits:
    """Log-likelihoods of single sensors at the places of others."""

    def __init__(self, evidence: Evidence) -> None:
        self._evidence = evidence
        self._distances = cdist(evidence.positions, evidence.positions)
        self._total = evidence.likelihood.sum(axis=1)

    def places_near(self, sensor: int) -> NDArray[np.intp]:
        """Return the sensors whose places are near those most similar to a sensor."""
        evidence = self._evidence
        near = (self._distances[evidence.similar(sensor)] <= evidence.reach).any(axis=0)
        return np.flatnonzero(near & (self._distances[sensor] > 0))

    def gains(self, sensors: ArrayLike, others: ArrayLike) -> NDArray[np.float64]:
        """Return the gains of sensors at the places of others, which are left out: pairs, or one.

        sensors, others (m,) or a number -> (m,).
        """
        evidence = self._evidence
        sensors, others = np.broadcast_arrays(sensors, others)
        bins = evidence.bins[others]
        after = evidence.falloff.log_likelihood(evidence.similarity[sensors], bins)
        known = evidence.known[sensors]
        known[np.arange(len(others)), others] = False
        before = self._total[sensors] - evidence.likelihood[sensors, others]
        return np.asarray(np.where(known, after, 0.0).sum(axis=1) - before)

    def best_gains(self, min_distance: float = 0.0) -> NDArray[np.float64]:
        """Return the largest gain of each sensor at the place of another, shape (n,)."""
        best = np.full(len(self._distances), -np.inf)
        for i in np.flatnonzero(self._evidence.usable).tolist():
            places = self.places_near(i)
            places = places[self._distances[i, places] >= min_distance]
            if places.size:
                best[i] = self.gains(i, places).max()
        return best


def swaps(evidence: Evidence) -> list[Proposal]:
    """Propose the best exchange of each sensor with one other, by the readings of both."""
    return _swaps(evidence, evidence.usable)


def half_swaps(evidence: Evidence) -> list[Proposal]:
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


def cycles(evidence: Evidence) -> list[Proposal]:
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
    return tuple(Move(run, np.roll(positions[run], -step, axis=0)) for step in STEPS)


def _best(evidence: Evidence, moves: Sequence[Move]) -> Proposal:
    return max(
        (Proposal(evidence.gain(move), move) for move in moves), key=lambda proposal: proposal.gain
    )


def _closed_run(evidence: Evidence, start: int, stop: int, step: int) -> Move:
    """Shift the places of a run; sensors at its end take the places that are left over."""
    if step > 0:
        stop = min(stop + step, len(evidence.positions))
    else:
        start = max(start + step, 0)
    run = np.arange(start, stop)
    return Move(run, np.roll(evidence.positions[run], -step, axis=0))
