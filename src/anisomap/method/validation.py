"""Checks of the matrices of precomputed stages."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.precision import Reals, float_type

_MAX_SINGLE = 1e15  # squares of numbers up to this, and down to its inverse, fit into float32


def only_stage(given: Mapping[str, ArrayLike | None]) -> tuple[str, Reals]:
    """Return the name and the matrix, shape (N, N), of the only stage that is given."""
    stages = [name for name, matrix in given.items() if matrix is not None]
    if len(stages) != 1:
        raise InputError(
            f"give exactly one of {', '.join(given)}; got {', '.join(stages) or 'none'}"
        )
    matrix = _as_matrix(given[stages[0]], stages[0])
    if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
        raise InputError(f"the {stages[0]} must be of shape (N, N), got {matrix.shape}")
    return stages[0], matrix


def _as_matrix(matrix: ArrayLike | None, name: str) -> Reals:
    """Convert a matrix to the precision that is used for its size."""
    try:
        values = np.asarray(matrix)
    except ValueError:
        values = np.asarray(None)
    if values.dtype.kind not in "biuf":
        raise InputError(
            f"the {name} must be a matrix of real numbers, shape (N, N), got {values.dtype}"
        )
    dtype = float_type(len(values)) if values.ndim else np.float64
    if dtype == np.float32 and values.dtype == np.float64:
        largest = float(values.max(where=np.isfinite(values), initial=0))
        if largest and not 1 / _MAX_SINGLE < largest < _MAX_SINGLE:
            raise InputError(
                f"the largest {name} is {largest:g}, outside the range of single precision, which "
                f"is used for {len(values)} sensors; divide the matrix by its maximum"
            )
    return np.asarray(values, dtype)


def _square(matrix: ArrayLike, name: str, n_sensors: int) -> Reals:
    values = _as_matrix(matrix, name)
    if values.shape != (n_sensors, n_sensors):
        raise InputError(
            f"the {name} must be of shape ({n_sensors}, {n_sensors}), got {values.shape}"
        )
    return values


def checked_start(start: ArrayLike, n_sensors: int, dimensions: int) -> NDArray[np.float64]:
    """Return initial positions as float64; raise `InputError` unless of shape (N, k)."""
    positions = np.asarray(start, dtype=np.float64)
    if positions.shape != (n_sensors, dimensions):
        raise InputError(
            f"the start must be of shape ({n_sensors}, {dimensions}), got {positions.shape}"
        )
    return positions


def checked_weights(weights: ArrayLike, n_sensors: int) -> Reals:
    """Return weights, shape (N, N); raise `InputError` unless finite, >= 0 and symmetric."""
    values = _square(weights, "weights", n_sensors)
    if not np.isfinite(values).all() or (values < 0).any():
        raise InputError("weights must be finite and at least 0")
    return as_symmetric(values, "weight")


def checked_noise(noise: ArrayLike, n_sensors: int) -> Reals:
    """Return a sampling variance, shape (N, N)."""
    values = _square(noise, "noise", n_sensors)
    n_positive = np.count_nonzero(values > 0) - np.count_nonzero(np.diag(values) > 0)
    if not np.isfinite(values).all() or n_positive < n_sensors * (n_sensors - 1):
        raise InputError("the noise must be finite and above 0, since it is a variance")
    return as_symmetric(values, "noise")
