"""Correlations of every pair of sensors: Pearson's r, Spearman's rho and the phi coefficient."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.columns import columns, rank_columns
from anisomap.numerics.precision import Reals
from anisomap.numerics.similarity.accumulators import (
    MIN_FAST_PRODUCT_SENSORS,
    Moments,
    correlation_of_blocks,
)
from anisomap.numerics.similarity.co_occurrence import Counts, Layout, co_occurrences
from anisomap.numerics.similarity.rest import estimate_rest

MAX_SQUARED = 1e100
"""Magnitude above which readings are scaled before squaring; likewise below its inverse."""


def pearson(readings: ArrayLike) -> Reals:
    """Compute Pearson's r of every pair of sensors.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.

    Returns
    -------
    ndarray of shape (N, N)
        In [-1, 1], exactly symmetric, ones on the diagonal; 0 between a constant sensor and any
        other. From 128 sensors on, products are float32 and r is accurate to 6e-5, usually 1e-5.
    """
    return moments(scale_extremes(readings)).correlation()


def moments(readings: NDArray[np.generic]) -> Moments:
    """Return the moments from which `pearson` is computed, after `scale_extremes`."""
    return Moments.of(readings, single=readings.shape[1] >= MIN_FAST_PRODUCT_SENSORS)


def spearman(readings: ArrayLike) -> Reals:
    """Compute Spearman's rho of every pair of sensors; see `pearson`.

    Ties are assigned their mean rank. Invariant under increasing transformations of a sensor.
    """
    return pearson(ranked(readings))


def ranked(readings: ArrayLike) -> NDArray[np.float64]:
    """Return the ranks of the readings of each sensor, shape (T, N); ties share their mean."""
    values = np.asarray(readings)
    return rank_columns(columns(values), values.shape)


def co_activation(readings: ArrayLike) -> Reals:
    """Compute the phi coefficient of the activity (beyond rest or not) of every pair of sensors.

    See `pearson` for the shapes and `estimate_rest` for the definition of rest.
    """
    active = estimate_rest(readings).active(readings)
    return phi_from_counts(co_occurrences(active, Layout.of_switches(active.shape[1])), len(active))


def phi_from_counts(counts: Counts, n_frames: int) -> Reals:
    """Compute the phi coefficient of every pair of binary series from their joint counts.

    Returns (N, N).
    """
    on = np.diag(counts).astype(np.int64)

    def comoments(rows: slice) -> NDArray[np.float64]:
        products = counts[rows].astype(np.int64)
        products *= n_frames
        products -= np.outer(on[rows], on)
        return products.astype(np.float64)

    return correlation_of_blocks(n_frames * on - on * on, comoments)


def squares_overflow(magnitude: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return True for sensors with squares outside float64, given greatest magnitudes, (N,)."""
    return (magnitude > MAX_SQUARED) | ((magnitude < 1 / MAX_SQUARED) & (magnitude > 0))


def scale_extremes(readings: ArrayLike) -> NDArray[np.generic]:
    """Scale readings exactly, by powers of 2, if their squares would overflow or underflow."""
    values = np.asarray(readings)
    if values.dtype.kind != "f" or values.dtype.itemsize < np.dtype(np.float64).itemsize:
        return values
    lowest, highest = values.min(axis=0, initial=0), values.max(axis=0, initial=0)
    magnitude = np.maximum(-lowest, highest).astype(np.float64)
    if not squares_overflow(magnitude).any():
        return values
    return np.asarray(np.ldexp(values.astype(np.float64), -np.frexp(magnitude)[1]))
