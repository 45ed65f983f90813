"""Accuracy of a map at three ranges, estimated without the truth, and its systematic errors.

Resamples of a recording show what chance does to a map, but not what bends all maps alike. A map
that rests on another assumption shows this: the numbers of steps between sensors on a graph of
neighbours assume nothing of contacts, but that neighbours are equally far apart. The accuracy of
maps of known skins followed these two measurements, the second of them taken over the whole map or
in regions. The constants are fitted by ``python -m benchmarks.verdicts.calibration`` to maps with
errors of at most a spacing, which also leaves out each kind of skin in turn: of larger errors it
matters only that they are seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.special import expit

from anisomap.evaluation.scoring import median_spacing
from anisomap.numerics.procrustes import fit_similarity

_N_POOLED = 9  # a sensor and its nearest 8, over which squared differences are averaged
_LEAST = 0.01  # spacings: smaller errors are not calibrated


@dataclass(frozen=True)
class Estimate:
    """A number, and the interval that holds the true one for nine of ten maps."""

    value: float
    low: float
    high: float

    def plus(self, size: float) -> Estimate:
        """Return the estimate of the error that another, of a known size, is independent of."""
        return Estimate(*(math.hypot(one, size) for one in (self.value, self.low, self.high)))


BY_CHANCE, BY_DIFFERENCE = 0.57, 0.47
"""Expected error per RMS difference of resamples, and per difference from the map of steps."""

ERROR_INTERVAL = (0.5, 2.0)
"""5 % and 95 % quantiles of true errors, relative to the expected ones."""

REGION_BY_CHANCE, REGION_BY_DIFFERENCE, REGION_INTERVAL = 0.40, 0.51, (0.5, 2.0)
"""Error of regions per RMS difference of resamples, and per difference of regions of the two maps;
and its interval, relative to it.
"""

NEIGHBOURS, NEIGHBOURS_SLOPE, NEIGHBOURS_INTERVAL = 1.35, -1.08, (-1.0, 1.3)
"""Log odds that a neighbour is kept, ``NEIGHBOURS + NEIGHBOURS_SLOPE log(e)``, with the error e of
regions, and their interval.
"""

REGION_RADIUS, MIN_REGION = 5.0, 6
"""Radius of a region in spacings, and sensors of the smallest one."""

ELLIPSE_SCALE = 2.0
"""Ratio of the covariances of positions to the square of the expected error.

The errors of maps spread around the expected ones, and those of sensors around that of their map.
Ellipses of 95 % hold 94 % of the true positions on 180 maps with errors of at most a spacing
(the benchmark `trust`, seeds 7001 to 7119).
"""

_MAX_ERROR = 1e6  # spacings: keeps the odds finite


def expected_error(repeatability: float, difference: float) -> Estimate:
    """Estimate the RMS error of a map from its two measurements, all in spacings.

    Chance and systematic errors are independent, so their squares add up.
    """
    error = math.hypot(BY_CHANCE * repeatability, BY_DIFFERENCE * difference)
    return Estimate(error, *(factor * error for factor in ERROR_INTERVAL))


def region_error(repeatability: float, difference: float, error: float) -> Estimate:
    """Estimate the RMS error of regions, at most that of the map, all in spacings.

    difference: That of regions of two maps, each aligned by itself.
    """
    found = math.hypot(REGION_BY_CHANCE * repeatability, REGION_BY_DIFFERENCE * difference)
    found = min(found, error)
    return Estimate(found, *(factor * found for factor in REGION_INTERVAL))


def neighbours_kept(region: float) -> Estimate:
    """Estimate the share of true neighbours that are neighbours on the map, from `region_error`."""
    odds = NEIGHBOURS + NEIGHBOURS_SLOPE * math.log(min(max(region, _LEAST), _MAX_ERROR))
    return Estimate(*(float(expit(odds + more)) for more in (0.0, *NEIGHBOURS_INTERVAL)))


def rms_in_spacings(differences: NDArray[np.float64], positions: NDArray[np.float64]) -> float:
    """Return the RMS length of differences, shape (n, k), in spacings of a map."""
    spacing = median_spacing(positions)
    rms = math.sqrt(float(np.square(differences).sum(axis=1).mean()))
    return rms / spacing if spacing > 0 else math.inf


def extent_in_spacings(positions: NDArray[np.float64]) -> float:
    """Return the RMS distance of the sensors of a map, (n, k), from their centre, in spacings."""
    return rms_in_spacings(positions - positions.mean(axis=0), positions)


def regional_difference(differences: NDArray[np.float64], positions: NDArray[np.float64]) -> float:
    """Return the RMS difference of two maps in regions that are each aligned, in spacings.

    differences, positions (n, k). A map of fewer than 6 sensors within 5 spacings is one region.
    """
    spacing = median_spacing(positions)
    if spacing == 0 or not np.isfinite(differences).all():
        return math.inf
    near: Any = KDTree(positions).query_ball_point(positions, REGION_RADIUS * spacing)
    squares = []
    for inside in [one for one in near if len(one) >= MIN_REGION] or [slice(None)]:
        here, there = positions[inside], positions[inside] + differences[inside]
        left = fit_similarity(there, here).apply(there) - here
        squares.append(float(np.square(left).sum(axis=1).mean()))
    return math.sqrt(float(np.mean(squares))) / spacing


def pooled(
    found: NDArray[np.float64], positions: NDArray[np.float64], count: int
) -> NDArray[np.float64]:
    """Average values of each sensor over the nearest ones, itself included. found (n, k, k)."""
    nearest = KDTree(positions).query(positions, k=min(count, len(positions)))[1]
    return np.asarray(found[np.asarray(nearest)].mean(axis=1))


def with_systematic_errors(
    chance: NDArray[np.float64],
    differences: NDArray[np.float64],
    positions: NDArray[np.float64],
    error: float,
) -> NDArray[np.float64]:
    """Return covariances of positions that include systematic errors, (n, k, k).

    chance (n, k, k), differences (n, k), positions (n, k).

    The mean of three shapes of equal size: that of chance, that of the differences from another map
    around the sensor, and a sphere; scaled to the expected error, in spacings.
    """
    k = positions.shape[1]
    outer = pooled(np.einsum("ni,nj->nij", differences, differences), positions, _N_POOLED)
    shapes = [_of_unit_size(one) for one in (chance, outer)]
    sphere = np.broadcast_to(np.eye(k) / k, outer.shape)
    size = ELLIPSE_SCALE * (error * median_spacing(positions)) ** 2
    return np.asarray(size * (sum(shapes) + sphere) / 3)


def _of_unit_size(covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scale covariances, shape (n, k, k), such that the mean of their traces is 1."""
    size = float(np.trace(covariances, axis1=1, axis2=2).mean())
    if size > 0:
        return covariances / size
    k = covariances.shape[1]
    return np.broadcast_to(np.eye(k) / k, covariances.shape)
