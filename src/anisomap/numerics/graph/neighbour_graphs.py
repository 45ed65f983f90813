"""Neighbour graphs, path lengths along them, and search for the most similar sensors."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.compiled.parallel import limited_blas, parallel_map
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.graph.metric import metricise
from anisomap.numerics.neighbours import linked_labels, spanning_tree
from anisomap.numerics.precision import Reals


def neighbour_graph(similarity: ArrayLike, n_neighbours: int) -> NDArray[np.bool_]:
    """Link every object to the most similar ones. similarity (N, N)."""
    values = as_symmetric(similarity, "similarity")
    np.fill_diagonal(values, -np.inf)
    return _joined(values, n_neighbours)


def _joined(values: Reals, n_neighbours: int) -> NDArray[np.bool_]:
    """Link every object to the objects with the greatest values; the diagonal is -inf."""
    if n_neighbours >= len(values) - 1:
        return ~np.eye(len(values), dtype=bool)
    chosen = greatest_of_rows(values, n_neighbours)
    return np.asarray(chosen | chosen.T)


def greatest_of_rows(values: NDArray[np.floating[Any]], count: int) -> NDArray[np.bool_]:
    """Mark the greatest values of each row, the first among equals. values (n, m)."""
    # Sorting takes ten times as long.
    limit = np.partition(values, values.shape[1] - count, axis=1)[:, -count, None]
    chosen = values >= limit
    for row in np.flatnonzero(chosen.sum(axis=1) > count):
        equal = np.flatnonzero(values[row] == limit[row])
        surplus = np.count_nonzero(chosen[row]) - count
        chosen[row, equal[len(equal) - surplus :]] = False
    return np.asarray(chosen)


def smallest_connected_neighbour_graph(similarity: ArrayLike) -> tuple[NDArray[np.bool_], int]:
    """Find the connected neighbour graph with the fewest neighbours. similarity (N, N).

    McGregor et al. (2011), section "ISOMAP". Edges are only added as k grows, so k is bisected.
    """
    values = as_symmetric(similarity, "similarity")
    np.fill_diagonal(values, -np.inf)
    too_few, enough = 0, max(1, len(values) - 1)
    while enough - too_few > 1:
        middle = (too_few + enough) // 2
        if not linked_labels(_joined(values, middle)).any():
            enough = middle
        else:
            too_few = middle
    return _joined(values, enough), enough


_N_NEIGHBOURS = 8  # of each sensor; on real skins, 6 to 20 result in similar maps
_CORRELATIONS = (1e-3, 1 - 1e-6)  # bounds that keep lengths finite and above 0


def local_path_lengths(similarity: ArrayLike, n_neighbours: int = _N_NEIGHBOURS) -> Reals:
    """Measure distances along a neighbour graph. similarity (N, N) -> (N, N), rounded as float32.

    An edge has length ``sqrt(-log s)``, the distance at which the correlation ``exp(-d^2)`` is s.
    Paths as in Isomap: Tenenbaum et al. (2000), doi:10.1126/science.290.5500.2319.
    """
    correlation = as_symmetric(similarity, "similarity")
    np.fill_diagonal(correlation, 1.0)
    lengths = np.sqrt(-np.log(np.clip(correlation, *_CORRELATIONS)))
    linked = neighbour_graph(correlation, n_neighbours)
    # Clipped weak links have equal lengths; the tree distinguishes them by similarity.
    linked |= spanning_tree(2.0 - correlation)
    # The errors of correlations exceed 1e-6 by far; paths in float32 take half the time.
    lengths = np.where(linked, lengths, np.inf).astype(np.float32)
    np.fill_diagonal(lengths, 0.0)
    return metricise(lengths).astype(np.float64)


_ROWS = 512  # of a block of inner products

MAX_WHOLE = 2048
"""Maximum number of sensors for which all inner products are computed at once; 16 MiB."""


def most_similar(
    rows: NDArray[np.float32], count: int, *, whole: NDArray[np.float32] | None = None
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Find, for each of N sensors, the sensors with the greatest inner products, (N, count).

    Of equal products, the first are taken. whole (N, N): The products of all rows, if known.
    """
    n_sensors = len(rows)
    found = np.empty((n_sensors, count), dtype=np.intp)
    products = np.empty(found.shape, dtype=np.float32)

    def search(begin: int) -> None:
        part = slice(begin, begin + _ROWS)
        block = rows[part] @ rows.T if whole is None else whole[part].copy()
        each = np.arange(len(block))
        block[each, begin + each] = -np.inf
        for k in range(count):
            found[part, k] = best = block.argmax(axis=1)
            products[part, k] = block[each, best]
            block[each, best] = -np.inf

    # One BLAS thread, so that sums do not depend on the number of threads.
    with limited_blas(1):
        parallel_map(search, range(0, n_sensors, _ROWS), n_sensors)
    return found, products


def all_products(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Multiply all pairs of rows; numpy computes half of a matrix times its own transpose."""
    return np.asarray(rows @ rows.T)
