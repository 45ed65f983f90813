"""Dissimilarities as edges of a graph: components, neighbours, shortest paths."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.cluster.hierarchy import cophenet, single
from scipy.sparse.csgraph import connected_components, csgraph_from_dense, floyd_warshall
from scipy.spatial.distance import squareform

from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import COMPILED_FROM
from anisomap.numerics.graph.dissimilarity import symmetric
from anisomap.numerics.graph.shortest_paths import shortest_paths
from anisomap.numerics.precision import Reals


def check_semi_metric(dissimilarity: ArrayLike, *, copy: bool = True) -> Reals:
    """Check that a matrix can be read as lengths of edges.

    Parameters
    ----------
    dissimilarity : array_like of shape (N, N)
        Infinite where there is no edge.
    copy : bool
        If not, it may be returned itself, and must not be changed then.

    Returns
    -------
    ndarray of shape (N, N)
        A copy, symmetric to the last bit.

    Raises
    ------
    InputError
        If it is not symmetric, holds NaN or a negative length, or its diagonal is not zero.
    """
    lengths = symmetric(dissimilarity, "dissimilarity", copy=copy)
    if lengths.min() < 0:
        i, j = np.argwhere(lengths < 0)[0]
        raise InputError(
            f"the dissimilarity of {i} and {j} is {lengths[i, j]:g}; it must not be < 0"
        )
    if np.diag(lengths).any():
        i = int(np.flatnonzero(np.diag(lengths))[0])
        raise InputError(f"the dissimilarity of {i} to itself is {lengths[i, i]:g}; it must be 0")
    return lengths


def metricise(dissimilarity: ArrayLike) -> Reals:
    """Replace every dissimilarity by the length of the shortest path through all pairs.

    Parameters
    ----------
    dissimilarity : array_like of shape (N, N)
        A semi-metric: symmetric, zero diagonal, elsewhere non-negative; infinite where there is
        no direct evidence.

    Returns
    -------
    ndarray of shape (N, N)
        The greatest metric that nowhere exceeds the input. Symmetric to the last bit; infinite
        between separate components (an extended metric). A metric comes back unchanged.

    Raises
    ------
    InputError
        See `check_semi_metric`.

    Notes
    -----
    McGregor et al. (2011), section "ANISOMAP", step 2, and Text S3. Floyd (1962), Warshall (1962).
    From 500 objects on the same by compiled loops: see
    `anisomap.numerics.graph.shortest_paths`. Matrices in float32 are then computed in float32,
    with a relative error of about 1e-6.
    """
    lengths = check_semi_metric(dissimilarity, copy=False)
    if len(lengths) >= COMPILED_FROM:
        return shortest_paths(lengths)
    # Only inf means "no edge": a dense 0 would be read as none, and twins would come out far apart.
    graph = csgraph_from_dense(lengths, null_value=np.inf)
    metric = floyd_warshall(graph, directed=False)
    np.minimum(metric, metric.T, out=metric)
    return np.asarray(metric)


def minimax_paths(dissimilarity: ArrayLike) -> NDArray[np.float64]:
    """Give the longest step of the path between every two objects whose longest step is shortest.

    Parameters
    ----------
    dissimilarity : array_like of shape (N, N)
        A semi-metric, finite: symmetric, zero diagonal, elsewhere non-negative.

    Returns
    -------
    ndarray of shape (N, N)
        The greatest ultrametric that nowhere exceeds the input; symmetric, zero diagonal.

    Raises
    ------
    InputError
        See `check_semi_metric`; or if a dissimilarity is infinite.

    Notes
    -----
    These are the heights at which single linkage merges two objects (Gower & Ross 1969, Applied
    Statistics 18: 54-64).
    """
    lengths = check_semi_metric(dissimilarity)
    if not np.isfinite(lengths).all():
        raise InputError("some dissimilarities are infinite: look at each component by itself")
    if len(lengths) < 2:
        return np.zeros_like(lengths)
    return np.asarray(squareform(cophenet(single(squareform(lengths)))))


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
    return largest_first(connected_components(joined, directed=False)[1])


def largest_first(labels: NDArray[np.integer[Any]]) -> NDArray[np.intp]:
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
    values = symmetric(similarity, "similarity")
    np.fill_diagonal(values, -np.inf)
    return np.argsort(-values, axis=1, kind="stable")


def _joined(order: NDArray[np.intp], n_neighbours: int) -> NDArray[np.bool_]:
    n_objects = len(order)
    chosen = np.zeros((n_objects, n_objects), dtype=bool)
    np.put_along_axis(chosen, order[:, : min(n_neighbours, n_objects - 1)], True, axis=1)
    return np.asarray(chosen | chosen.T)
