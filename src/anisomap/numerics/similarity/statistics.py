"""How alike sensors read: the pairwise statistics that maps are made from."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import xlogy
from scipy.stats import rankdata

from anisomap.numerics.precision import Reals, held_as, rows_at_a_time
from anisomap.numerics.similarity.accumulators import (
    CHUNK_FRAMES,
    SINGLE_SENSORS,
    Moments,
    correlation_of_comoments,
)
from anisomap.numerics.similarity.activity import estimate_rest
from anisomap.numerics.similarity.binning import DEFAULT_BINS, maximum_entropy_codes
from anisomap.numerics.similarity.counting import (
    MANY_SENSORS,
    Counts,
    Layout,
    co_occurrences,
    joint_logarithms,
)

LARGEST_SQUARED = 1e100
"""Readings up to this, and down to its inverse, are squared as they are."""

_MANY_CODES = 64  # more would make panels of counts too large


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
    return Moments.of(values, single=values.shape[1] >= SINGLE_SENSORS).correlation()


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
        As `pearson`. What rest is: `anisomap.numerics.similarity.activity.estimate_rest`.
    """
    active = estimate_rest(readings).active(readings)
    return phi_of_counts(co_occurrences(active, Layout.of_switches(active.shape[1])), len(active))


def phi_of_counts(counts: Counts, n_frames: int) -> Reals:
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
    for rows in rows_at_a_time(len(counts)):
        comoment[rows] = n_frames * counts[rows].astype(np.int64) - np.outer(on[rows], on)
    return correlation_of_comoments(comoment)


def mutual_information(readings: ArrayLike, bins: int = DEFAULT_BINS) -> Reals:
    """Measure what the binned readings of every pair of sensors tell of each other.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.
    bins : int
        Bins a sensor, b >= 2, of maximum entropy.

    Returns
    -------
    ndarray of shape (N, N)
        I(A; B) in nats, at least 0 and at most the lesser entropy, symmetric to the last bit. On
        the diagonal stands the sensors' entropy, since I(A; A) = H(A).

    Raises
    ------
    InputError
        If `bins` is less than 2.

    Notes
    -----
    McGregor et al. (2011), section "Information Theory"; the plug-in estimate, without any
    correction for the number of frames.
    """
    return information_of_codes(maximum_entropy_codes(readings, bins))


def information_of_codes(codes: ArrayLike) -> Reals:
    """Measure the mutual information of discrete series, in nats.

    Parameters
    ----------
    codes : array_like of int, shape (T, N)
        Small numbers from 0.

    Returns
    -------
    ndarray of shape (N, N)
        See `mutual_information`.

    Notes
    -----
    With counts n over T frames, ``T I(A; B) = sum n_ab log n_ab - sum n_a log n_a
    - sum n_b log n_b + T log T``. Counts are exact integers.
    """
    values = np.asarray(codes)
    n_frames, n_sensors = values.shape
    n_codes = int(values.max()) + 1
    if n_sensors >= MANY_SENSORS and n_codes <= _MANY_CODES:
        joint = joint_logarithms(values, n_codes)
    else:
        joint = _joint_logarithms(values, n_codes)
    return information_of_logarithms(joint, n_frames)


def information_of_logarithms(joint: NDArray[np.float64], n_frames: int) -> Reals:
    """Give the mutual information, in nats, of sums of n log n over joint counts.

    Parameters
    ----------
    joint : ndarray of shape (N, N)
        See `anisomap.numerics.similarity.counting.joint_logarithms`.
    n_frames : int
        T.

    Returns
    -------
    ndarray of shape (N, N)
        See `mutual_information`.
    """
    # A sensor meets itself only in equal codes, so the diagonal holds its own sum n_a log n_a.
    marginal = np.diag(joint)
    entropy = (np.log(n_frames) - marginal / n_frames).clip(0)
    information = np.empty(joint.shape, held_as(len(joint)))
    for rows in rows_at_a_time(len(joint)):
        shared = joint[rows] - np.add.outer(marginal[rows], marginal)
        shared /= n_frames
        shared += np.log(n_frames)
        # Rounding can leave the bounds 0 <= I <= min(H, H) by some 1e-16.
        information[rows] = np.clip(shared, 0, np.minimum.outer(entropy[rows], entropy))
    np.fill_diagonal(information, entropy)
    return information


def unsquarable(reach: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which sensors, by their greatest magnitude, have squares that float64 may not hold."""
    return (reach > LARGEST_SQUARED) | ((reach < 1 / LARGEST_SQUARED) & (reach > 0))


def _squarable(readings: ArrayLike) -> NDArray[np.generic]:
    """Bring readings whose squares would overflow or vanish near 1, by powers of 2: exactly."""
    values = np.asarray(readings)
    if values.dtype.kind != "f" or values.dtype.itemsize < np.dtype(np.float64).itemsize:
        return values
    reach = np.abs(values).max(axis=0, initial=0).astype(np.float64)
    if not unsquarable(reach).any():
        return values
    return np.asarray(np.ldexp(values.astype(np.float64), -np.frexp(reach)[1]))


def _joint_logarithms(codes: NDArray[np.generic], n_codes: int) -> NDArray[np.float64]:
    """Sum n log n over joint counts, plainly: a matrix product for each pair of codes."""
    joint = np.zeros((codes.shape[1],) * 2)
    for a in range(n_codes):
        counts = _co_occurrences(codes, a, a)
        joint += xlogy(counts, counts)
        for b in range(a + 1, n_codes):
            counts = _co_occurrences(codes, a, b)
            terms = xlogy(counts, counts)
            joint += terms + terms.T
    return joint


def _co_occurrences(codes: NDArray[np.generic], first: int, second: int) -> NDArray[np.float64]:
    """Count in how many frames one sensor has the first code while another has the second."""
    n_sensors = codes.shape[1]
    counts = np.zeros((n_sensors, n_sensors))
    for start in range(0, len(codes), CHUNK_FRAMES):
        chunk = codes[start : start + CHUNK_FRAMES]
        # float32 holds every count of so few frames exactly, and multiplies fastest.
        left = (chunk == first).astype(np.float32)
        right = left if first == second else (chunk == second).astype(np.float32)
        counts += left.T @ right
    return counts
