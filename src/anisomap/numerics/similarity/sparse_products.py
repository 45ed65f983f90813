"""Co-moments of readings that mostly equal their rest value.

A skin is touched in few places at a time. If a of N sensors differ from rest in a frame, only a^2
products of deviations from rest are not 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array

from anisomap.numerics.compiled.parallel import load_loops, parallel_map
from anisomap.numerics.precision import mirror

Floats = NDArray[np.float64]

_DENSE_PER_SPARSE = 40  # dense products in the time of one sparse product; measured
_SAMPLE_FRAMES = 63  # frames from which the rest value is estimated
_PANEL_ROWS = 192  # rows of the result per task; with 96, products take a fifth longer


def is_sparse(readings: NDArray[Any]) -> bool:
    """Return whether `sparse_comoments` is faster than a matrix product, for shape (T, N)."""
    n_frames, n_sensors = readings.shape
    active = np.count_nonzero(readings != _rest(readings), axis=1).astype(np.float64)
    return bool(_DENSE_PER_SPARSE * np.vdot(active, active) <= float(n_sensors) ** 2 * n_frames)


def sparse_comoments(readings: NDArray[Any]) -> tuple[Floats, Floats]:
    """Compute means and co-moments from the readings that differ from rest.

    readings (T, N) -> mean (N,), comoment (N, N).
    """
    n_frames, n_sensors = readings.shape
    rest = _rest(readings)
    begins, sensors, depths = _active(readings, rest)
    sums = np.bincount(sensors, weights=depths, minlength=n_sensors)
    products = np.empty((n_sensors, n_sensors))

    def add(begin: int) -> None:
        rows = slice(begin, min(begin + _PANEL_ROWS, n_sensors))
        np.outer(sums[rows], sums / -n_frames, out=products[rows])
        load_loops("products").add_products(products[rows], begin, sensors, depths, begins)

    with parallel_map(n_sensors) as map_threads:
        map_threads(add, range(0, n_sensors, _PANEL_ROWS))
    mirror(products, upper=True)
    return rest + sums / n_frames, products


def _active(
    readings: NDArray[Any], rest: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[np.uint32], Floats]:
    """Return the readings that differ from rest, frame by frame, as sparse matrices are stored."""
    by_sensor = readings.strides[0] < readings.strides[1]
    rows = readings.T if by_sensor else readings  # in the order of memory
    active = rows != (rest[:, None] if by_sensor else rest)
    counts = np.count_nonzero(active, axis=1)
    begins = np.concatenate([[0], np.cumsum(counts)])
    found = np.flatnonzero(active)  # faster than a search in two dimensions
    values = rows.ravel()[found].astype(np.float64)
    if by_sensor:
        found -= np.repeat(np.arange(len(rows)) * rows.shape[1], counts)
        values -= np.repeat(rest, counts)
        stored: Any = csc_array((values, found, begins), shape=readings.shape).tocsr()
        return stored.indptr.astype(np.int64), stored.indices.astype(np.uint32), stored.data
    sensors = found - np.repeat(np.arange(len(rows)) * rows.shape[1], counts)
    values -= rest[sensors]
    return begins.astype(np.int64), sensors.astype(np.uint32), values


def _rest(readings: NDArray[Any]) -> NDArray[Any]:
    """Estimate the most frequent reading of each sensor by the median of some frames."""
    n_frames = len(readings)
    frames = np.linspace(0, n_frames - 1, min(n_frames, _SAMPLE_FRAMES)).astype(int)
    return np.asarray(np.sort(readings[frames], axis=0)[len(frames) // 2])
