"""Matrices of all pairs, (N, N): float64 or float32, symmetry, and limits of memory."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from anisomap.errors import InputError

Reals: TypeAlias = NDArray[np.floating[Any]]
"""Array of float32 or float64."""

Floats: TypeAlias = NDArray[np.float64]

MIN_FLOAT32_SENSORS = 2000
"""Minimum number of sensors for which (N, N) matrices are float32.

The rounding error, about 1e-7, is far below the sampling noise of a recording. From about 2,000
sensors on, a matrix in float64 (32 MB) exceeds the last cache of current processors, and shortest
paths in float32 take half the time. One float32 matrix of 20,000 sensors takes 1.6 GB.
"""

_BLOCK_BYTES = 1 << 26


def float_type(n_sensors: int) -> type[np.float32] | type[np.float64]:
    """Return the float type of (N, N) matrices of `n_sensors` sensors."""
    return np.float32 if n_sensors >= MIN_FLOAT32_SENSORS else np.float64


def slices_of(n_rows: int, size: int) -> Iterator[slice]:
    """Split rows into slices of a size; the last may be shorter."""
    for begin in range(0, n_rows, size):
        yield slice(begin, min(begin + size, n_rows))


def row_blocks(n_rows: int) -> Iterator[slice]:
    """Split the rows of a square matrix into blocks of at most 64 MiB of float64."""
    return slices_of(n_rows, max(1, _BLOCK_BYTES // (8 * max(n_rows, 1))))


def symmetric_from_upper(matrix: NDArray[Any]) -> NDArray[Any]:
    """Mirror the upper triangle of a matrix, (N, N) -> (N, N)."""
    return np.asarray(np.triu(matrix) + np.triu(matrix, 1).T)


MATRICES, MATRICES_OF_REFINED = 8, 11
"""Maximum number of (N, N) matrices in memory, for methods without and with refinement.

Peak memory at 20,000 sensors was 7.4 and 10.3 matrices.
"""

_GIB = 1 << 30


def physical_memory() -> int | None:
    """Return the physical memory of the machine in bytes; None if it cannot be determined."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):
        return None


def check_pair_memory(n_sensors: int, *, refined: bool) -> None:
    """Check that the matrices of all pairs of sensors fit into memory."""
    matrices = MATRICES_OF_REFINED if refined else MATRICES
    needed = matrices * n_sensors**2 * np.dtype(float_type(n_sensors)).itemsize
    check_memory(
        needed, f"a map of all pairs of {n_sensors} sensors", "map fewer sensors at a time"
    )


def check_memory(needed: float, purpose: str, remedy: str) -> None:
    """Check that a computation fits into memory."""
    available = physical_memory()
    if available is not None and needed > available:
        raise InputError(
            f"{purpose} needs about {needed / _GIB:.1f} GiB of memory, but this machine has "
            f"{available / _GIB:.1f} GiB; {remedy}"
        )
