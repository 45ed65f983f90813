"""Connected components and neighbour graphs."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import connected_components

from anisomap.errors import InputError
from anisomap.numerics.graph.dissimilarity import as_symmetric


def components(dissimilarity: ArrayLike) -> NDArray[np.intp]:
    """Tell which objects are connected by finite dissimilarities.

    Parameters
    ----------
    dissimilarity : array_like of shape (N, N)
        Infinite where there is no edge.

    Returns
    -------
    ndarray of int, shape (N,)
        A label an object. 0 is the largest component; of equal ones, the one that holds the first
        object comes first.
    """
    joined = np.isfinite(dissimilarity)
    if joined.all():  # common, and looking for pieces of a full matrix takes long
        return np.zeros(len(joined), dtype=np.intp)
    return labels_by_size(connected_components(joined, directed=False)[1])


def labels_by_size(labels: NDArray[np.integer[Any]]) -> NDArray[np.intp]:
    """Renumber pieces: 0 is the largest; of equal ones, the one that holds the first object.

    Parameters
    ----------
    labels : ndarray of int, shape (N,)
        Which piece each object belongs to, from 0 on without gaps.

    Returns
    -------
    ndarray of int, shape (N,)
    """
    first_seen = np.unique(labels, return_index=True)[1]
    order = np.lexsort((first_seen, -np.bincount(labels)))
    return np.asarray(np.argsort(order)[labels])


def neighbour_graph(similarity: ArrayLike, n_neighbours: int) -> NDArray[np.bool_]:
    """Join every object to those most similar to it.

    Parameters
    ----------
    similarity : array_like of shape (N, N)
        The diagonal is not looked at.
    n_neighbours : int
        How many each object is joined to, k >= 1. It may be joined to more: being another's
        neighbour counts, too.

    Returns
    -------
    ndarray of bool, shape (N, N)
        Symmetric, False on the diagonal.

    Raises
    ------
    InputError
        If `n_neighbours` is less than 1.
    """
    if n_neighbours < 1:
        raise InputError(f"{n_neighbours} neighbours join nothing; use 1 or more")
    order = _by_falling_similarity(similarity)
    return _joined(order, n_neighbours)


def smallest_connected_neighbour_graph(
    similarity: ArrayLike,
) -> tuple[NDArray[np.bool_], int]:
    """Find the neighbour graph with the fewest neighbours that connects everything.

    Parameters
    ----------
    similarity : array_like of shape (N, N)
        The diagonal is not looked at.

    Returns
    -------
    adjacency : ndarray of bool, shape (N, N)
        See `neighbour_graph`.
    n_neighbours : int
        The smallest k for which it is connected.

    Notes
    -----
    McGregor et al. (2011), section "ISOMAP". Growing k only adds edges, so the search can halve
    its interval at each step.
    """
    order = _by_falling_similarity(similarity)
    too_few, enough = 0, max(1, len(order) - 1)
    while enough - too_few > 1:
        middle = (too_few + enough) // 2
        if connected_components(_joined(order, middle), directed=False)[0] == 1:
            enough = middle
        else:
            too_few = middle
    return _joined(order, enough), enough


def _by_falling_similarity(similarity: ArrayLike) -> NDArray[np.intp]:
    values = as_symmetric(similarity, "similarity")
    np.fill_diagonal(values, -np.inf)
    return np.argsort(-values, axis=1, kind="stable")


def _joined(order: NDArray[np.intp], n_neighbours: int) -> NDArray[np.bool_]:
    n_objects = len(order)
    chosen = np.zeros((n_objects, n_objects), dtype=bool)
    np.put_along_axis(chosen, order[:, : min(n_neighbours, n_objects - 1)], True, axis=1)
    return np.asarray(chosen | chosen.T)
