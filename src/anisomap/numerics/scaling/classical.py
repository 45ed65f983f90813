"""Classical scaling (Torgerson)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import eigh
from scipy.linalg.blas import dsymv, ssymv
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from anisomap.errors import InputError
from anisomap.numerics.graph.metric import check_semi_metric
from anisomap.numerics.precision import Reals

DENSE_LIMIT = 200
"""Up to so many points a full eigendecomposition costs less than iterating for a few vectors."""


def torgerson(distances: ArrayLike, dimensions: int) -> NDArray[np.float64]:
    """Scale distances classically: the start from which SMACOF sets out.

    Parameters
    ----------
    distances : array_like of shape (N, N)
        Finite, symmetric, zero diagonal.
    dimensions : int
        Number of coordinates, k >= 1.

    Returns
    -------
    ndarray of shape (N, k)
        Centred; the columns are orthogonal and their spread falls. Of each, the entry of greatest
        magnitude is positive, so that runs agree. Coordinates that the distances do not support
        (eigenvalues of 0 or less) are 0.

    Raises
    ------
    InputError
        If the distances are not such a matrix, or `dimensions` is less than 1.

    Notes
    -----
    Torgerson (1952), Psychometrika 17: 401-419; Borg & Groenen (2005), chapter 12. Double
    centring is applied as an operator, so the leading vectors of a large matrix cost only products
    with it.
    """
    squares = np.square(check_semi_metric(distances, copy=False))
    if dimensions < 1:
        raise InputError(f"{dimensions} dimensions hold no map; use 1 or more")
    if not np.isfinite(squares.max()):
        raise InputError("some distances are infinite: scale each connected component by itself")
    n_points = len(squares)
    if n_points <= max(DENSE_LIMIT, 2 * dimensions + 1):
        values, vectors = _leading_dense(squares, min(dimensions, n_points))
    else:
        values, vectors = _leading_iterated(squares, dimensions)
    order = np.argsort(values)[::-1]
    columns = vectors[:, order] * np.sqrt(np.maximum(values[order], 0))
    peaks = columns[np.abs(columns).argmax(axis=0), np.arange(columns.shape[1])]
    columns = columns * np.where(peaks < 0, -1.0, 1.0)
    return np.pad(columns, ((0, 0), (0, dimensions - columns.shape[1])))


def _leading_dense(squares: Reals, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rows = squares.mean(axis=0, dtype=np.float64)
    inner = -(squares - np.add.outer(rows, rows) + rows.mean()) / 2
    values, vectors = eigh(inner, subset_by_index=[len(inner) - count, len(inner) - 1])
    return values, vectors


def _leading_iterated(
    squares: Reals, count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    double = squares.dtype == np.float64
    multiply = dsymv if double else ssymv

    def double_centred(vector: NDArray[np.float64]) -> NDArray[np.float64]:
        # Half of the matrix is read, which is what a product with a large one takes its time for.
        product = multiply(1.0, squares.T, vector - vector.mean()).astype(np.float64, copy=False)
        return np.asarray((product - product.mean()) / -2)

    operator = LinearOperator(squares.shape, matvec=double_centred, dtype=np.float64)
    # ARPACK would draw its own start: a fixed one makes equal input give equal output.
    start = np.random.default_rng(0).standard_normal(len(squares))
    try:
        # To the last bit, or as far as products in float32 allow.
        values, vectors = eigsh(operator, k=count, which="LA", v0=start, tol=0 if double else 1e-5)
    except ArpackError:  # it does not settle, or there is nothing to find: all points coincide
        return _leading_dense(squares, count)
    return values, vectors
