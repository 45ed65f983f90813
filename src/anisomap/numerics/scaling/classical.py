"""Classical scaling."""

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
"""Maximum number of points for which a full eigendecomposition is faster than an iterative one."""

_NEARLY_GREATEST = 1 - 1e-6  # magnitudes above this share differ by rounding only


def torgerson(distances: ArrayLike, dimensions: int) -> NDArray[np.float64]:
    """Classical scaling: positions from the leading eigenvectors of the inner products.

    Parameters
    ----------
    distances : array_like of shape (N, N)
        Finite, symmetric, zero diagonal.
    dimensions : int
        Number of coordinates, k >= 1.

    Returns
    -------
    ndarray of shape (N, k)
        Centred; columns are orthogonal, by decreasing spread. The entry of greatest magnitude of
        each column is positive, so that runs agree; of equal ones, as on symmetric skins, the
        first. Columns with eigenvalues of 0 or less are 0.

    Raises
    ------
    InputError
        If the distances are not finite, not symmetric or negative, or `dimensions` is less than 1.

    Notes
    -----
    Torgerson (1952), Psychometrika 17: 401-419; Borg & Groenen (2005), chapter 12. For many points
    double centring is applied as a linear operator, and eigenvectors are computed iteratively.
    """
    squares = np.square(check_semi_metric(distances, copy=False))
    if dimensions < 1:
        raise InputError(f"dimensions must be at least 1, got {dimensions}")
    if not np.isfinite(squares.max()):
        raise InputError("distances must be finite; scale each connected component separately")
    n_points = len(squares)
    if n_points <= max(DENSE_LIMIT, 2 * dimensions + 1):
        values, vectors = _leading_dense(squares, min(dimensions, n_points))
    else:
        values, vectors = _leading_iterative(squares, dimensions)
    order = np.argsort(values)[::-1]
    columns = vectors[:, order] * np.sqrt(np.maximum(values[order], 0))
    magnitudes = np.abs(columns)
    first = (magnitudes >= _NEARLY_GREATEST * magnitudes.max(axis=0)).argmax(axis=0)
    peaks = columns[first, np.arange(columns.shape[1])]
    columns = columns * np.where(peaks < 0, -1.0, 1.0)
    return np.pad(columns, ((0, 0), (0, dimensions - columns.shape[1])))


def _leading_dense(squares: Reals, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rows = squares.mean(axis=0, dtype=np.float64)
    inner = -(squares - np.add.outer(rows, rows) + rows.mean()) / 2
    values, vectors = eigh(inner, subset_by_index=[len(inner) - count, len(inner) - 1])
    return values, vectors


def _leading_iterative(
    squares: Reals, count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    double = squares.dtype == np.float64
    multiply = dsymv if double else ssymv

    def double_centred(vector: NDArray[np.float64]) -> NDArray[np.float64]:
        # symv reads only one triangle; reading the matrix takes most of the time.
        product = multiply(1.0, squares.T, vector - vector.mean()).astype(np.float64, copy=False)
        return np.asarray((product - product.mean()) / -2)

    operator = LinearOperator(squares.shape, matvec=double_centred, dtype=np.float64)
    # A fixed start, since ARPACK's own is random.
    start = np.random.default_rng(0).standard_normal(len(squares))
    try:
        # Machine precision, or the precision of products in float32.
        values, vectors = eigsh(operator, k=count, which="LA", v0=start, tol=0 if double else 1e-5)
    except ArpackError:  # no convergence, or the matrix is zero: all points coincide
        return _leading_dense(squares, count)
    return values, vectors
