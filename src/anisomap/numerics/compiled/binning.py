"""Compiled loop of the division of values into bins."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.jit import loop

Ints = NDArray[np.int64]


@loop()
def add_bin(
    costs: Ints,
    ends: Ints,
    least: Ints,
    bounds: tuple[int, int, int, int],
    found: tuple[Ints, Ints],
) -> None:
    """Find the best division of beginnings of the values into one more bin.

    `costs`, shape (T + 1,), contains the cost of a bin of each size; `ends`, shape (m + 1,), the
    cumulative counts of the values; `least`, shape (m + 1,), the least cost without the bin.
    `bounds` consists of the first and last number of values without the bin, and with it. The
    arrays of `found`, the least cost with the bin and the value at which it begins, each of shape
    (m + 1,), are filled. The order of the search is that of
    `anisomap.numerics.similarity.binning`.
    """
    lowest, highest, first, last = bounds
    result, cut = found
    stride = 1
    while 2 * stride <= last - first + 1:
        stride *= 2
    while stride > 0:
        for end in range(first + stride - 1, last + 1, 2 * stride):
            low = lowest if end - stride < first else cut[end - stride]
            high = min(highest if end + stride > last else cut[end + stride], end - 1)
            best, at = least[low] + costs[ends[end] - ends[low]], low
            for begin in range(low + 1, high + 1):
                cost = least[begin] + costs[ends[end] - ends[begin]]
                if cost < best:
                    best, at = cost, begin
            result[end], cut[end] = best, at
        stride //= 2
