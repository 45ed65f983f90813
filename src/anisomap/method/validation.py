"""Checks of what a map is made from: sensors, frames, and matrices of precomputed stages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.method.dimensions import AUTO, Dimensions, check_dimensions
from anisomap.method.named import MethodOptions
from anisomap.numerics.columns import centred_rows
from anisomap.numerics.graph.dissimilarity import as_symmetric
from anisomap.numerics.precision import Reals, check_pair_memory, float_type

_ALIKE = 1e-5  # difference of readings in [-1, 1] by rounding, in float32
_MAX_SINGLE = 1e15  # squares of numbers up to this, and down to its inverse, fit into float32


def check_size(
    mapped: NDArray[np.bool_], dimensions: Dimensions, options: MethodOptions, *, refined: bool
) -> None:
    """Check that the mapped sensors are enough, and that their pairs fit into memory."""
    check_dimensions(dimensions)
    check_sensors(mapped, dimensions, options)
    check_pair_memory(int(np.count_nonzero(mapped)), refined=refined)


def check_sensors(
    mapped: NDArray[np.bool_], dimensions: Dimensions, options: MethodOptions
) -> None:
    """Check that enough sensors, given as a mask of shape (N,), are mapped."""
    n_mapped = np.count_nonzero(mapped)
    if n_mapped < options.min_sensors:
        raise InputError(
            f"a map requires at least {options.min_sensors} sensors that vary and are not "
            f"dropped, got {n_mapped} of {len(mapped)}"
        )
    if dimensions != AUTO and dimensions > n_mapped:
        raise InputError(
            f"a map in {dimensions} dimensions requires at least {dimensions} sensors, "
            f"got {n_mapped}"
        )


def check_frames(n_frames: int, dimensions: Dimensions) -> None:
    """Check that correlations of so many frames can place points.

    Centred and scaled readings of T frames are points of a sphere of T - 2 dimensions.
    """
    k = 2 if dimensions == AUTO else dimensions
    held = max(0, n_frames - 2)
    if held < k:
        raise InputError(
            f"a map in {k} dimensions requires at least {k + 2} frames, got {n_frames}, whose "
            f"correlations place sensors in at most {held} dimension{'s' * (held != 1)}"
        )


def check_unlike(*runs: Any, rows_of: Callable[[Any], NDArray[Any]] = centred_rows) -> None:
    """Check that sensors differ by more than offset, gain and sign: else all maps are alike.

    runs: Readings, each (T, n), or other matrices that have a column for each sensor.
    rows_of: Takes some columns, and returns what is alike in such sensors, up to its size.
    """
    for run, count in product(runs, (2, None)):  # nearly always, two sensors differ
        rows = rows_of(run[:, :count])
        rows = rows / np.maximum(np.abs(rows).max(axis=1), np.finfo(rows.dtype).tiny)[:, None]
        signs = np.sign(rows @ rows[0])[:, None]
        if (np.abs(signs * rows - rows[0]) > _ALIKE).any():
            return
    raise InputError(
        "all sensors read the same, but for offset and gain, so their readings do not show where "
        "they are; touch one place after another"
    )


def check_related(component: NDArray[np.intp], options: MethodOptions) -> None:
    """Check that the largest component, of labels (n,), has enough sensors."""
    largest = np.count_nonzero(component == 0)
    if largest < options.min_sensors:
        raise InputError(
            f"a map requires at least {options.min_sensors} related sensors, but the largest group "
            f"has {largest}; check that the skin was touched during the recording"
        )


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
