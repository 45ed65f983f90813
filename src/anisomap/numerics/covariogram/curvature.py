"""Curvature of the objective of the covariogram fit, which makes its minimisation fast."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.blas import dsyrk, ssyrk

from anisomap.numerics.compiled.parallel import MIN_COMPILED_ROWS, load_loops
from anisomap.numerics.covariogram.objective import Block, solve_amplitude_and_offset
from anisomap.numerics.precision import Reals

Matrix: TypeAlias = Reals

_MIN_EIGENVALUE = 1e-15  # relative, as in numpy.linalg.pinv


def gauss_newton_matrix(
    blocks: Sequence[Block],
    positions: Matrix,
    log_exponent: float,
    dtype: type[np.floating] = np.float64,
) -> Matrix:
    """Return the Gauss-Newton matrix of the objective by the positions and the log exponent.

    Parameters
    ----------
    blocks : sequence of Block
    positions : ndarray of shape (N, k)
    log_exponent : float
        Logarithm of the covariogram's exponent.
    dtype : type
        Of the matrix.

    Returns
    -------
    ndarray of shape (N k + 1, N k + 1)
        By the coordinates in the order of ``positions.T.ravel()``, then by the log exponent. Only
        the upper triangle is set, of a positive semi-definite matrix: the Hessian without the
        second derivatives of the residuals. Amplitude and offset are eliminated.

    Notes
    -----
    With ``<A, B> = tr(A W B W)`` and the derivatives J of the residuals R, its elements are
    ``<J_p, J_q>``. The derivative by a coordinate of sensor i is not 0 only in row and column i,
    so that all elements take k (k + 3) / 2 products of (n, n) matrices. Amplitude and offset are
    linear; eliminating them is the Schur complement (Golub & Pereyra 1973, SIAM Journal on
    Numerical Analysis 10: 413-432; the approximation of Kaufman 1975, BIT 15: 49-57).
    """
    n_sensors, n_axes = positions.shape
    terms = [block.terms(positions, log_exponent) for block in blocks]
    amplitude, _ = solve_amplitude_and_offset(np.sum([term.products for term in terms], axis=0))
    matrix = np.zeros((positions.size + 1, positions.size + 1), dtype)
    cross, linear = np.zeros((3, n_axes, n_sensors)), np.zeros((3, 3))
    starts = np.arange(n_axes) * n_sensors
    compiled = n_sensors >= MIN_COMPILED_ROWS
    add_block = load_loops("blocks").add_block if compiled else _add_block
    for block, term in zip(blocks, terms, strict=True):
        part = block.curvature(term, positions, float(np.exp(log_exponent)), amplitude)
        for (p, q), found in part.coordinates.items():
            add_block(matrix, found, starts[p] + block.sensors, starts[q] + block.sensors)
        cross[:, :, block.sensors] += part.cross
        linear += part.linear
    flat = cross.reshape(3, positions.size)
    matrix[:-1, -1] = flat[2]
    matrix[-1, -1] = linear[2, 2]
    # Rows whose outer products are those of the inverse: eigenvectors over roots of eigenvalues.
    values, vectors = np.linalg.eigh(linear[:2, :2])
    kept = values > _MIN_EIGENVALUE * values[-1]
    roots = vectors[:, kept].T / np.sqrt(values[kept])[:, None]
    eliminated = roots @ np.hstack([flat[:2], linear[:2, 2:]])
    # The upper triangle of a C-contiguous matrix is the lower one of its transpose for BLAS.
    rank_update = ssyrk if matrix.dtype == np.float32 else dsyrk
    rank_update(-1.0, eliminated.T, beta=1.0, c=matrix.T, lower=True, overwrite_c=True)
    return matrix


def _add_block(
    matrix: Matrix, block: Matrix, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> None:
    """Do as `anisomap.numerics.compiled.blocks.add_block` does, for sorted rows and columns."""
    if rows[-1] - rows[0] < len(rows) and columns[-1] - columns[0] < len(columns):
        # All sensors are in one block: slices take a tenth of the time of indices.
        matrix[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += block
    else:
        matrix[np.ix_(rows, columns)] += block
