"""How alike sensors read: the pairwise statistics that maps are made from."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import rankdata

from anisomap.numerics.precision import Reals, row_blocks
from anisomap.numerics.similarity.accumulators import (
    MIN_FLOAT32_SENSORS,
    Moments,
    correlation_of_comoments,
)
from anisomap.numerics.similarity.co_occurrence import (
    Counts,
    Layout,
    co_occurrences,
)
from anisomap.numerics.similarity.rest import estimate_rest

MAX_SQUARED = 1e100
"""Readings up to this, and down to its inverse, are squared as they are."""


def pearson(readings: ArrayLike) -> Reals:
    """Correlate the readings of every pair of sensors linearly (Pearson's r).

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.

    Returns
    -------
    ndarray of shape (N, N)
        In [-1, 1], symmetric to the last bit, ones on the diagonal; 0 between a sensor that never
        varies and any other. From 512 sensors on, right to 1e-5: products are of float32 then.
    """
    values = _squarable(readings)
    return Moments.of(values, single=values.shape[1] >= MIN_FLOAT32_SENSORS).correlation()


def spearman(readings: ArrayLike) -> Reals:
    """Correlate the ranks of the readings of every pair of sensors (Spearman's rho).

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings. Equal readings share the mean of their ranks.

    Returns
    -------
    ndarray of shape (N, N)
        As `pearson`; unchanged by any increasing transformation of a sensor.
    """
    return pearson(rankdata(np.asarray(readings), axis=0))


def co_activation(readings: ArrayLike) -> Reals:
    """Correlate whether sensors are beyond rest at all, however far (the phi coefficient).

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.

    Returns
    -------
    ndarray of shape (N, N)
        As `pearson`. What rest is: `anisomap.numerics.similarity.rest.estimate_rest`.
    """
    active = estimate_rest(readings).active(readings)
    return phi_from_counts(co_occurrences(active, Layout.of_switches(active.shape[1])), len(active))


def phi_from_counts(counts: Counts, n_frames: int) -> Reals:
    """Correlate sensors that are on or off, by how often they are on together.

    Parameters
    ----------
    counts : ndarray of int, shape (N, N)
        Frames in which both are on; on the diagonal, frames in which a sensor is.
    n_frames : int
        T.

    Returns
    -------
    ndarray of shape (N, N)
        As `pearson`.
    """
    on = np.diag(counts).astype(np.int64)
    comoment = np.empty(counts.shape)
    for rows in row_blocks(len(counts)):
        comoment[rows] = n_frames * counts[rows].astype(np.int64) - np.outer(on[rows], on)
    return correlation_of_comoments(comoment)


def squares_overflow(reach: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which sensors, by their greatest magnitude, have squares that float64 may not hold."""
    return (reach > MAX_SQUARED) | ((reach < 1 / MAX_SQUARED) & (reach > 0))


def _squarable(readings: ArrayLike) -> NDArray[np.generic]:
    """Bring readings whose squares would overflow or vanish near 1, by powers of 2: exactly."""
    values = np.asarray(readings)
    if values.dtype.kind != "f" or values.dtype.itemsize < np.dtype(np.float64).itemsize:
        return values
    reach = np.abs(values).max(axis=0, initial=0).astype(np.float64)
    if not squares_overflow(reach).any():
        return values
    return np.asarray(np.ldexp(values.astype(np.float64), -np.frexp(reach)[1]))
