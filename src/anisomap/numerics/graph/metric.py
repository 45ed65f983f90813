"""Metrics from dissimilarities: shortest and minimax paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.compiled.parallel import MIN_COMPILED_ROWS
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.graph.shortest_paths import shortest_paths
from anisomap.numerics.precision import Reals, mirror


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
    From 500 objects on, `anisomap.numerics.graph.shortest_paths` is used. Float32 input is
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
