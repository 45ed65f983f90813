"""Search for the moves of sensors that explain their similarities better than stated positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.layout.chance import (
    Chance,
    ReadingStatistics,
    agreement_gain,
    median_gain,
    own_agreement,
)
from anisomap.numerics.layout.evidence import (
    MIN_GAIN,
    Evidence,
    Falloff,
    Move,
    fit_falloff,
)
from anisomap.numerics.layout.moves import (
    PROPOSERS,
    ModuleShapes,
    Proposer,
    half_swaps,
    is_possible,
    patch_moves,
    single_moves,
    without_smaller_patches,
)

_MAX_ROUNDS = 12
_MIN_RIGID = 0.5
"""Least gain of agreement of a patch on free places, relative to the median agreement.

Places that no sensor has are many, and fit a patch at an edge better than its own by chance: on the
right layouts of nao_torso, nao_head and insole_L, patches gained up to 0.45.
"""
_LEFT = 0.5  # share of its gain that a move must keep after others have been made; by hand

SEARCHES = ((*PROPOSERS, patch_moves), (half_swaps,), (single_moves,))
"""Functions that propose moves; those of one sensor are each used once no other move is left.

Most sensors that fit another place have changed places with others that say where they belong.
"""
_OF_PATCHES = (patch_moves, single_moves)  # searches that do not permute places


@dataclass(frozen=True, eq=False)
class Verdict:
    """Evidence for a move.

    gain: Increase of the log-likelihood, in nats.
    least: What it must be at least.
    half_gains: The same in two halves of the frames.
    agreement_gain: Increase of the mean similarity to the sensors around.
    chance: Largest such increase of shifted readings.
    median_gain: Such increase of the median sensor; 0 if less than half of all stay in place.
    """

    gain: float
    least: float
    half_gains: tuple[float, ...]
    agreement_gain: float
    chance: float
    median_gain: float

    @property
    def holds(self) -> bool:
        """Whether the move explains the readings, in both halves, better than chance does.

        Most of its sensors must gain: a few wrong ones among right ones would agree better wherever
        all of them were moved.
        """
        return (
            self.gain >= self.least
            and min(self.half_gains) > 0
            and self.agreement_gain > max(self.chance, 0.0)
            and self.median_gain > 0
        )


class Search:
    """Greedy search: in each round, moves are made in order of their gain.

    positions (n, k): Stated positions.
    """

    def __init__(
        self,
        statistics: ReadingStatistics,
        positions: NDArray[np.float64],
        usable: NDArray[np.bool_],
        spacing: float,
        modules: ModuleShapes,
    ) -> None:
        self._statistics = statistics
        self._modules = modules
        self._spacing = spacing
        self.evidence = Evidence(
            statistics.similarity, positions, usable, self._falloff(positions, usable)
        )
        own = own_agreement(self.evidence)[usable]
        own = own[np.isfinite(own)]
        self._typical = float(np.median(own)) if own.size else 0.0
        self._chance = Chance.of(statistics.shifted, self.evidence)
        self.rigid: list[NDArray[np.intp]] = []

    def _falloff(self, positions: NDArray[np.float64], usable: NDArray[np.bool_]) -> Falloff:
        inside = np.ix_(usable, usable)
        return fit_falloff(self._statistics.similarity[inside], positions[usable], self._spacing)

    def run(self) -> NDArray[np.float64]:
        """Return the positions after all moves that hold."""
        for _ in range(_MAX_ROUNDS):
            if not any(map(self._round, SEARCHES)):
                break
            evidence = self.evidence
            self.evidence = replace(
                evidence, falloff=self._falloff(evidence.positions, evidence.usable)
            )
        return self.evidence.positions

    def _round(self, searches: Sequence[Proposer]) -> bool:
        proposals = [
            (proposal, search)
            for search in searches
            for proposal in search(self.evidence, self._modules)
            if proposal.gain >= MIN_GAIN
        ]
        proposals.sort(key=lambda pair: -pair[0].gain)
        changed: set[int] = set()
        for proposal, search in proposals:
            sensors = proposal.move.sensors
            if changed.intersection(sensors.tolist()):
                continue
            if self.evidence.gain(proposal.move) < _LEFT * proposal.gain:
                continue
            # Without the readings of both, a swap is no stronger evidence than a free place.
            rigid = search not in PROPOSERS
            if rigid and not is_possible(self.evidence, proposal.move):
                continue
            verdict = self.judge(self.evidence, proposal.move, proposal.alternatives, rigid=rigid)
            if verdict.holds:
                self.evidence = self.evidence.moved(proposal.move)
                changed.update(sensors.tolist())
                if search in _OF_PATCHES:
                    self.rigid.append(sensors)
        return bool(changed)

    def judge(
        self,
        evidence: Evidence,
        move: Move,
        alternatives: Sequence[Move] = (),
        *,
        rigid: bool = False,
    ) -> Verdict:
        """Weigh the evidence for a move.

        rigid: Whether to places that no sensor has. Readings of the sensors of a patch have errors
            in common, and each pair of them must gain as much as two that are swapped.
        """
        least = MIN_GAIN
        if rigid:
            least *= max(1.0, len(move.sensors) / 2)
            evidence = without_smaller_patches(evidence, move)
        halves = tuple(
            evidence.with_similarity(half).gain(move) for half in self._statistics.halves
        )
        chance = (
            self._chance.of_moves(evidence, alternatives)
            if alternatives
            else self._chance.of_sensors(move.sensors)
        )
        if rigid:
            chance = max(chance, _MIN_RIGID * self._typical)
        # If most sensors are moved, too few are left to compare them with.
        most = 2 * len(move.sensors) > np.count_nonzero(evidence.usable)
        of_median = 0.0 if most else median_gain(evidence, move)
        of_all = agreement_gain(evidence, move)
        # Few sensors should not outweigh the others of a group that is moved as a whole.
        of_all = min(of_all, of_median) if alternatives or rigid else of_all
        return Verdict(evidence.gain(move), least, halves, of_all, chance, of_median)
