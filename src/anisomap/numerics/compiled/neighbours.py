"""Compiled loops over the neighbours of nodes, and their search."""

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


Singles = NDArray[np.float32]
Ints = NDArray[np.int64]


@loop()
def keep_greatest(
    block: Singles, left: int, own: Ints, groups: Ints, greatest: tuple[Ints, Singles]
) -> None:
    """Update the greatest entries of each row with a block of columns.

    `block` contains the columns of the matrix from `left` on. `greatest` contains column numbers
    and entries per row, in decreasing order of the entries. Columns of the row's `own` group are
    skipped.
    """
    ends, values = greatest
    count = ends.shape[1]
    for i in range(len(block)):
        row, kept, places = block[i], values[i], ends[i]
        least = kept[count - 1]
        for j in range(len(row)):
            if row[j] > least and groups[left + j] != own[i]:
                place = count - 1
                while place > 0 and kept[place - 1] < row[j]:
                    kept[place] = kept[place - 1]
                    places[place] = places[place - 1]
                    place -= 1
                kept[place] = row[j]
                places[place] = left + j
                least = kept[count - 1]
