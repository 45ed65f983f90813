"""Compiled loops of shortest paths."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.jit import loop

Reals = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]
Range = tuple[int, int]  # from the first to before the last

WIDTH = 512  # columns at a time, which fit into the first-level cache


@loop()
def min_plus(paths: Reals, left: Reals, right: Reals, rows: Range, columns: Range) -> None:
    """Lower ``paths[i, j]`` to the least ``left[i, k] + right[k, j]``, a (min, +) product.

    Only the given `rows` and `columns` of `paths` are used.
    """
    (first, last), (begin, end) = rows, columns
    n_middles = len(right)
    for start in range(begin, end, WIDTH):
        stop = min(start + WIDTH, end)
        for i in range(first, last, 2):
            # Two rows and four middles at a time give eight sums for six loads. At the end the
            # last row or middle is repeated, which does not change the minimum.
            upper, lower = paths[i, start:stop], paths[min(i + 1, last - 1), start:stop]
            from_upper, from_lower = left[i], left[min(i + 1, last - 1)]
            for k in range(0, n_middles, 4):
                k1, k2 = min(k + 1, n_middles - 1), min(k + 2, n_middles - 1)
                k3 = min(k + 3, n_middles - 1)
                u0, u1, u2, u3 = from_upper[k], from_upper[k1], from_upper[k2], from_upper[k3]
                l0, l1, l2, l3 = from_lower[k], from_lower[k1], from_lower[k2], from_lower[k3]
                right0, right1 = right[k, start:stop], right[k1, start:stop]
                right2, right3 = right[k2, start:stop], right[k3, start:stop]
                for j in range(stop - start):
                    r0, r1, r2, r3 = right0[j], right1[j], right2[j], right3[j]
                    upper[j] = min(upper[j], u0 + r0, u1 + r1, u2 + r2, u3 + r3)
                    lower[j] = min(lower[j], l0 + r0, l1 + r1, l2 + r2, l3 + r3)


@loop()
def nearest_edges(lengths: Reals, count: int) -> Ints:
    """Return the ends of the `count` shortest edges of each node, shape (N, count).

    Missing edges end at the node itself.
    """
    n_nodes = len(lengths)
    ends = np.empty((n_nodes, count), np.int64)
    shortest = np.empty(count)
    for i in range(n_nodes):
        shortest[:] = np.inf
        ends[i] = i
        for j in range(n_nodes):
            length = lengths[i, j]
            if length < shortest[-1] and j != i:
                place = count - 1
                while place > 0 and shortest[place - 1] > length:
                    shortest[place] = shortest[place - 1]
                    ends[i, place] = ends[i, place - 1]
                    place -= 1
                shortest[place] = length
                ends[i, place] = j
    return ends


@loop()
def sweep_nodes(
    tile: Reals, order: Ints, edges: tuple[Ints, Ints, Reals], stamps: Ints, clock: int
) -> bool:
    """Relax the edges of all nodes once; return whether a path became shorter.

    Row u of `tile` contains the lengths of the paths to node u. ``stamps[u]`` contains the times
    of the last improvement and of the last visit of node u: neighbours that have not improved
    since the visit are skipped.
    """
    offsets, ends, lengths = edges
    any_shorter = False
    for node in order:
        clock += 1
        row = tile[node]
        shorter = 0
        for edge in range(offsets[node], offsets[node + 1]):
            if stamps[ends[edge], 0] > stamps[node, 1]:
                other, length = tile[ends[edge]], lengths[edge]
                for source in range(len(row)):
                    through = other[source] + length
                    shorter |= through < row[source]
                    row[source] = min(row[source], through)
        stamps[node, 1] = clock
        if shorter:
            stamps[node, 0] = clock
            any_shorter = True
    return any_shorter


@loop()
def relax(
    paths: Reals,
    sources: Ints,
    order: Ints,
    edges: tuple[Ints, Ints, Reals],
    max_sweeps: int,
) -> None:
    """Relax edges until no path becomes shorter: Bellman-Ford for many sources at once.

    Row s of `paths` contains the lengths of the paths from source s; rows of `sources` are updated.
    The `edges` (offsets, ends, lengths) of node u are those from ``offsets[u]`` to
    ``offsets[u + 1]``. Sweeps follow `order`, alternately forwards and backwards.
    """
    n_nodes = len(order)
    tile = np.empty((n_nodes, len(sources)), paths.dtype)
    for node in range(n_nodes):
        for place in range(len(sources)):
            tile[node, place] = paths[sources[place], node]
    stamps = np.zeros((n_nodes, 2), np.int64)
    stamps[:, 0] = 1
    backwards = order[::-1].copy()
    for sweep in range(max_sweeps):
        direction = order if sweep % 2 == 0 else backwards
        if not sweep_nodes(tile, direction, edges, stamps, 1 + sweep * n_nodes):
            break
    for node in range(n_nodes):
        for place in range(len(sources)):
            paths[sources[place], node] = tile[node, place]


SIDE = 64
"""Nodes per tile. A tile of float64, 32 KiB, fits into the first-level cache.

A constant: with a number known to the compiler, loops take three quarters of the time.
"""


@loop()
def tile_number(row: int, column: int, n_blocks: int) -> int:
    """Return the place of a tile, row by row; `row` must not exceed `column`."""
    return row * (2 * n_blocks - row - 1) // 2 + column


@loop()
def close_tile(tile: Reals) -> None:
    """Replace lengths within a block by those of shortest paths (Floyd-Warshall)."""
    for k in range(SIDE):
        through = tile[k].copy()
        for i in range(SIDE):
            to = tile[i, k]
            for j in range(SIDE):
                tile[i, j] = min(tile[i, j], to + through[j])


@loop()
def lower_tile(tile: Reals, left: Reals, right: Reals) -> None:
    """Lower ``tile[i, j]`` to the least ``left[i, k] + right[k, j]``, a (min, +) product.

    Two rows and four middles at a time give eight sums for six loads. On processors with vectors
    of 512 bits, 26 of the possible 28 sums per nanosecond are computed: one vector per cycle.
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
    """Compute the paths from a block of nodes to all blocks that begin within it.

    The tile of the block itself must be closed. ``outwards[J]`` is set to the paths from block
    `middle` to block J, and ``inwards[J]`` to its transpose.
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
    """Lower the tiles of some rows by the paths through several blocks.

    ``inwards[m]`` and ``outwards[m]`` are those of `reach_blocks` for block m. Several blocks per
    tile, and several rows per column, reduce the transfers from memory.
    """
    n_middles, n_blocks = outwards.shape[:2]
    for column in range(rows[0], n_blocks):
        for row in range(rows[0], min(rows[1], column + 1)):
            tile = tiles[tile_number(row, column, n_blocks)]
            for middle in range(n_middles):
                lower_tile(tile, inwards[middle, row], outwards[middle, column])
