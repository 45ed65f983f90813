"""Compiled loop of the curvature of overlapping blocks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from anisomap.numerics.compiled.jit import loop

Reals = NDArray[np.floating[Any]]
Ints = NDArray[np.int64]


@loop()
def add_block(matrix: Reals, block: Reals, rows: Ints, columns: Ints) -> None:
    """Add ``block[i, j]`` to ``matrix[rows[i], columns[j]]`` for all i and j."""
    for i in range(len(rows)):
        target, source = matrix[rows[i]], block[i]
        for j in range(len(columns)):
            target[columns[j]] += source[j]
