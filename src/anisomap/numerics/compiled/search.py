"""Compiled loop of the search for the greatest entries of each row of a matrix."""

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
