"""Shortest paths from some landmarks to all sensors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from anisomap.large.landmarks.options import loops
from anisomap.numerics.compiled.parallel import parallel_map

TOGETHER = 64
"""Landmarks that are gone out from together."""


def paths_from(landmarks: ArrayLike, graph: csr_array[Any, tuple[int, int]]) -> NDArray[np.float32]:
    """Find the lengths of the shortest paths from landmarks to all sensors.

    Parameters
    ----------
    landmarks : array_like of int, shape (L,)
        Sensors.
    graph : csr_array of shape (N, N)
        Lengths of edges, above 0; symmetric.

    Returns
    -------
    ndarray of float32, shape (N, L)
        Infinite where there is no path. The length of a path of h edges errs by some h 1e-7 of it.
    """
    sources = np.asarray(landmarks, dtype=np.int64)
    order = reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.int64)
    edges = (
        graph.indptr.astype(np.int64),
        graph.indices.astype(np.int64),
        graph.data.astype(np.float32),
    )
    found = np.empty((graph.shape[0], len(sources)), dtype=np.float32)
    # Landmarks that follow one another in the order are near: they go the same ways.
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    ranked = np.argsort(place[sources], kind="stable")

    def go(begin: int) -> None:
        chosen = ranked[begin : begin + TOGETHER]
        tile = np.empty((len(found), len(chosen)), dtype=np.float32)
        loops().relax_from(tile, sources[chosen], order, edges)
        found[:, chosen] = tile

    with parallel_map(len(found)) as spread_over:
        spread_over(go, range(0, len(sources), TOGETHER))
    return found
