"""Compiled inner loop of the search for the most similar rows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.jit import loop

Singles = NDArray[np.float32]
Ints = NDArray[np.int64]


@loop()
def keep_greatest(
    block: Singles, left: int, own: Ints, groups: Ints, greatest: tuple[Ints, Singles]
) -> None:
    """Keep, for each row of a block of a matrix, its greatest entries in falling order.

    The block begins with column `left` of the matrix. Of row i, row i of `greatest` is what was
    kept so far: columns and entries. Columns of its `own` group are passed over.
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
