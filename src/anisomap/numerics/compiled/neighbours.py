"""Compiled loop over the neighbours of connected nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.jit import loop


@loop()
def count_shared(
    offsets: NDArray[np.int64], ends: NDArray[np.uint32], shared: NDArray[np.int64]
) -> None:
    """Count, for each edge of a graph, the common neighbours of its two ends.

    The edges of node u lead to ``ends[offsets[u]:offsets[u + 1]]``; `shared` has the shape of
    `ends`. Unsigned node numbers avoid the check for negative indices.
    """
    is_neighbour = np.zeros(len(offsets) - 1, np.uint8)
    for i in range(len(offsets) - 1):
        for edge in range(offsets[i], offsets[i + 1]):
            is_neighbour[ends[edge]] = 1
        for edge in range(offsets[i], offsets[i + 1]):
            j = ends[edge]
            others = ends[offsets[j] : offsets[j + 1]]
            total = np.uint32(0)
            for k in range(others.size):
                total += is_neighbour[others[k]]
            shared[edge] = total
        for edge in range(offsets[i], offsets[i + 1]):
            is_neighbour[ends[edge]] = 0
