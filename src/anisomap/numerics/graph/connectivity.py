"""Connected components and neighbour graphs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components

from anisomap.errors import InputError
from anisomap.numerics.graph.dissimilarity import as_symmetric


def components(dissimilarity: ArrayLike) -> NDArray[np.intp]:
    """Label the components connected by finite dissimilarities.

    Parameters
    ----------
    dissimilarity : array_like of shape (N, N)
        Infinite where there is no edge.

    Returns
    -------
    ndarray of int, shape (N,)
        Component of each object; 0 is the largest, ties by the first object.
    """
    joined = np.isfinite(dissimilarity)
    if joined.all():  # the most frequent case, without a slow search
        return np.zeros(len(joined), dtype=np.intp)
    return labels_by_size(connected_components(joined, directed=False)[1])


def labels_by_size(labels: NDArray[np.integer[Any]]) -> NDArray[np.intp]:
    """Renumber components by decreasing size, ties by the first object.

    Parameters
    ----------
    labels : ndarray of int, shape (N,)
        Component of each object, numbered from 0 without gaps.

    Returns
    -------
    ndarray of int, shape (N,)
    """
    first_seen = np.unique(labels, return_index=True)[1]
    order = np.lexsort((first_seen, -np.bincount(labels)))
    return np.asarray(np.argsort(order)[labels])


def neighbour_graph(similarity: ArrayLike, n_neighbours: int) -> NDArray[np.bool_]:
    """Link every object to the most similar ones.

    Parameters
    ----------
    similarity : array_like of shape (N, N)
        The diagonal is ignored.
    n_neighbours : int
        Number of neighbours of each object, k >= 1. An edge links two objects if either is a
        neighbour of the other, so objects may have more edges.

    Returns
    -------
    ndarray of bool, shape (N, N)
        Adjacency; symmetric, False on the diagonal.

    Raises
    ------
    InputError
        If `n_neighbours` is less than 1.
    """
    if n_neighbours < 1:
        raise InputError(f"n_neighbours must be at least 1, got {n_neighbours}")
    return _join(_most_similar_first(similarity), n_neighbours)


def smallest_connected_neighbour_graph(
    similarity: ArrayLike,
) -> tuple[NDArray[np.bool_], int]:
    """Find the connected neighbour graph with the smallest number of neighbours.

    Parameters
    ----------
    similarity : array_like of shape (N, N)
        The diagonal is ignored.

    Returns
    -------
    adjacency : ndarray of bool, shape (N, N)
        See `neighbour_graph`.
    n_neighbours : int
        The smallest k for which the graph is connected.

    Notes
    -----
    McGregor et al. (2011), section "ISOMAP". Edges are only added as k grows, so k is found by
    bisection.
    """
    order = _most_similar_first(similarity)
    too_few, enough = 0, max(1, len(order) - 1)
    while enough - too_few > 1:
        middle = (too_few + enough) // 2
        if connected_components(_join(order, middle), directed=False)[0] == 1:
            enough = middle
        else:
            too_few = middle
    return _join(order, enough), enough


def _most_similar_first(similarity: ArrayLike) -> NDArray[np.intp]:
    values = as_symmetric(similarity, "similarity")
    np.fill_diagonal(values, -np.inf)
    return np.argsort(-values, axis=1, kind="stable")


def _join(order: NDArray[np.intp], n_neighbours: int) -> NDArray[np.bool_]:
    n_objects = len(order)
    chosen = np.zeros((n_objects, n_objects), dtype=bool)
    np.put_along_axis(chosen, order[:, : min(n_neighbours, n_objects - 1)], True, axis=1)
    return np.asarray(chosen | chosen.T)
