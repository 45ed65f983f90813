"""The refinements of a map: each step proposes positions with a weight, and one loop combines them.

A step is a function ``step(pairs, metric, positions, options)`` that returns a `Proposal`, or
None where it has nothing to propose. A method names its steps in order, in `anisomap.methods`.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np

from anisomap.evidence import PairStatistics
from anisomap.numerics.covariogram.covariogram_fit import Covariogram
from anisomap.numerics.precision import Reals
from anisomap.options import MethodOptions
from anisomap.recording import Scalar

logger = logging.getLogger(__name__)

MIN_FRAMES = 40
"""Frames of a map that is refined by contacts: in fewer, they cannot be distinguished."""

MIN_SENSORS = 8
"""Sensors of a refined map: fewer have hardly more pairs than coordinates."""

DIFFERENT = 0.04
"""Share of the variance of the correlations that distances on a map leave unexplained, from which
contacts differ from place to place.

It was .045 to .54 on real bodies and arrays with contacts of different sizes, and at most .02 on
bombarded, rolling and rubbed bodies and on the iCub's skin.
"""

EXACT = math.inf
"""Precision of a proposal that replaces the map, after which no step can add to it."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """Positions that a step proposes for the sensors of a map.

    positions (n, k): In the frame and unit of the map that the step started from.
    precision: Reciprocal of the variance of the positions, in units of that of the covariogram
        map; 0 leaves the map as it is.
    notes: Caveats for users.
    facts: What the step found, for the provenance of the map.
    distorted: Whether the map is distorted in a way that maps of halves of the recording share.
    elongated: Whether contacts appear long in one direction.
    fit: The covariogram of the positions, if they follow from one.
    """

    positions: Reals
    precision: float = 0.0
    notes: tuple[str, ...] = ()
    facts: Mapping[str, Scalar] = field(default_factory=dict)
    distorted: bool = False
    elongated: bool = False
    fit: Covariogram | None = None


Step: TypeAlias = Callable[[PairStatistics, Reals, Reals, MethodOptions], Proposal | None]


@dataclass(frozen=True, eq=False)
class RefinedMap:
    """Positions, and the proposals that they were combined from.

    positions (n, k)
    precision: Sum of the precisions of all proposals.
    proposals: That of each step that made one, in order.
    weights: Weight of each of them in the map that it was combined to, in [0, 1].
    """

    positions: Reals
    precision: float = 0.0
    proposals: Mapping[str, Proposal] = field(default_factory=dict)
    weights: Mapping[str, float] = field(default_factory=dict)

    def combined(self, name: str, proposal: Proposal) -> RefinedMap:
        """Average with a proposal, weighted by precision."""
        weight = _weight(proposal.precision, self.precision)
        moved = proposal.positions if weight == 1 else self.positions
        if 0 < weight < 1:
            moved = (1 - weight) * self.positions + weight * proposal.positions
        return RefinedMap(
            np.asarray(moved),
            self.precision + proposal.precision,
            {**self.proposals, name: proposal},
            {**self.weights, name: weight},
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Caveats of all steps."""
        return tuple(note for one in self.proposals.values() for note in one.notes)

    @property
    def facts(self) -> dict[str, Scalar]:
        """The weight of each step that moved the map, and what the steps found."""
        facts: dict[str, Scalar] = {
            f"weight_of_{name}": round(weight, 3) for name, weight in self.weights.items() if weight
        }
        for one in self.proposals.values():
            facts |= one.facts
        return facts

    @property
    def distorted(self) -> bool:
        """Whether any step found that maps of halves share a distortion."""
        return any(one.distorted for one in self.proposals.values())

    @property
    def elongated(self) -> bool:
        """Whether any step found contacts that are long in one direction."""
        return any(one.elongated for one in self.proposals.values())


def refine(
    pairs: PairStatistics,
    metric: Reals,
    positions: Reals,
    steps: Mapping[str, Step],
    options: MethodOptions,
) -> RefinedMap:
    """Pass a map through the steps of a method. metric (n, n), positions (n, k)."""
    refined = RefinedMap(positions)
    for name, step in steps.items():
        if refined.precision == EXACT:
            break
        proposal = step(pairs, metric, refined.positions, options)
        if proposal is not None:
            refined = refined.combined(name, proposal)
            logger.debug("%s has weight %.2f", name, refined.weights[name])
    return refined


def _weight(precision: float, before: float) -> float:
    if precision == 0:
        return 0.0
    return 1.0 if math.isinf(precision) else precision / (precision + before)
