"""Search for the most similar sensors by inner products, in blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.compiled.parallel import (
    MIN_COMPILED_ROWS,
    limited_blas,
    load_loops,
    parallel_map,
)

ROWS = 512
"""Rows of a block of inner products."""

COLUMNS = 4096
"""Columns of a block of inner products; 8 MiB, which stay in the cache while searched."""

MAX_WHOLE = 2048
"""Sensors up to which all inner products are computed at once; 16 MiB."""

NO_SENSOR = -1
"""Index that marks the absence of a sensor."""


def most_similar(
    rows: NDArray[np.float32],
    count: int,
    *,
    groups: ArrayLike | None = None,
    sensors: ArrayLike | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Find, for each sensor, the sensors with the greatest inner products of rows."""
    n_sensors = len(rows)
    queries = np.arange(n_sensors) if sensors is None else np.asarray(sensors, dtype=np.int64)
    labels = np.arange(n_sensors) if groups is None else np.asarray(groups, dtype=np.int64)
    if n_sensors < MIN_COMPILED_ROWS:
        return _most_similar_of_few(rows, count, labels, queries)
    found = np.full((len(queries), count), NO_SENSOR, dtype=np.int64)
    products = np.full(found.shape, -np.inf, dtype=np.float32)

    # One BLAS thread, so that sums do not depend on the number of threads.
    with limited_blas(1), parallel_map(len(queries)) as map_threads:
        whole = _all_products(rows) if sensors is None and n_sensors <= MAX_WHOLE else None

        def search(begin: int) -> None:
            part = slice(begin, begin + ROWS)
            mine = rows[queries[part]]
            for left in range(0, n_sensors, COLUMNS):
                block = mine @ rows[left : left + COLUMNS].T if whole is None else whole[part]
                kept = found[part], products[part]
                load_loops("search").keep_greatest(block, left, labels[queries[part]], labels, kept)

        map_threads(search, range(0, len(queries), ROWS))
    return found, products


def _all_products(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Multiply all rows; numpy computes half of a product of a matrix with its transpose."""
    return np.asarray(rows @ rows.T)


def _most_similar_of_few(
    rows: NDArray[np.float32],
    count: int,
    labels: NDArray[np.int64],
    queries: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Sort all products, which takes less time than loading a compiled loop."""
    with limited_blas(1):
        products = _all_products(rows)[queries]
    products[labels[queries][:, None] == labels] = -np.inf
    missing = max(0, count - len(rows))
    products = np.pad(products, ((0, 0), (0, missing)), constant_values=-np.inf)
    order = np.argsort(-products, axis=1, kind="stable")[:, :count]
    greatest = np.take_along_axis(products, order, axis=1)
    return np.where(np.isneginf(greatest), NO_SENSOR, order), greatest
