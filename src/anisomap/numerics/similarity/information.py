"""Mutual information of every pair of sensors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import xlogy

from anisomap.numerics.precision import Reals, float_type, row_blocks
from anisomap.numerics.similarity.accumulators import CHUNK_FRAMES
from anisomap.numerics.similarity.binning import DEFAULT_BINS, maximum_entropy_codes
from anisomap.numerics.similarity.co_occurrence import MIN_COMPILED_SENSORS, joint_logarithms

_MANY_CODES = 64  # more would make panels of counts too large


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
    return information_from_codes(maximum_entropy_codes(readings, bins))


def information_from_codes(codes: ArrayLike) -> Reals:
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
    if n_sensors >= MIN_COMPILED_SENSORS and n_codes <= _MANY_CODES:
        joint = joint_logarithms(values, n_codes)
    else:
        joint = _joint_logarithms(values, n_codes)
    return information_from_logarithms(joint, n_frames)


def information_from_logarithms(joint: NDArray[np.float64], n_frames: int) -> Reals:
    """Give the mutual information, in nats, of sums of n log n over joint counts.

    Parameters
    ----------
    joint : ndarray of shape (N, N)
        See `anisomap.numerics.similarity.co_occurrence.joint_logarithms`.
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
    information = np.empty(joint.shape, float_type(len(joint)))
    for rows in row_blocks(len(joint)):
        shared = joint[rows] - np.add.outer(marginal[rows], marginal)
        shared /= n_frames
        shared += np.log(n_frames)
        # Rounding can leave the bounds 0 <= I <= min(H, H) by some 1e-16.
        information[rows] = np.clip(shared, 0, np.minimum.outer(entropy[rows], entropy))
    np.fill_diagonal(information, entropy)
    return information


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
