"""Common neighbours of connected sensors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from anisomap.numerics.compiled.parallel import load_loops

MIN_SHARED = 0.3
"""Minimum share of the neighbours that adjacent sensors have in common.

It is slightly below the geometric values: a half on a line, a third or more in a plane.
"""


def count_shared_neighbours(graph: csr_array[Any, tuple[int, int]]) -> NDArray[np.int64]:
    """Count the common neighbours of the two ends of each edge.

    Parameters
    ----------
    graph : csr_array of shape (N, N)
        Symmetric, without loops; every stored entry is an edge.

    Returns
    -------
    ndarray of int64, shape (n_edges,)
        In the order of ``graph.indices``.
    """
    shared = np.zeros(graph.nnz, dtype=np.int64)
    offsets, ends = graph.indptr.astype(np.int64), graph.indices.astype(np.uint32)
    load_loops("neighbours").count_shared(offsets, ends, shared)
    return shared
