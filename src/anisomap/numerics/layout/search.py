"""Search for the moves of sensors that explain their similarities better than stated positions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.layout.chance import (
    Chance,
    ReadingStatistics,
    agreement_gain,
    own_agreement,
)
from anisomap.numerics.layout.evidence import (
    MIN_GAIN,
    Evidence,
    Falloff,
    Move,
    Proposal,
    fit_falloff,
)
from anisomap.numerics.layout.moves import (
    PROPOSERS,
    ModuleShapes,
    half_swaps,
    is_possible,
    patch_moves,
    single_moves,
)

_MAX_ROUNDS = 12
_OF_PATCHES = ("patches", "sensors")  # searches that do not permute places
_MIN_RIGID = 0.5
"""Least gain of agreement of a patch on free places, relative to the median agreement.

Places that no sensor has are many, and fit a patch at an edge better than its own by chance: on the
right layouts of nao_torso, nao_head and insole_L, patches gained up to 0.45.
"""
_LEFT = 0.5  # share of its gain that a move must keep after others have been made; by hand

_Searches: TypeAlias = Mapping[str, Callable[[Evidence, ModuleShapes], list[Proposal]]]

SEARCHES: _Searches = MappingProxyType({**PROPOSERS, "patches": patch_moves})
"""Functions that propose moves."""

LAST_SEARCHES: tuple[_Searches, ...] = (
    MappingProxyType({"half swaps": half_swaps}),
    MappingProxyType({"sensors": single_moves}),
)
"""Functions that propose moves of one sensor, each used once no other move is left.

Most sensors that fit another place have changed places with others that say where they belong.
"""


@dataclass(frozen=True, eq=False)
class Verdict:
    """Evidence for a move.

    gain: Increase of the log-likelihood, in nats.
    half_gains: The same in two halves of the frames.
    agreement_gain: Increase of the mean similarity to the sensors around.
    chance: Largest such increase of shifted readings.
    """

    gain: float
    half_gains: tuple[float, ...]
    agreement_gain: float
    chance: float

    @property
    def holds(self) -> bool:
        """Whether the move explains the readings, in both halves, better than chance does."""
        return (
            self.gain >= MIN_GAIN
            and min(self.half_gains) > 0
            and self.agreement_gain > max(self.chance, 0.0)
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
            if not any(self._round(searches) for searches in (SEARCHES, *LAST_SEARCHES)):
                break
            evidence = self.evidence
            self.evidence = replace(
                evidence, falloff=self._falloff(evidence.positions, evidence.usable)
            )
        return self.evidence.positions

    def _round(self, searches: _Searches) -> bool:
        proposals = [
            (proposal, name)
            for name, search in searches.items()
            for proposal in search(self.evidence, self._modules)
            if proposal.gain >= MIN_GAIN
        ]
        proposals.sort(key=lambda pair: -pair[0].gain)
        changed: set[int] = set()
        for proposal, name in proposals:
            sensors = proposal.move.sensors
            if changed.intersection(sensors.tolist()):
                continue
            if self.evidence.gain(proposal.move) < _LEFT * proposal.gain:
                continue
            # Without the readings of both, a swap is no stronger evidence than a free place.
            rigid = name not in PROPOSERS
            if rigid and not is_possible(self.evidence, proposal.move):
                continue
            verdict = self.judge(self.evidence, proposal.move, proposal.alternatives, rigid=rigid)
            if verdict.holds:
                self.evidence = self.evidence.moved(proposal.move)
                changed.update(sensors.tolist())
                if name in _OF_PATCHES:
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
        """Weigh the evidence for a move."""
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
        return Verdict(evidence.gain(move), halves, agreement_gain(evidence, move), chance)
