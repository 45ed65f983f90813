"""How similarity falls with distance on a layout, and how likely a similarity is at a distance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist

from anisomap.numerics.precision import Reals

_MIN_PAIRS = 6  # per bin, for a median and a spread; chosen by hand
_MIN_SPREAD = 0.05  # of a similarity; keeps distant pairs, which agree closely, from dominating
_RESOLUTION = 4  # steps per spacing, of which the edges of bins are multiples
_LARGEST = 1000  # spacings; all larger distances are in the last bin
# Edges of bins in spacings, chosen by hand: 1.25, 1.75 ... 11.75, and then in equal ratios.
_EDGES = np.concatenate(
    [
        np.arange(1.25, 12, 0.5),
        np.round(np.geomspace(12.5, _LARGEST, 25) * _RESOLUTION) / _RESOLUTION,
    ]
)
_BIN_OF_STEP = np.searchsorted(
    _EDGES, np.arange(_LARGEST * _RESOLUTION + 1) / _RESOLUTION, side="right"
).astype(np.uint8)
_DEGREES = 3.0
"""Degrees of freedom of Student's t distribution: single pairs that fit no distance count little.

Between 2 and 5, the results on icub_torso and nao_torso differ little (seeds 1 to 40).
"""


@dataclass(frozen=True, eq=False)
class Falloff:
    """Distribution of the similarity of two sensors, given their distance.

    Attributes
    ----------
    spacing : float
        Median distance between neighbours, in units of the positions.
    level : ndarray of shape (B,)
        Median similarity in each bin; does not increase.
    spread : ndarray of shape (B,)
        Spread of the similarity in each bin: 1.48 times the median absolute deviation.
    """

    spacing: float
    level: NDArray[np.float64]
    spread: NDArray[np.float64]

    def bins(self, distances: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Return the bin of each distance, given in units of the positions."""
        steps = distances * (_RESOLUTION / self.spacing)
        return _BIN_OF_STEP[np.minimum(steps, len(_BIN_OF_STEP) - 1).astype(np.int32)]

    def log_likelihood(self, similarity: Reals, bins: NDArray[np.uint8]) -> NDArray[np.float64]:
        """Return the log-likelihood of similarities at distances, up to a constant.

        Parameters
        ----------
        similarity : ndarray
        bins : ndarray of int
            Bins of the distances, of a shape that broadcasts with `similarity`.

        Returns
        -------
        ndarray
            In nats. Student's t distribution with 3 degrees of freedom.
        """
        spread = self.spread[bins]
        deviation = (similarity - self.level[bins]) / spread
        tail = (_DEGREES + 1) / 2 * np.log1p(deviation**2 / _DEGREES)
        return np.asarray(-tail - np.log(spread))


def neighbour_spacing(positions: NDArray[np.float64]) -> float:
    """Return the median distance to the nearest sensor at another position; 0 if there is none."""
    places = np.unique(positions, axis=0)
    if len(places) < 2:
        return 0.0
    nearest = np.asarray(KDTree(places).query(places, k=2)[0])
    return float(np.median(nearest[:, 1]))


def fit_falloff(similarity: Reals, positions: NDArray[np.float64], spacing: float) -> Falloff:
    """Fit the falloff of similarity with distance.

    Parameters
    ----------
    similarity : ndarray of shape (n, n)
        Symmetric.
    positions : ndarray of shape (n, k)
        Finite; most of them right: medians ignore the similarities of a minority.
    spacing : float
        Above 0.

    Returns
    -------
    Falloff
    """
    pairs = np.triu_indices(len(positions), 1)
    values = np.asarray(similarity[pairs], dtype=np.float64)
    distances = pdist(positions) / spacing
    label = np.searchsorted(_EDGES, distances, side="right")
    order = np.argsort(label, kind="stable")
    ends = np.searchsorted(label[order], np.arange(len(_EDGES) + 2))
    centre, level, spread, weight = [], [], [], []
    for k in range(len(_EDGES) + 1):
        inside = values[order[ends[k] : ends[k + 1]]]
        if inside.size >= _MIN_PAIRS:
            middle = float(np.median(inside))
            centre.append(k)
            level.append(middle)
            spread.append(1.4826 * float(np.median(np.abs(inside - middle))))
            weight.append(inside.size)
    if not centre:  # so few sensors that no bin is filled
        centre, weight = [0], [1]
        level, spread = [float(np.median(values))], [float(np.ptp(values)) / 2]
    decreasing = isotonic_regression(level, weights=weight, increasing=False).x
    every = np.arange(len(_EDGES) + 1)
    return Falloff(
        spacing,
        np.interp(every, centre, decreasing),
        np.maximum(np.interp(every, centre, spread), _MIN_SPREAD),
    )
