"""Nearest neighbours of points, spanning trees, connected components, and interpolated fields."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist


def nearest_others(
    points: NDArray[np.float64], count: int, rows: NDArray[np.intp] | None = None
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Find the nearest neighbours of points, all by default: distances and indices, (n, count).

    A point is not its own neighbour, even if other points coincide. Few points give fewer columns.
    """
    rows = np.arange(len(points)) if rows is None else rows
    count = min(count, len(points) - 1)
    if count < 1:
        return np.empty((len(rows), 0)), np.empty((len(rows), 0), dtype=np.intp)
    distances, found = KDTree(points).query(points[rows], k=count + 1)
    itself = found == rows[:, None]
    itself[~itself.any(axis=1), -1] = True  # absent because of coincident points: drop the last
    shape = (len(rows), count)
    return np.asarray(distances)[~itself].reshape(shape), np.asarray(found)[~itself].reshape(shape)


def nearest_distances(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance of each of at least 2 points to the nearest other one, shape (n,)."""
    return nearest_others(points, 1)[0][:, 0]


def padded(points: NDArray[np.float64], dimensions: int) -> NDArray[np.float64]:
    """Append coordinates of 0 to points of fewer dimensions, shape (n, dimensions)."""
    return np.pad(points, ((0, 0), (0, dimensions - points.shape[1])))


def tree_edges(weights: NDArray[np.floating[Any]]) -> Iterator[tuple[int, int]]:
    """Yield each node of the maximum spanning tree in order, and the earlier node that it joins.

    Prim (1957), Bell System Technical Journal 36: 1389-1401, in O(N^2). scipy sorts all edges, and
    its sparse graphs cannot represent edges of weight 0.
    """
    # Weight and end of the strongest edge from the tree to each node. Nodes of the tree are never
    # chosen from `strongest`, and no edge exceeds their `bound`.
    strongest, ends = weights[0].astype(np.float64), np.zeros(len(weights), dtype=np.intp)
    bound = strongest.copy()
    strongest[0], bound[0] = -np.inf, np.inf
    for _ in range(len(weights) - 1):
        node = int(strongest.argmax())
        yield node, int(ends[node])
        strongest[node], bound[node] = -np.inf, np.inf
        row = weights[node]
        closer = np.flatnonzero(row > bound)
        bound[closer] = strongest[closer] = row[closer]
        ends[closer] = node


def spanning_tree(lengths: NDArray[np.floating[Any]]) -> NDArray[np.bool_]:
    """Return the links of the minimum spanning tree of a complete graph. lengths (N, N)."""
    joined = np.zeros(lengths.shape, dtype=bool)
    for node, end in tree_edges(-lengths):
        joined[node, end] = joined[end, node] = True
    return joined


def components(dissimilarity: ArrayLike) -> NDArray[np.intp]:
    """Label the components connected by finite dissimilarities, (N, N) -> (N,).

    0 is the largest. Components of equal size are ordered by their first objects.
    """
    joined = np.isfinite(dissimilarity)
    if joined.all():  # the most frequent case needs no slow search
        return np.zeros(len(joined), dtype=np.intp)
    return labels_by_size(linked_labels(joined))


def linked_labels(joined: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Label the components of a symmetric graph, (N, N) -> (N,)."""
    graph: Any = csr_array(joined)  # scipy first masks a dense graph, which takes longer
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def labels_by_size(labels: NDArray[np.integer[Any]]) -> NDArray[np.intp]:
    """Renumber components by decreasing size; equal sizes are ordered by the first object."""
    _, first_seen, member, count = np.unique(
        labels, return_index=True, return_inverse=True, return_counts=True
    )
    return np.asarray(np.lexsort((first_seen, -count)).argsort()[member])


@dataclass(frozen=True)
class Kernel:
    """Covariance of a field of unit variance. reach: In units of the points. noise: A variance."""

    reach: float
    noise: float

    def between(self, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the covariance of the field at points, shape (len(a), len(b)): Matern 3/2."""
        scaled = np.sqrt(3.0) * cdist(a, b) / self.reach
        return np.asarray((1.0 + scaled) * np.exp(-scaled))
