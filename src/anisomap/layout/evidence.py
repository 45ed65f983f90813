"""Likelihood of similarities at distances on a layout, and its gain by moves of sensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression
from scipy.spatial.distance import cdist, pdist

from anisomap.numerics.neighbours import nearest_distances
from anisomap.numerics.precision import Reals

_MIN_PAIRS = 6  # per bin, for a median and a spread; chosen by hand
_MIN_SPREAD = 0.05  # of a similarity; prevents dominance of distant pairs, which agree closely
_RESOLUTION = 4  # steps per spacing; edges of bins are multiples
_LARGEST = 1000  # spacings; all larger distances are in the last bin
# Edges of bins in spacings, chosen by hand: 1.25, 1.75 ... 11.75, then at equal ratios.
_EDGES = np.concatenate(
    [
        np.arange(1.25, 12, 0.5),
        np.round(np.geomspace(12.5, _LARGEST, 25) * _RESOLUTION) / _RESOLUTION,
    ]
)
_BIN_OF_STEP = np.searchsorted(
    _EDGES, np.arange(_LARGEST * _RESOLUTION + 1) / _RESOLUTION, side="right"
).astype(np.uint8)
# Degrees of freedom of Student's t distribution, which limits the weight of outlying pairs. Between
# 2 and 5, the results on icub_torso and nao_torso differ little (seeds 1 to 40).
_DEGREES = 3.0


@dataclass(frozen=True, eq=False)
class Falloff:
    """Distribution of the similarity of two sensors, given their distance.

    spacing: Median distance between neighbours, in units of the positions.
    level (B,): Median similarity in each bin; does not increase.
    spread (B,): Spread of the similarity in each bin: 1.48 times the median absolute deviation.
    """

    spacing: float
    level: NDArray[np.float64]
    spread: NDArray[np.float64]

    def bins(self, distances: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the bin of each distance, given in units of the positions."""
        steps = distances * (_RESOLUTION / self.spacing)
        return _BIN_OF_STEP[np.minimum(steps, len(_BIN_OF_STEP) - 1).astype(np.int32)]

    @cached_property
    def table(self) -> NDArray[np.float32]:
        """Log-likelihood ratio of each similarity code in each bin to the last bin, (B, 256)."""
        similarity = np.arange(_N_CODES) / _PER_UNIT - 1
        deviation = (similarity - self.level[:, None]) / self.spread[:, None]
        tail = (_DEGREES + 1) / 2 * np.log1p(deviation**2 / _DEGREES)
        likelihood = -np.log(self.spread)[:, None] - tail
        return np.asarray(likelihood - likelihood[-1], dtype=np.float32)

    def ratio(self, codes: NDArray[np.uint8], bins: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return log-likelihood ratios of `coded` similarities in bins to the last bin."""
        return np.asarray(self.table.ravel().take(bins.astype(np.intp) * _N_CODES + codes))

    @cached_property
    def expected(self) -> NDArray[np.float32]:
        """Log-likelihood ratio of the median similarity in each bin, (B,)."""
        return np.asarray(self.table[np.arange(len(self.level)), coded(self.level)])


_N_CODES = 256
_PER_UNIT = (_N_CODES - 1) / 2


def coded(similarity: Reals) -> NDArray[np.uint8]:
    """Round similarities to codes, the indices of likelihoods."""
    codes: NDArray[np.uint8] = np.rint((similarity + 1) * _PER_UNIT).astype(np.uint8)
    return codes


def neighbour_spacing(positions: NDArray[np.float64]) -> float:
    """Return the median distance to the nearest sensor at another position; 0 if there is none."""
    places = np.unique(positions, axis=0)
    return float(np.median(nearest_distances(places))) if len(places) > 1 else 0.0


def fit_falloff(similarity: Reals, positions: NDArray[np.float64], spacing: float) -> Falloff:
    """Fit the falloff of similarity with distance. similarity (n, n), positions (n, k)."""
    pairs = np.triu_indices(len(positions), 1)
    values = np.asarray(similarity[pairs], dtype=np.float64)
    distances = pdist(positions) / spacing
    label = np.searchsorted(_EDGES, distances, side="right")
    order = np.argsort(label, kind="stable")
    every = np.arange(len(_EDGES) + 1)
    found = []
    for k, inside in enumerate(np.split(values[order], np.searchsorted(label[order], every[1:]))):
        if inside.size >= _MIN_PAIRS:
            middle = np.median(inside)
            found.append((k, middle, 1.4826 * np.median(np.abs(inside - middle)), inside.size))
    if not found:  # sensors are too few for any bin
        found = [(0, np.median(values), np.ptp(values) / 2, 1)]
    centre, level, spread, weight = np.transpose(found)
    decreasing = isotonic_regression(level, weights=weight, increasing=False).x
    return Falloff(
        spacing,
        np.interp(every, centre, decreasing),
        np.maximum(np.interp(every, centre, spread), _MIN_SPREAD),
    )


REACH = 2.6
"""Maximum distance of neighbours in spacings; chosen by hand.

The second ring of a hexagonal lattice is 2 spacings away, and modules have gaps of 2.2 spacings.
"""


MIN_DISPLACEMENT = 3.0
"""Minimum spacings to a free place: contacts of unequal reach shift sensors by up to 2.5."""


@dataclass(frozen=True, eq=False)
class Move:
    """New positions of some sensors.

    places (m, k): New positions of the sensors.
    """

    sensors: NDArray[np.intp]
    places: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Proposal:
    """A move and its gain.

    gain: Increase of the log-likelihood of all similarities, in nats.
    kind: ``"swapped"``, ``"shifted"`` or ``"moved"`` to free places.
    """

    gain: float
    move: Move
    kind: str = "swapped"


@dataclass(frozen=True, eq=False)
class Evidence:
    """Similarities of n sensors, and positions for comparison.

    similarity (n, n): Similarity of each pair of sensors.
    codes (n, n): `coded` similarities.
    positions (n, k): Current positions.
    usable: Sensors whose similarities are evidence.
    """

    similarity: Reals
    codes: NDArray[np.uint8]
    positions: NDArray[np.float64]
    usable: NDArray[np.bool_]
    falloff: Falloff

    @classmethod
    def of(
        cls,
        similarity: Reals,
        positions: NDArray[np.float64],
        usable: NDArray[np.bool_],
        spacing: float,
    ) -> Evidence:
        """Fit the falloff of the usable sensors at some positions."""
        inside = similarity[np.ix_(usable, usable)]
        falloff = fit_falloff(inside, positions[usable], spacing)
        return cls(similarity, coded(similarity), positions, usable, falloff)

    def refitted(self) -> Evidence:
        """Return a copy with the falloff of the current positions."""
        return Evidence.of(self.similarity, self.positions, self.usable, self.falloff.spacing)

    def moved(self, move: Move) -> Evidence:
        """Return a copy with some sensors at other positions."""
        positions = self.positions.copy()
        positions[move.sensors] = move.places
        return replace(self, positions=positions)

    @cached_property
    def bins(self) -> NDArray[np.uint8]:
        """Bins of the distances between current positions, shape (n, n)."""
        return self.falloff.bins(cdist(self.positions, self.positions))

    @cached_property
    def known(self) -> NDArray[np.bool_]:
        """Pairs of two different usable sensors, shape (n, n)."""
        return np.outer(self.usable, self.usable) & ~np.eye(len(self.usable), dtype=bool)

    @cached_property
    def ratios(self) -> NDArray[np.float32]:
        """Log-likelihood ratio of each pair at current positions; 0 for pairs not `known`."""
        return np.where(self.known, self.falloff.ratio(self.codes, self.bins), np.float32(0))

    def gain(self, move: Move) -> float:
        """Return the increase of the log-likelihood by a joint move of some sensors."""
        return float(self.gains(move.sensors, self.codes[None])(move.places)[0])

    def gains(
        self, sensors: NDArray[np.intp], codes: NDArray[np.uint8]
    ) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
        """Return the `gain` of sensors as a function of their new places (m, k).

        codes (g, n, n): Similarities, for each of which there is a gain.
        """
        kept = self.usable[sensors]
        moved, outside = sensors[kept], self.usable.copy()
        outside[moved] = False
        beside = self.positions[outside]
        across = [one[np.ix_(moved, outside)] for one in codes]
        within = [one[np.ix_(moved, moved)] for one in codes]

        def fit(places: NDArray[np.float64]) -> NDArray[np.float64]:
            # Pairs of moved sensors have the distances of the new places, and are counted twice.
            sums = [
                [self.falloff.ratio(one, bins).sum(dtype=np.float64) for one in some]
                for some, bins in (
                    (across, self.falloff.bins(cdist(places, beside))),
                    (within, self.falloff.bins(cdist(places, places))),
                )
            ]
            return np.asarray(np.array([1, 0.5]) @ sums)

        before = fit(self.positions[moved])
        return lambda places: fit(places[kept]) - before

    @property
    def reach(self) -> float:
        """Distance up to which sensors count as neighbours, in units of the positions."""
        return REACH * self.falloff.spacing


MIN_GAIN = 15.0
"""Minimum gain of a move in nats.

On the correct layouts of icub_torso and nao_torso, no swap gains more than 5; each of 300 seeded
swaps of 3 spacings and more gained 35 and more (seed 1).
"""
