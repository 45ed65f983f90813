"""Shortest paths between all pairs of many nodes, by compiled loops."""

from __future__ import annotations

import logging
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from anisomap.numerics.compiled.parallel import load_loops, parallel_map
from anisomap.numerics.precision import Reals, row_blocks

logger = logging.getLogger(__name__)

NEAREST = 12
"""Edges a node along which paths are first looked for."""

FIRST_SWEEPS = 2
"""There and back along the nearest edges: enough to tell nearly all edges that are detours."""

FEW = 1 / 16
"""With a greater share of edges that may matter, going through all nodes is faster."""

SOURCES = 256
"""Sources relaxed together: long enough for vector units, and few enough for the cache."""

TILE = 64
"""Nodes gone through together, and twice as many rows are one piece of work."""

ROUNDING = {np.float64: 1e-12, np.float32: 1e-5}
"""By which share the lengths of paths of many edges may differ."""

CHECKED = 8
"""Sources whose paths are tried against every edge."""


class Edges(NamedTuple):
    """Edges by the node they start from: those of u are ``offsets[u]`` to ``offsets[u + 1]``."""

    offsets: NDArray[np.int64]
    ends: NDArray[np.int64]
    lengths: Reals


def shortest_paths(lengths: Reals) -> Reals:
    """Give the lengths of the shortest paths between all nodes.

    Parameters
    ----------
    lengths : ndarray of shape (N, N)
        Symmetric **to the last bit**, zero diagonal, non-negative; infinite where there is no edge.

    Returns
    -------
    ndarray of shape (N, N)
        Symmetric to the last bit.

    Notes
    -----
    In a skin few edges are shortest paths themselves, and those alone are followed where that is
    so. The result is checked and, should the check ever fail, found through all nodes instead.
    """
    found = along_few_edges(lengths)
    if found is not None and holds(found, lengths):
        return found
    return through_all_nodes(lengths)


def along_few_edges(lengths: Reals) -> Reals | None:
    """Follow only edges that may be shortest paths themselves; None if they are not few.

    Notes
    -----
    Paths start as M itself and only ever fall, so an edge is of use only where ``paths == M`` (it
    is *tight*): elsewhere a detour is shorter. A first look along the nearest edges leaves few
    such. Paths that no tight edge lowers are the shortest: an edge that is tight at the end was
    tight before, so none is missing.
    """
    n_nodes = len(lengths)
    near = _edges(lengths, np.repeat(np.arange(n_nodes), NEAREST), _nearest(lengths).ravel())
    order = _from_neighbour_to_neighbour(near)
    paths = lengths.copy()
    _relax(paths, order, near, FIRST_SWEEPS)
    most = int(FEW * n_nodes**2)
    tight = _tight(paths, lengths, most)
    if tight is None:
        return None
    _relax(paths, order, _edges(lengths, *tight), np.iinfo(np.int64).max)
    for rows in _blocks(n_nodes, SOURCES):
        paths[rows] = np.minimum(paths[rows], paths[:, rows].T)
        paths[:, rows] = paths[rows].T
    return paths


def holds(paths: Reals, lengths: Reals) -> bool:
    """Tell whether no edge at all shortens the paths from a few sources (Bellman's condition)."""
    sources = np.unique(np.linspace(0, len(paths) - 1, CHECKED).astype(int))
    chosen = paths[sources]
    shorter = chosen.copy()
    load_loops("paths").shorten(shorter, chosen, lengths, (0, len(chosen)), (0, len(paths)))
    if (shorter >= chosen * (1 - ROUNDING[paths.dtype.type])).all():
        return True
    logger.warning("shortest paths along few edges were not the shortest: going through all nodes")
    return False


def through_all_nodes(lengths: Reals) -> Reals:
    """Go through all nodes, a block of them at a time: Floyd and Warshall in tiles.

    Notes
    -----
    Venkataraman, Sahni & Mukhopadhyaya (2003), ACM Journal of Experimental Algorithmics 8: 2.2.
    Paths are the same there and back, so only blocks on and above the diagonal are worked out.
    """
    loops = load_loops("paths")
    n_nodes = len(lengths)
    paths = lengths.copy()
    with parallel_map(n_nodes) as spread_over:
        for nodes in _blocks(n_nodes, TILE):
            among = paths[nodes, nodes].copy()
            loops.close(among)
            direct = np.hstack([paths[: nodes.start, nodes].T, among, paths[nodes, nodes.stop :]])
            onward = direct.copy()
            loops.shorten(onward, among, direct, (0, len(among)), (0, n_nodes))
            towards = np.ascontiguousarray(onward.T)

            def shorten(
                rows: slice,
                towards: Reals = towards,
                onward: Reals = onward,
            ) -> None:
                on_and_above = (rows.start, n_nodes)
                loops.shorten(paths, towards, onward, (rows.start, rows.stop), on_and_above)

            spread_over(shorten, _blocks(n_nodes, 2 * TILE))
    for rows in _blocks(n_nodes, 2 * TILE):
        paths[rows.stop :, rows] = paths[rows, rows.stop :].T
    return paths


def _tight(
    paths: Reals, lengths: Reals, most: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]] | None:
    """List the edges that no detour shortens, each once; None if there are too many."""
    starts, ends, count = [], [], 0
    for rows in row_blocks(len(paths)):
        after = np.arange(rows.start, rows.stop)[:, None] < np.arange(len(paths))
        same = after & (paths[rows] == lengths[rows]) & np.isfinite(lengths[rows])
        start, end = np.nonzero(same)
        starts.append(start + rows.start)
        ends.append(end)
        count += len(end)
        if 2 * count > most:
            return None
    return np.concatenate(starts), np.concatenate(ends)


def _nearest(lengths: Reals) -> NDArray[np.int64]:
    return np.asarray(load_loops("paths").nearest(lengths, NEAREST))


def _edges(lengths: Reals, starts: NDArray[np.int64], ends: NDArray[np.int64]) -> Edges:
    """Give edges in both directions, each once, without loops and those of infinite length."""
    n_nodes = len(lengths)
    pairs = np.unique(np.concatenate([starts * n_nodes + ends, ends * n_nodes + starts]))
    starts, ends = np.divmod(pairs, n_nodes)
    usable = (starts != ends) & np.isfinite(lengths[starts, ends])
    starts, ends = starts[usable], ends[usable]
    return Edges(np.searchsorted(starts, np.arange(n_nodes + 1)), ends, lengths[starts, ends])


def _from_neighbour_to_neighbour(edges: Edges) -> NDArray[np.int64]:
    """Order nodes so that neighbours follow closely: a sweep then carries paths far."""
    n_nodes = len(edges.offsets) - 1
    joined = csr_array(
        (np.ones(len(edges.ends)), edges.ends, edges.offsets), shape=(n_nodes, n_nodes)
    )
    return reverse_cuthill_mckee(joined, symmetric_mode=True).astype(np.int64)


def _relax(paths: Reals, order: NDArray[np.int64], edges: Edges, most_sweeps: int) -> None:
    def relax(together: slice) -> None:
        # Sources that follow one another in `order` are near: much of the graph can be passed over.
        load_loops("paths").relax(paths, order[together], order, tuple(edges), most_sweeps)

    with parallel_map(len(paths)) as spread_over:
        spread_over(relax, _blocks(len(paths), SOURCES))


def _blocks(n_nodes: int, size: int) -> list[slice]:
    return [slice(begin, min(begin + size, n_nodes)) for begin in range(0, n_nodes, size)]
