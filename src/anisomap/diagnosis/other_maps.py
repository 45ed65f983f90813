"""Other maps that explain a recording about as well: what all of them share can be relied on.

Each map rests on one assumption. The default method assumes that contacts are alike everywhere.
Paths of neighbours assume nothing of distant sensors, but that similar sensors are close. A map of
evenly spaced sensors assumes nothing of contacts, but that neighbours are equally far apart. Where
an assumption fails, maps differ, even if maps of parts of the recording agree.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse.csgraph import shortest_path

from anisomap.evaluation.alignment import align
from anisomap.evaluation.neighbourhood import median_spacing
from anisomap.numerics.geodesic.neighbours import neighbour_graph
from anisomap.numerics.graph.local_paths import local_path_lengths
from anisomap.numerics.precision import Reals
from anisomap.numerics.scaling.stress_minimisation import smacof

N_NEIGHBOURS = 5
"""Neighbours of each sensor in the map along paths.

Few, so that paths differ from the map of all correlations: differences from maps of 5, 8 and 15
neighbours followed the true error about equally well (tuning seeds 1 to 28), and those from 5 best.
"""


@dataclass(frozen=True)
class OtherMaps:
    """RMS differences of a map from other maps, after the best similarity, in its spacings.

    Attributes
    ----------
    paths : float
        From the map of path lengths along the most similar sensors.
    even : float
        From the map of the numbers of steps between sensors on a graph of adjacent sensors.
    """

    paths: float
    even: float


def compare_with_other_maps(
    readings: ArrayLike,
    positions: ArrayLike,
    similarity: ArrayLike,
    *,
    changes: ArrayLike | None = None,
    correlation: ArrayLike | None = None,
) -> OtherMaps:
    """Measure how much other maps of the same recording differ from a map.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings in temporal order, T >= 3.
    positions : array_like of shape (N, k)
        The map; at least 4 sensors, not all at one place.
    similarity : array_like of shape (N, N)
        Correlations of the readings.
    changes : array_like of shape (N, N), optional
        Blended correlations of the differences between frames, if already computed.
    correlation : array_like of shape (N, N), optional
        `blended_correlation` of the readings, if the similarity is another one; sensors are judged
        adjacent by it.

    Returns
    -------
    OtherMaps
        0 if all assumptions lead to the same map.
    """
    points, values = np.asarray(positions, dtype=np.float64), np.asarray(similarity)
    graph = neighbour_graph(
        readings, points, similarity=values if correlation is None else correlation, changes=changes
    )
    steps = shortest_path(graph.adjacency.astype(np.float64), unweighted=True)
    paths = local_path_lengths(values, min(N_NEIGHBOURS, len(points) - 1))
    return OtherMaps(paths=_difference(points, paths), even=_difference(points, steps))


def _difference(positions: Reals, lengths: Reals) -> float:
    """RMS difference of a map from the scaled lengths, in spacings of the map."""
    spacing = median_spacing(positions)
    if spacing == 0 or not np.isfinite(lengths).all() or not lengths.any():
        return float("inf")
    # Classical scaling as start: the other maps must not inherit a fold of this one.
    scaled = smacof(lengths, dimensions=positions.shape[1])
    return align(scaled.positions, positions).rms / spacing
