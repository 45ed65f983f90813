"""Precision and symmetry of (N, N) matrices: float64, or float32 for many sensors."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Reals: TypeAlias = NDArray[np.floating[Any]]
"""Array of float32 or float64."""

MIN_FLOAT32_SENSORS = 2000
"""Minimum number of sensors for which (N, N) matrices are float32.

The rounding error, about 1e-7, is far below the sampling noise of a recording. From about 2,000
sensors on, a matrix in float64 (32 MB) exceeds the last cache of current processors, and shortest
paths in float32 take half the time. One float32 matrix of 20,000 sensors takes 1.6 GB.
"""

MAX_SQUARED = 1e100
"""Magnitude above which readings are scaled before squaring; likewise below its inverse."""

_BLOCK_BYTES = 1 << 26


def float_type(n_sensors: int) -> type[np.float32] | type[np.float64]:
    """Return the float type of (N, N) matrices of `n_sensors` sensors."""
    return np.float32 if n_sensors >= MIN_FLOAT32_SENSORS else np.float64


def as_reals(values: ArrayLike, *, copy: bool = True) -> Reals:
    """Convert to a C-contiguous array of float64, or of float32 if the input is float32."""
    single = getattr(values, "dtype", None) == np.float32
    return np.array(
        values, dtype=np.float32 if single else np.float64, copy=copy or None, order="C"
    )


def slices_of(n_rows: int, size: int) -> Iterator[slice]:
    """Split rows into slices of a size; the last may be shorter."""
    for begin in range(0, n_rows, size):
        yield slice(begin, min(begin + size, n_rows))


def row_blocks(n_rows: int) -> Iterator[slice]:
    """Split the rows of a square matrix into blocks of at most 64 MiB of float64."""
    return slices_of(n_rows, max(1, _BLOCK_BYTES // (8 * max(n_rows, 1))))


def mirror(matrix: NDArray[Any], *, upper: bool, tile: int = 128) -> None:
    """Make a square matrix symmetric in place by copying one triangle to the other.

    matrix (N, N).
    """
    for rows, columns in _upper_tiles(len(matrix), tile):
        above, below = matrix[rows, columns], matrix[columns, rows].T
        source, target = (above, below) if upper else (below, above)
        if rows == columns:
            half = np.triu(source, 1)
            source = half + half.T + np.diag(np.diag(source))
        target[...] = source


def is_symmetric(matrix: NDArray[Any], *, tile: int = 128) -> bool:
    """Return whether a square matrix equals its transpose exactly."""
    return all(
        np.array_equal(matrix[rows, columns], matrix[columns, rows].T)
        for rows, columns in _upper_tiles(len(matrix), tile)
    )


def _upper_tiles(n_rows: int, tile: int) -> Iterator[tuple[slice, slice]]:
    tiles = [slice(begin, begin + tile) for begin in range(0, n_rows, tile)]
    return ((rows, columns) for i, rows in enumerate(tiles) for columns in tiles[i:])
