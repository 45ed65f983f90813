"""Evidence for a change of places: likelihood, its uncertainty, and agreement with neighbours."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial.distance import cdist

from anisomap.layout.evidence import MIN_GAIN, REACH, Evidence, Move, coded
from anisomap.layout.readings import ReadingStatistics

MIN_Z = 3.0
"""Minimum gain of a change, in standard errors of the jackknife over parts of the recording."""

MIN_GROUP_GAIN = 30.0
"""Minimum gain in nats of a module or run, whose pairs have common errors, or at a free place."""

_IN_PLACE, _LIKELY = 40.0, 60.0  # the same for a module that is turned in its place
_CERTAIN_Z = 5.0  # below it, correct modules beside a moved patch gained up to 51

_MIN_AGREEMENT, _MIN_OF_FEW = 0.48, 0.1
"""Minimum gain of agreement, relative to the median agreement, at any place and at one of a few.

If readings are shifted in time, the best of all places agrees better than the correct place by 0.4
to 0.55 (torso and arm of an iCub). On the correct layouts of nao_torso, nao_head and insole_L,
patches on free places gained up to 0.45.
"""

_WIDTH = 1.3  # spacings, of the Gaussian weights of neighbours; chosen by hand
_MIN_WEIGHT = 0.3  # of all neighbours: about one sensor at 2 spacings; chosen by hand


@dataclass(frozen=True, eq=False)
class Verdict:
    """Evidence for a move.

    gain: Increase of the log-likelihood, in nats.
    least: Minimum gain.
    z: Gain in standard errors.
    agrees: Whether the sensors also agree better with their neighbours. Most sensors of a group
        must: a few wrong sensors among correct ones would agree better at any place of the group.
    """

    gain: float
    least: float
    z: float
    agrees: bool

    @property
    def told(self) -> bool:
        """Whether the likelihood increases beyond its uncertainty."""
        return self.gain >= self.least and self.z >= MIN_Z

    @property
    def holds(self) -> bool:
        """Whether the move explains the readings better."""
        return self.told and self.agrees


class Judge:
    """Weighs moves by the statistics of the readings.

    evidence: Evidence at the stated places.
    few: Whether contacts are few, so that each change must gain twice as much.
    """

    def __init__(self, statistics: ReadingStatistics, evidence: Evidence, *, few: bool) -> None:
        self._price = 2.0 if few else 1.0
        self._parts = np.stack([coded(part) for part in statistics.parts])
        own = own_agreement(evidence)[evidence.usable]
        own = own[np.isfinite(own)]
        self._typical = float(np.median(own)) if own.size else 0.0

    def certainly_gains(self, evidence: Evidence, move: Move) -> bool:
        """Return whether the likelihood increases beyond its uncertainty."""
        gain, z = self.gain(evidence, move)
        return gain >= MIN_GROUP_GAIN and z >= MIN_Z

    def gain(self, evidence: Evidence, move: Move) -> tuple[float, float]:
        """Return the gain of a move, in nats and in standard errors."""
        gain, parts = evidence.gain(move), evidence.gains(move.sensors, self._parts)(move.places)
        variance = np.sum((parts - parts.mean()) ** 2) * (1 - 1 / len(parts))
        return gain, gain / max(float(np.sqrt(variance)), 1e-9)

    def weigh(
        self,
        evidence: Evidence,
        move: Move,
        *,
        group: bool = False,
        free: bool = False,
        few: bool = False,
        in_place: bool = False,
    ) -> Verdict:
        """Weigh the evidence for a move.

        group: Whether sensors move together, like a module.
        free: Whether the move is to free places. Readings of sensors of a patch have common errors,
            so each pair must gain as much as two swapped sensors.
        few: Whether the group is at one of a few places: of other modules, or some channels on.
        in_place: Whether the move turns a module at its place. Half of its sensors may then have
            no neighbours, so that agreement is weaker evidence.
        """
        gain, z = self.gain(evidence, move)
        turned = _IN_PLACE if z >= _CERTAIN_Z else _LIKELY
        least = turned if in_place else MIN_GROUP_GAIN if group or free else MIN_GAIN
        if free:
            least = max(least, MIN_GAIN * len(move.sensors) / 2)
        least *= self._price
        gains = agreement_gains(evidence, move) if gain >= least else np.empty(0)
        if not gains.size:
            return Verdict(gain, least, z, agrees=False)
        of_all = float(gains.mean())
        if in_place:
            return Verdict(gain, least, z, agrees=of_all > 0)
        if group or free:
            of_all = float(np.median(gains))
        agrees = (
            of_all > self._typical * (_MIN_OF_FEW if few else _MIN_AGREEMENT)
            # A correct sensor must not take part in an exchange of others.
            and (group or free or gains[0] > 0)
            and 2 * len(move.sensors) <= np.count_nonzero(evidence.usable)
            # In layouts of closed bodies, cut open, a module is near others on both sides of a cut.
            and (not free or around(evidence, move).gain(move) >= 0)
        )
        return Verdict(gain, least, z, bool(agrees))


def around(evidence: Evidence, move: Move) -> Evidence:
    """Return the evidence of the moved sensors with sensors around their present places only."""
    distances = cdist(evidence.positions[move.sensors], evidence.positions)
    near = np.asarray((distances <= evidence.reach).any(axis=0))
    near[move.sensors] = True
    return replace(evidence, usable=evidence.usable & near)


def agreement(
    evidence: Evidence, sensors: NDArray[np.intp], places: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the mean similarity of sensors to unmoved sensors around places.

    places (m, k) -> (m,); NaN without neighbours.
    """
    others = evidence.usable.copy()
    others[sensors] = False
    weights = _weights(evidence, cdist(places, evidence.positions[others]))
    weights *= evidence.usable[sensors][:, None]
    return _means((weights * evidence.similarity[sensors][:, others]).sum(axis=1), weights)


def agreement_gains(evidence: Evidence, move: Move) -> NDArray[np.float64]:
    """Return the increase of the `agreement` of each sensor that a move displaces, sorted.

    Without neighbours, agreement is 0; sensors without neighbours before and after are excluded.
    """
    here = evidence.positions[move.sensors]
    before, after = (agreement(evidence, move.sensors, places) for places in (here, move.places))
    counted = (move.places != here).any(axis=1) & (np.isfinite(before) | np.isfinite(after))
    return np.sort((np.nan_to_num(after) - np.nan_to_num(before))[counted])


def own_agreement(evidence: Evidence) -> NDArray[np.float64]:
    """Return the `agreement` of each sensor alone at its position, shape (n,)."""
    weights: Any = neighbour_weights(evidence)
    sums = weights.multiply(np.asarray(evidence.similarity, dtype=np.float64)).sum(axis=1)
    return _means(np.asarray(sums), weights)


def neighbour_weights(evidence: Evidence) -> Any:
    """Return the weights of the usable sensors around each position, except its own sensor."""
    weights = _weights(evidence, cdist(evidence.positions, evidence.positions))
    weights *= evidence.usable
    np.fill_diagonal(weights, 0)
    return csr_array(weights)


def _weights(evidence: Evidence, distances: NDArray[np.float64]) -> NDArray[np.float64]:
    spacings = distances / evidence.falloff.spacing
    return np.where(spacings <= REACH, np.exp(-((spacings / _WIDTH) ** 2) / 2), 0.0)


def _means(sums: NDArray[np.float64], weights: Any) -> NDArray[np.float64]:
    """Divide sums by sums of weights; NaN where these are small."""
    total = np.asarray(weights.sum(axis=1))
    unknown = np.full(sums.shape, np.nan)
    return np.asarray(np.divide(sums, total, out=unknown, where=total > _MIN_WEIGHT))
