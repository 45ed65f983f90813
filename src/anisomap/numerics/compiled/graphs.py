"""Compiled loops of shortest paths of all pairs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.parallel import loop

Reals = NDArray[np.floating[Any]]
Range = tuple[int, int]  # first, and last (exclusive)

SIDE = 64
"""Nodes per tile. A tile of float64, 32 KiB, fits into the first-level cache.

It is a constant, since loops of a length known to the compiler take three quarters of the time.
"""


@loop()
def tile_number(row: int, column: int, n_blocks: int) -> int:
    """Return the index of a tile in row-major order; `row` must not exceed `column`."""
    return row * (2 * n_blocks - row - 1) // 2 + column


@loop()
def close_tile(tile: Reals) -> None:
    """Replace lengths within a block by lengths of shortest paths (Floyd-Warshall)."""
    for k in range(SIDE):
        through = tile[k].copy()
        for i in range(SIDE):
            to = tile[i, k]
            for j in range(SIDE):
                tile[i, j] = min(tile[i, j], to + through[j])


@loop()
def lower_tile(tile: Reals, left: Reals, right: Reals) -> None:
    """Lower ``tile[i, j]`` to the least ``left[i, k] + right[k, j]``, a (min, +) product.

    Two rows and four middle nodes at a time give eight sums for six loads.
    """
    for i in range(0, SIDE, 2):
        for k in range(0, SIDE, 4):
            u, u1, u2, u3 = left[i, k], left[i, k + 1], left[i, k + 2], left[i, k + 3]
            v, v1 = left[i + 1, k], left[i + 1, k + 1]
            v2, v3 = left[i + 1, k + 2], left[i + 1, k + 3]
            for j in range(SIDE):
                r, r1, r2, r3 = right[k, j], right[k + 1, j], right[k + 2, j], right[k + 3, j]
                tile[i, j] = min(tile[i, j], u + r, u1 + r1, u2 + r2, u3 + r3)
                tile[i + 1, j] = min(tile[i + 1, j], v + r, v1 + r1, v2 + r2, v3 + r3)


@loop()
def reach_blocks(tiles: Reals, middle: int, outwards: Reals, inwards: Reals) -> None:
    """Compute the path lengths from a block of nodes, whose tile is closed, to all blocks J.

    They are stored in ``outwards[J]``, and their transposes in ``inwards[J]``.
    """
    n_blocks = len(outwards)
    within = tiles[tile_number(middle, middle, n_blocks)]
    for block in range(n_blocks):
        if block < middle:
            direct = tiles[tile_number(block, middle, n_blocks)].T.copy()
        else:
            direct = tiles[tile_number(middle, block, n_blocks)]
        outwards[block] = direct
        lower_tile(outwards[block], within, direct)
        inwards[block] = outwards[block].T


@loop()
def lower_block(tiles: Reals, inwards: Reals, outwards: Reals, block: int) -> None:
    """Lower the tiles of the paths from and to a block; see `lower_rows`."""
    n_middles, n_blocks = outwards.shape[:2]
    for other in range(n_blocks):
        row, column = min(block, other), max(block, other)
        tile = tiles[tile_number(row, column, n_blocks)]
        for middle in range(n_middles):
            lower_tile(tile, inwards[middle, row], outwards[middle, column])


@loop()
def lower_rows(tiles: Reals, inwards: Reals, outwards: Reals, rows: Range) -> None:
    """Lower the tiles of some rows by the paths of `reach_blocks` through several blocks."""
    n_middles, n_blocks = outwards.shape[:2]
    for column in range(rows[0], n_blocks):
        for row in range(rows[0], min(rows[1], column + 1)):
            tile = tiles[tile_number(row, column, n_blocks)]
            for middle in range(n_middles):
                lower_tile(tile, inwards[middle, row], outwards[middle, column])
