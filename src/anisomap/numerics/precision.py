"""How matrices of pairs are held: in float64, and in float32 where there are very many pairs."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Reals: TypeAlias = NDArray[np.floating[Any]]
"""An array of float32 or float64."""

MIN_FLOAT32_SENSORS = 8000
"""From so many sensors on, what is worked out for all pairs is held in float32.

Rounding is then about 1e-7, far below what a recording leaves unsure; and 20,000 sensors, of which
one matrix takes 1.6 GB, fit into memory.
"""

_ROWS_BYTES = 1 << 26
_TILE = 1024


def float_type(n_sensors: int) -> type[np.float32] | type[np.float64]:
    """Give the type in which matrices of so many sensors are held."""
    return np.float32 if n_sensors >= MIN_FLOAT32_SENSORS else np.float64


def as_reals(values: ArrayLike, *, copy: bool = True) -> Reals:
    """Give an array in float32 if that is what it is, else in float64; a copy unless told not to.

    Parameters
    ----------
    values : array_like
    copy : bool
        If not, it may be the array itself, which must not be changed then.
    """
    single = getattr(values, "dtype", None) == np.float32
    return np.array(
        values, dtype=np.float32 if single else np.float64, copy=copy or None, order="C"
    )


def row_blocks(n_rows: int, n_columns: int | None = None) -> Iterator[slice]:
    """Cut the rows of a matrix so that work on some takes little memory beside it."""
    width = n_rows if n_columns is None else n_columns
    step = max(1, _ROWS_BYTES // (8 * max(width, 1)))
    for begin in range(0, n_rows, step):
        yield slice(begin, min(begin + step, n_rows))


def mirror(matrix: NDArray[Any], *, upper: bool) -> None:
    """Copy one half of a square matrix, above or below the diagonal, to the other."""
    for rows, columns in _tiles_above(len(matrix)):
        above, below = matrix[rows, columns], matrix[columns, rows].T
        kept, other = (above, below) if upper else (below, above)
        if rows == columns:
            half = np.triu(kept, 1)
            kept = half + half.T + np.diag(np.diag(kept))
        other[...] = kept


def is_symmetric(matrix: NDArray[Any]) -> bool:
    """Tell whether a square matrix equals its transpose to the last bit."""
    return all(
        np.array_equal(matrix[rows, columns], matrix[columns, rows].T)
        for rows, columns in _tiles_above(len(matrix))
    )


def _tiles_above(n_rows: int) -> Iterator[tuple[slice, slice]]:
    tiles = [slice(begin, begin + _TILE) for begin in range(0, n_rows, _TILE)]
    return ((rows, columns) for i, rows in enumerate(tiles) for columns in tiles[i:])
