"""Distances along paths of neighbours, from correlations."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from anisomap.numerics.graph.connectivity import neighbour_graph, spanning_tree
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.precision import Reals

N_NEIGHBOURS = 8
"""Neighbours of each sensor. On real skins, 6 to 20 give about equal maps."""

_CORRELATIONS = (1e-3, 1 - 1e-6)  # bounds that keep lengths finite and above 0


def local_path_lengths(similarity: ArrayLike, n_neighbours: int = N_NEIGHBOURS) -> Reals:
    """Measure distances along a neighbour graph.

    similarity (N, N) -> (N, N).

    An edge has length ``sqrt(-log s)``, the distance at which the correlation ``exp(-d^2)`` is s.
    Paths as in Isomap: Tenenbaum et al. (2000), doi:10.1126/science.290.5500.2319. Only
    correlations of neighbours are used, so differences between the contacts of distant regions
    have no effect.
    """
    correlation = as_symmetric(similarity, "similarity")
    np.fill_diagonal(correlation, 1.0)
    lengths = np.sqrt(-np.log(np.clip(correlation, *_CORRELATIONS)))
    linked = neighbour_graph(correlation, n_neighbours)
    # Weak links are bounded, hence equally long; the tree distinguishes them by the similarity.
    linked |= spanning_tree(2.0 - correlation)
    lengths = np.where(linked, lengths, np.inf)
    np.fill_diagonal(lengths, 0.0)
    return metricise(lengths)
