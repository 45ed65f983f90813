"""Mutual information of every pair of sensors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import xlogy

from anisomap.base.defaults import DEFAULT_BINS
from anisomap.numerics.precision import Floats, Reals, float_type, row_blocks
from anisomap.numerics.similarity.binning import maximum_entropy_codes
from anisomap.numerics.similarity.co_occurrence import (
    CHUNK_FRAMES,
    MIN_COMPILED_SENSORS,
    joint_logarithms,
)

_MAX_COMPILED_CODES = 64  # of a sensor; joint counts of more would take too much memory


def mutual_information(readings: ArrayLike, bins: int = DEFAULT_BINS) -> Reals:
    """Compute the mutual information of the binned readings of every pair of sensors.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.
    bins : int
        Maximum number of maximum-entropy bins per sensor, b >= 2.

    Returns
    -------
    ndarray of shape (N, N)
        I(A; B) in nats, between 0 and min(H(A), H(B)), exactly symmetric. The diagonal contains
        the entropies, I(A; A) = H(A).

    Raises
    ------
    InputError
        If `bins` is less than 2.

    Notes
    -----
    McGregor et al. (2011), section "Information Theory". This is the plug-in estimate, without
    correction for the number of frames.
    """
    return information_from_codes(maximum_entropy_codes(readings, bins))


def information_from_codes(codes: ArrayLike) -> Reals:
    """Compute the mutual information of every pair of discrete series. Returns (N, N).

    With counts n over T frames, ``T I(A; B) = sum n_ab log n_ab - sum n_a log n_a
    - sum n_b log n_b + T log T``. Counts are exact integers.
    """
    values = np.asarray(codes)
    n_frames, n_sensors = values.shape
    n_codes = int(values.max()) + 1
    if n_sensors >= MIN_COMPILED_SENSORS and n_codes <= _MAX_COMPILED_CODES:
        joint = joint_logarithms(values, n_codes)
    else:
        joint = _joint_logarithms_by_products(values, n_codes)
    return information_from_logarithms(joint, n_frames)


def information_from_logarithms(joint: Floats, n_frames: int) -> Reals:
    """Compute the mutual information from the sums of n log n over joint counts.

    joint (N, N) -> (N, N).
    """
    # On the diagonal both codes are equal, so its entries are the marginal sums of n_a log n_a.
    marginal = np.diag(joint)
    entropy = (np.log(n_frames) - marginal / n_frames).clip(0)
    information = np.empty(joint.shape, float_type(len(joint)))
    for rows in row_blocks(len(joint)):
        shared = joint[rows] - np.add.outer(marginal[rows], marginal)
        shared /= n_frames
        shared += np.log(n_frames)
        # Rounding can exceed the bounds 0 <= I <= min(H, H) by about 1e-16.
        information[rows] = np.clip(shared, 0, np.minimum.outer(entropy[rows], entropy))
    np.fill_diagonal(information, entropy)
    return information


def _joint_logarithms_by_products(codes: NDArray[np.generic], n_codes: int) -> Floats:
    """Sum n log n over joint counts, by one matrix product per pair of codes.

    Memory does not grow with the number of codes.
    """
    joint = np.zeros((codes.shape[1],) * 2)
    for a in range(n_codes):
        counts = _count_pair(codes, a, a)
        joint += xlogy(counts, counts)
        for b in range(a + 1, n_codes):
            counts = _count_pair(codes, a, b)
            terms = xlogy(counts, counts)
            joint += terms + terms.T
    return joint


def _count_pair(codes: NDArray[np.generic], first: int, second: int) -> Floats:
    """Count frames in which sensor i has the first code and sensor j the second, shape (N, N)."""
    n_sensors = codes.shape[1]
    counts = np.zeros((n_sensors, n_sensors))
    for start in range(0, len(codes), CHUNK_FRAMES):
        chunk = codes[start : start + CHUNK_FRAMES]
        # float32 products are fastest, and exact for counts of up to 2^24 frames.
        left = (chunk == first).astype(np.float32)
        right = left if first == second else (chunk == second).astype(np.float32)
        counts += left.T @ right
    return counts
