"""Shortest paths between all pairs of nodes of large graphs, by compiled loops.

Metrics from dissimilarities: shortest and minimax paths.
"""

from __future__ import annotations

import logging
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import MIN_COMPILED_ROWS, load_loops, parallel_map
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.precision import Reals, mirror, row_blocks

logger = logging.getLogger(__name__)

N_NEAREST = 12
"""Edges per node of the first search; chosen by hand, does not affect the result."""

FIRST_SWEEPS = 4
"""Sweeps of the first search, forwards and backwards in turn.

After 4, as few edges of simulated skins (400 to 2,500 sensors in 12 orders) are tight as after a
search to the end; after 2, up to five times as many in some orders.
"""

MAX_EDGE_SHARE = 1 / 40
"""Maximum share of the pairs followed as edges; with more, `through_all_nodes` is faster.

Measured on simulated skins of 1,500 sensors with 1 to 87 % of the pairs, and on random lengths.
"""

N_SAMPLED = 32
"""Nodes from which the share is estimated before all are searched: a few per cent of the work."""

SOURCES = 256
"""Sources relaxed together: long enough for vector units, few enough for the cache."""

TILE_ROWS = 4
"""Rows of tiles per task of `through_all_nodes`; few enough for many threads."""

TILE_MIDDLES = 2
"""Blocks of nodes through which a tile is lowered at a time, while it is in the cache."""

CACHE_LINE = 64
"""Bytes of a cache line of current processors."""

ROUNDING = {np.float64: 1e-12, np.float32: 1e-5}
"""Relative rounding error of the length of a path of many edges."""

N_CHECKED = 8
"""Sources of the final check."""


class Edges(NamedTuple):
    """Edges by start node: those of node u are ``offsets[u]`` to ``offsets[u + 1]``."""

    offsets: NDArray[np.int64]
    ends: NDArray[np.int64]
    lengths: Reals


def shortest_paths(lengths: Reals) -> Reals:
    """Return the lengths of the shortest paths between all nodes.

    lengths (N, N) -> (N, N).

    On skins few edges are shortest paths, and only these are followed (`along_few_edges`). If the
    result fails a check, all nodes are used (`through_all_nodes`).
    """
    found = along_few_edges(lengths)
    if found is not None:
        if are_shortest(found, lengths):
            return found
        logger.warning("shortest paths along few edges failed the check; using all nodes")
    return through_all_nodes(lengths)


def along_few_edges(
    lengths: Reals, *, n_nearest: int = N_NEAREST, max_share: float = MAX_EDGE_SHARE
) -> Reals | None:
    """Find shortest paths along the edges that may be shortest paths themselves.

    lengths (N, N) -> (N, N).

    Path lengths start as M and only decrease, so an edge is useful only where ``paths == M`` (it
    is *tight*): elsewhere a detour is shorter. A first search along the nearest edges leaves few
    tight edges. Paths that no tight edge shortens are the shortest, since every edge that is tight
    at the end was tight before.
    """
    n_nodes = len(lengths)
    near = _edges(lengths, *nearest_edges(lengths, n_nearest))
    order = bandwidth_order(near.offsets, near.ends)
    if _tight_share(lengths, order, near) > max_share:
        return None
    paths = lengths.copy()
    _relax(paths, order, near, FIRST_SWEEPS)
    tight = tight_edges(paths, lengths, max_share)
    if tight is None:
        return None
    _relax(paths, order, tight, np.iinfo(np.int64).max)
    for rows in _blocks(n_nodes, SOURCES):
        paths[rows] = np.minimum(paths[rows], paths[:, rows].T)
        paths[:, rows] = paths[rows].T
    return paths


def are_shortest(paths: Reals, lengths: Reals) -> bool:
    """Check for a few sources that no edge shortens their paths (Bellman's condition)."""
    sources = np.unique(np.linspace(0, len(paths) - 1, N_CHECKED).astype(int))
    chosen = paths[sources]
    shorter = chosen.copy()
    load_loops("paths").min_plus(shorter, chosen, lengths, (0, len(chosen)), (0, len(paths)))
    return bool((shorter >= chosen * (1 - ROUNDING[paths.dtype.type])).all())


def through_all_nodes(lengths: Reals) -> Reals:
    """Find shortest paths by the tiled Floyd-Warshall algorithm.

    lengths (N, N) -> (N, N).

    Venkataraman, Sahni & Mukhopadhyaya (2003), ACM Journal of Experimental Algorithmics 8: 2.2.
    Only tiles on and above the diagonal are computed. They are copied to consecutive memory, as in
    products of matrices (Goto & van de Geijn 2008, doi:10.1145/1356052.1356053).
    """
    loops = load_loops("paths")
    n_nodes, side = len(lengths), loops.SIDE
    blocks = _blocks(n_nodes, side)
    pairs = [(rows, columns) for i, rows in enumerate(blocks) for columns in blocks[i:]]
    tiles = _aligned((len(pairs), side, side), lengths.dtype)
    for tile, (rows, columns) in zip(tiles, pairs, strict=True):
        part = lengths[rows, columns]
        if part.shape != tile.shape:
            tile.fill(np.inf)
        tile[: len(part), : part.shape[1]] = part
    shape = (TILE_MIDDLES, len(blocks), side, side)
    outwards, inwards = _aligned(shape, lengths.dtype), _aligned(shape, lengths.dtype)
    with parallel_map(n_nodes) as map_threads:
        for group in _blocks(len(blocks), TILE_MIDDLES):
            middles = range(group.start, group.stop)
            for done, middle in enumerate(middles):
                # Other tiles wait until the end of the group.
                loops.lower_block(tiles, inwards[:done], outwards[:done], middle)
                loops.close_tile(tiles[loops.tile_number(middle, middle, len(blocks))])
                loops.reach_blocks(tiles, middle, outwards[done], inwards[done])
            ways = inwards[: len(middles)], outwards[: len(middles)]

            def lower(rows: slice, ways: tuple[Reals, Reals] = ways) -> None:
                loops.lower_rows(tiles, *ways, (rows.start, rows.stop))

            map_threads(lower, _blocks(len(blocks), TILE_ROWS))
    paths = np.empty_like(lengths)
    for tile, (rows, columns) in zip(tiles, pairs, strict=True):
        part = tile[: rows.stop - rows.start, : columns.stop - columns.start]
        paths[rows, columns] = part
        paths[columns, rows] = part.T
    return paths


def _aligned(shape: tuple[int, ...], dtype: np.dtype[Any]) -> Reals:
    """Return an empty array that begins with a cache line, so that vectors do not cross its end."""
    n_bytes = dtype.itemsize * math.prod(shape)
    memory = np.empty(n_bytes + CACHE_LINE, np.uint8)
    first = -memory.ctypes.data % CACHE_LINE
    return memory[first : first + n_bytes].view(dtype).reshape(shape)


def nearest_edges(lengths: Reals, count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the start and end nodes of the shortest edges of each node."""
    ends = np.asarray(load_loops("paths").nearest_edges(lengths, count))
    return np.repeat(np.arange(len(lengths)), count), ends.ravel()


def _tight_share(lengths: Reals, order: NDArray[np.int64], near: Edges) -> float:
    """Estimate the share of the pairs that a search along `near` leaves tight, from some nodes."""
    sample = np.unique(np.linspace(0, len(lengths) - 1, N_SAMPLED).astype(int))
    direct = lengths[sample]
    found = direct.copy()
    load_loops("paths").relax(found, np.arange(len(sample)), order, tuple(near), FIRST_SWEEPS)
    return float(np.mean((found == direct) & np.isfinite(direct)))


def tight_edges(paths: Reals, lengths: Reals, max_share: float = MAX_EDGE_SHARE) -> Edges | None:
    """Return the edges that no path shortens; None if they exceed a share of the pairs."""
    limit = int(max_share * len(paths) ** 2)
    starts, ends, count = [], [], 0
    for rows in row_blocks(len(paths)):
        upper = np.arange(rows.start, rows.stop)[:, None] < np.arange(len(paths))
        tight = upper & (paths[rows] == lengths[rows]) & np.isfinite(lengths[rows])
        start, end = np.nonzero(tight)
        starts.append(start + rows.start)
        ends.append(end)
        count += len(end)
        if 2 * count > limit:
            return None
    return _edges(lengths, np.concatenate(starts), np.concatenate(ends))


def _edges(lengths: Reals, starts: NDArray[np.int64], ends: NDArray[np.int64]) -> Edges:
    """Return edges in both directions, without duplicates, loops and infinite lengths."""
    n_nodes = len(lengths)
    pairs = np.unique(np.concatenate([starts * n_nodes + ends, ends * n_nodes + starts]))
    starts, ends = np.divmod(pairs, n_nodes)
    usable = (starts != ends) & np.isfinite(lengths[starts, ends])
    starts, ends = starts[usable], ends[usable]
    return Edges(np.searchsorted(starts, np.arange(n_nodes + 1)), ends, lengths[starts, ends])


def bandwidth_order(
    offsets: NDArray[np.integer[Any]], ends: NDArray[np.integer[Any]]
) -> NDArray[np.int64]:
    """Order nodes so that neighbours are close together; a sweep then extends paths far.

    Edges are those of `Edges`, in both directions. Cuthill & McKee (1969),
    doi:10.1145/800195.805928: breadth first, by increasing degree. Nodes of equal degree follow
    each other as they are numbered; scipy sorts degrees with an unstable sort, which orders them
    differently on different processors.
    """
    n_nodes = len(offsets) - 1
    by_degree = np.argsort(np.diff(offsets), kind="stable")
    graph = csr_array((np.ones(len(ends)), ends, offsets), shape=(n_nodes, n_nodes))
    joined: Any = graph[by_degree][:, by_degree]
    # One search visits all components, which are joined by their first nodes.
    first = np.unique(connected_components(joined, directed=False)[1], return_index=True)[1]
    joined += csr_array((np.ones(len(first) - 1), (first[:-1], first[1:])), shape=joined.shape)
    joined.sort_indices()
    order = breadth_first_order(joined, 0, directed=False, return_predecessors=False)
    return np.asarray(by_degree[order], dtype=np.int64)


def _relax(paths: Reals, order: NDArray[np.int64], edges: Edges, max_sweeps: int) -> None:
    def relax(block: slice) -> None:
        # Consecutive sources in `order` are close, so that sweeps skip much of the graph.
        load_loops("paths").relax(paths, order[block], order, tuple(edges), max_sweeps)

    with parallel_map(len(paths)) as map_threads:
        map_threads(relax, _blocks(len(paths), SOURCES))


def _blocks(n_nodes: int, size: int) -> list[slice]:
    return [slice(begin, min(begin + size, n_nodes)) for begin in range(0, n_nodes, size)]


def check_semi_metric(dissimilarity: ArrayLike, *, copy: bool = True) -> Reals:
    """Check that a matrix is a semi-metric.

    Parameters
    ----------
    dissimilarity : array_like of shape (N, N)
        Infinite where there is no edge.
    copy : bool
        If False, the input itself may be returned and must not be modified.

    Returns
    -------
    ndarray of shape (N, N)
        Exactly symmetric.

    Raises
    ------
    InputError
        If it is not symmetric, contains NaN or negative values, or its diagonal is not zero.
    """
    lengths = as_symmetric(dissimilarity, "dissimilarity", copy=copy)
    if lengths.min() < 0:
        i, j = np.argwhere(lengths < 0)[0]
        raise InputError(
            f"the dissimilarity of {i} and {j} is {lengths[i, j]:g}; it must be at least 0"
        )
    if np.diag(lengths).any():
        i = int(np.flatnonzero(np.diag(lengths))[0])
        raise InputError(f"the dissimilarity of {i} to itself is {lengths[i, i]:g}; it must be 0")
    return lengths


def metricise(dissimilarity: ArrayLike) -> Reals:
    """Replace every dissimilarity by the length of the shortest path between its objects.

    Parameters
    ----------
    dissimilarity : array_like of shape (N, N)
        A semi-metric: symmetric, zero diagonal, elsewhere non-negative; infinite where unknown.

    Returns
    -------
    ndarray of shape (N, N)
        The greatest metric that nowhere exceeds the input; exactly symmetric, infinite between
        connected components. A metric is returned unchanged.

    Raises
    ------
    InputError
        See `check_semi_metric`.

    Notes
    -----
    McGregor et al. (2011), section "ANISOMAP", step 2, and Text S3; Floyd (1962), Warshall (1962).
    From 500 objects on, `anisomap.numerics.graph.metric` is used. Float32 input is
    processed in float32, with a relative error of about 1e-6.
    """
    lengths = check_semi_metric(dissimilarity, copy=False)
    if len(lengths) >= MIN_COMPILED_ROWS:
        return shortest_paths(lengths)
    paths = lengths.copy()
    detours = np.empty_like(paths)
    for node in paths:
        np.add(node[:, None], node, out=detours)
        np.minimum(paths, detours, out=paths)
    return paths


def minimax_paths(dissimilarity: ArrayLike) -> NDArray[np.float64]:
    """Return the minimax path distances: the least possible longest edge between two objects.

    dissimilarity (N, N) -> (N, N).

    Prim's algorithm adds one object after another to a minimum spanning tree. The longest edge
    between two objects is the longest one by which the later one and those between were added.
    Single linkage merges them at this height (Gower & Ross 1969, Applied Statistics 18: 54-64).
    """
    lengths = check_semi_metric(dissimilarity)
    if not np.isfinite(lengths).all():
        raise InputError(
            "dissimilarities must be finite for minimax paths; split connected components first"
        )
    n_objects = len(lengths)
    order, added_by = np.zeros(n_objects, dtype=np.intp), np.zeros(n_objects, lengths.dtype)
    nearest, outside = lengths[:1].ravel().copy(), np.ones(n_objects, dtype=bool)
    for k in range(1, n_objects):
        outside[order[k - 1]] = False
        order[k] = np.where(outside, nearest, np.inf).argmin()
        added_by[k] = nearest[order[k]]
        np.minimum(nearest, lengths[order[k]], out=nearest)
    longest = np.zeros((n_objects, n_objects), lengths.dtype)
    for k in range(n_objects):
        np.maximum.accumulate(added_by[k + 1 :], out=longest[k, k + 1 :])
    mirror(longest, upper=True)
    place = order.argsort()
    return np.take(longest[place], place, axis=1)
