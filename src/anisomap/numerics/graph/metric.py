"""Dissimilarities as edges of a graph: components, neighbours, shortest paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.cluster.hierarchy import cophenet, single
from scipy.sparse.csgraph import csgraph_from_dense, floyd_warshall
from scipy.spatial.distance import squareform

from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import MIN_COMPILED_ROWS
from anisomap.numerics.graph.dissimilarity import as_symmetric
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
    lengths = as_symmetric(dissimilarity, "dissimilarity", copy=copy)
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
    if len(lengths) >= MIN_COMPILED_ROWS:
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
