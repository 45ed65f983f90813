"""Compiled loop over the neighbours of connected nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.jit import loop

Ints = NDArray[np.int64]


@loop()
def count_shared(offsets: Ints, ends: Ints, shared: Ints) -> None:
    """Count, for each edge of a graph, the common neighbours of its ends.

    The edges of node u lead to ``ends[offsets[u]:offsets[u + 1]]``, in increasing order. Counts
    are added to `shared`, shaped like `ends`.
    """
    for i in range(len(offsets) - 1):
        for edge in range(offsets[i], offsets[i + 1]):
            j = ends[edge]
            a, b = offsets[i], offsets[j]
            while a < offsets[i + 1] and b < offsets[j + 1]:
                if ends[a] == ends[b]:
                    shared[edge] += 1
                    a += 1
                    b += 1
                elif ends[a] < ends[b]:
                    a += 1
                else:
                    b += 1
