"""Metrics from dissimilarities: shortest and minimax paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import load_loops, parallel_map, uses_loops
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.neighbours import tree_edges
from anisomap.numerics.precision import Floats, Reals, slices_of, symmetric_from_upper

_TILE_ROWS = 4  # rows of tiles per task; few enough for many threads
_TILE_MIDDLES = 2  # blocks of nodes through which a tile is lowered while it is in the cache
_EXTENT = 0.9  # quantile of lengths: the longest lengths may be outliers


def with_bounded_stems(lengths: Reals, hidden: NDArray[np.intp]) -> Reals:
    """Bound the lengths to nodes whose links are hidden by noise. lengths (N, N), hidden (H,).

    The links are long, but their lengths are unknown. If the shortest path from a hidden node to
    another node exceeds the extent of the other nodes, all paths from it are shortened by the
    excess. Nothing changes if the other nodes are a minority, too few to show the skin's extent.
    """
    n_nodes = len(lengths)
    if not 0 < 2 * hidden.size < n_nodes:
        return lengths
    others = np.setdiff1d(np.arange(n_nodes), hidden)
    among = lengths[np.ix_(others, others)]
    extent = np.quantile(among[np.isfinite(among)], _EXTENT)
    nearest = lengths[np.ix_(hidden, others)].min(axis=1)
    excess = np.zeros(n_nodes, dtype=lengths.dtype)
    excess[hidden] = np.where(np.isfinite(nearest), np.maximum(nearest - extent, 0), 0)
    shortened = np.maximum(lengths - np.add.outer(excess, excess), np.minimum(lengths, extent))
    np.fill_diagonal(shortened, 0)
    return np.asarray(shortened, dtype=lengths.dtype)


def shortest_paths(lengths: Reals) -> Reals:
    """Find the shortest paths between all nodes, (N, N), by a tiled Floyd-Warshall algorithm.

    Venkataraman, Sahni & Mukhopadhyaya (2003), ACM Journal of Experimental Algorithmics 8: 2.2.
    Only tiles on and above the diagonal are computed. They are copied to contiguous memory, as for
    matrix products (Goto & van de Geijn 2008, doi:10.1145/1356052.1356053).
    """
    loops = load_loops("graphs")
    n_nodes, side = len(lengths), loops.SIDE
    blocks = list(slices_of(n_nodes, side))
    pairs = [(rows, columns) for i, rows in enumerate(blocks) for columns in blocks[i:]]
    tiles = np.empty((len(pairs), side, side), lengths.dtype)
    for tile, (rows, columns) in zip(tiles, pairs, strict=True):
        part = lengths[rows, columns]
        if part.shape != tile.shape:
            tile.fill(np.inf)
        tile[: len(part), : part.shape[1]] = part
    shape = (_TILE_MIDDLES, len(blocks), side, side)
    outwards, inwards = np.empty((2, *shape), lengths.dtype)
    for group in slices_of(len(blocks), _TILE_MIDDLES):
        middles = range(group.start, group.stop)
        for done, middle in enumerate(middles):
            # Other tiles are lowered at the end of the group.
            loops.lower_block(tiles, inwards[:done], outwards[:done], middle)
            loops.close_tile(tiles[loops.tile_number(middle, middle, len(blocks))])
            loops.reach_blocks(tiles, middle, outwards[done], inwards[done])
        ways = inwards[: len(middles)], outwards[: len(middles)]

        def lower(rows: slice, ways: tuple[Reals, Reals] = ways) -> None:
            loops.lower_rows(tiles, *ways, (rows.start, rows.stop))

        parallel_map(lower, slices_of(len(blocks), _TILE_ROWS), n_nodes)
    paths = np.empty_like(lengths)
    for tile, (rows, columns) in zip(tiles, pairs, strict=True):
        part = tile[: rows.stop - rows.start, : columns.stop - columns.start]
        paths[rows, columns] = part
        paths[columns, rows] = part.T
    return paths


def check_semi_metric(dissimilarity: ArrayLike, *, copy: bool = True) -> Reals:
    """Check that a matrix, (N, N), is a semi-metric, and make it exactly symmetric.

    It is infinite where there is no edge. copy: If False, the input itself may be returned and must
    not be modified.
    """
    lengths = as_symmetric(dissimilarity, "dissimilarity", copy=copy)
    if lengths.min() < 0:
        i, j = np.argwhere(lengths < 0)[0]
        raise InputError(f"the dissimilarity of {i} and {j} is negative: {lengths[i, j]:g}")
    if np.diag(lengths).any():
        i = int(np.flatnonzero(np.diag(lengths))[0])
        raise InputError(f"the dissimilarity of {i} to itself is {lengths[i, i]:g}; it must be 0")
    return lengths


def metricise(dissimilarity: ArrayLike) -> Reals:
    """Replace every dissimilarity by the length of the shortest path between its objects.

    A semi-metric (N, N) -> the greatest metric that does not exceed it; exactly symmetric, infinite
    between connected components. A metric is returned unchanged.

    McGregor et al. (2011), section "ANISOMAP", step 2, and Text S3; Floyd (1962), Warshall (1962).
    Float32 input is processed in float32, with a relative error of about 1e-6.
    """
    lengths = check_semi_metric(dissimilarity, copy=False)
    if uses_loops(len(lengths)):
        return shortest_paths(lengths)
    paths = lengths.copy()
    detours = np.empty_like(paths)
    for node in paths:
        np.add(node[:, None], node, out=detours)
        np.minimum(paths, detours, out=paths)
    return paths


def minimax_paths(dissimilarity: ArrayLike) -> Floats:
    """Return the minimax path length of every pair of objects, (N, N): the least longest edge.

    `tree_edges` adds one object after another to a minimum spanning tree. The minimax length of two
    objects is the longest edge by which any object after the first one, up to the second, was added
    (Gower & Ross 1969, Applied Statistics 18: 54-64).
    """
    lengths = check_semi_metric(dissimilarity)
    if not np.isfinite(lengths).all():
        raise InputError("minimax paths need finite dissimilarities; split components first")
    n_objects = len(lengths)
    order, added_by = np.zeros(n_objects, dtype=np.intp), np.zeros(n_objects, lengths.dtype)
    for k, (node, end) in enumerate(tree_edges(-lengths), start=1):
        order[k], added_by[k] = node, lengths[node, end]
    longest = np.zeros((n_objects, n_objects), lengths.dtype)
    for k in range(n_objects):
        np.maximum.accumulate(added_by[k + 1 :], out=longest[k, k + 1 :])
    place = order.argsort()
    return np.take(symmetric_from_upper(longest)[place], place, axis=1)
