"""Evidence for a change of places: likelihood, its uncertainty, and what chance gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.distance import cdist

from anisomap.layout.chance import Chance, agreement_gain, median_gain, own_agreement
from anisomap.layout.evidence import MIN_GAIN, Evidence, Move, coded
from anisomap.layout.readings import ReadingStatistics

MIN_Z = 3.0
"""Least gain of a change, in standard errors of the jackknife over parts of the recording."""

MIN_GROUP_GAIN = 30.0
"""Least gain in nats of a module or a run, whose pairs have errors in common."""

_IN_PLACE = 40.0  # the same of a module that is turned at its place, in one of a dozen ways

_MIN_RIGID = 0.48
"""Least gain of agreement of a patch on free places, relative to the median agreement.

Places that no sensor has are many, and fit a patch at an edge better than its own by chance: on the
right layouts of nao_torso, nao_head and insole_L, patches gained up to 0.45.
"""


@dataclass(frozen=True, eq=False)
class Verdict:
    """Evidence for a move.

    gain: Increase of the log-likelihood, in nats.
    least: What it must be at least.
    z: Gain in standard errors.
    agreement_gain: Increase of the mean similarity to the sensors around.
    chance: Largest such increase of shifted readings.
    median_gain: Such increase of the median sensor; 0 if less than half of all stay in place.
    in_place: Whether a module is turned at its place.
    not_missed: Whether the sensors around the stated places gain, too, if these are left.
    """

    gain: float
    least: float
    z: float
    agreement_gain: float
    chance: float
    median_gain: float
    not_missed: bool = True
    in_place: bool = False

    @property
    def holds(self) -> bool:
        """Whether the move explains the readings better than the uncertainty and chance do.

        Most of its sensors must gain: a few wrong ones among right ones would agree better wherever
        all of them were moved.
        """
        return (
            self.gain >= self.least
            and self.z >= MIN_Z
            and self.agreement_gain > (0.0 if self.in_place else max(self.chance, 0.0))
            and (self.in_place or self.median_gain > 0)
            and self.not_missed
        )


class Judge:
    """Weighs moves by the statistics of the readings.

    evidence: At the stated places.
    """

    def __init__(self, statistics: ReadingStatistics, evidence: Evidence) -> None:
        self._parts = np.stack([coded(part) for part in statistics.parts])
        own = own_agreement(evidence)[evidence.usable]
        own = own[np.isfinite(own)]
        self._typical = float(np.median(own)) if own.size else 0.0
        self._chance = Chance.of(statistics.shifted, evidence)

    def certainly_gains(self, evidence: Evidence, move: Move) -> bool:
        """Return whether the likelihood rises beyond its uncertainty."""
        gain, z = self.gain(evidence, move)
        return gain >= MIN_GROUP_GAIN and z >= MIN_Z

    def gain(self, evidence: Evidence, move: Move) -> tuple[float, float]:
        """Return the gain of a move, and it in standard errors."""
        gain, parts = evidence.gain(move), np.array(evidence.gains(move, self._parts))
        variance = np.sum((parts - parts.mean()) ** 2) * (1 - 1 / len(parts))
        return gain, gain / max(float(np.sqrt(variance)), 1e-9)

    def weigh(
        self,
        evidence: Evidence,
        move: Move,
        alternatives: Sequence[Move] = (),
        *,
        rigid: bool = False,
        in_place: bool = False,
    ) -> Verdict:
        """Weigh the evidence for a move.

        alternatives: Moves among which it was chosen; by default, each sensor could have had any
            place.
        rigid: Whether to places that no sensor has. Readings of the sensors of a patch have errors
            in common, and each pair of them must gain as much as two that are swapped.
        in_place: Whether it turns a module at its place. Half of its sensors may have no others
            around them then, so that agreement tells less.
        """
        least = _IN_PLACE if in_place else MIN_GROUP_GAIN if alternatives else MIN_GAIN
        if rigid:
            least = max(least, MIN_GAIN * len(move.sensors) / 2)
        gain, z = self.gain(evidence, move)
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
        of_all = min(of_all, of_median) if (alternatives or rigid) and not in_place else of_all
        # Layouts of closed bodies are cut open: a module is near others on both sides of the cut.
        alone = not rigid or _around(evidence, move).gain(move) >= 0
        return Verdict(gain, least, z, of_all, chance, of_median, alone, in_place)


def _around(evidence: Evidence, move: Move) -> Evidence:
    """Return the evidence of the moved sensors with those around their present places only."""
    distances = cdist(evidence.positions[move.sensors], evidence.positions)
    near = np.asarray((distances <= evidence.reach).any(axis=0))
    near[move.sensors] = True
    return replace(evidence, usable=evidence.usable & near)
