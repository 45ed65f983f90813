"""Mutual information of every pair of sensors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import xlogy

from anisomap.numerics.precision import Floats, Reals, float_type, row_blocks, slices_of
from anisomap.numerics.similarity.binning import DEFAULT_BINS, maximum_entropy_codes
from anisomap.numerics.similarity.correlation import CHUNK_FRAMES


def mutual_information(readings: ArrayLike, bins: int = DEFAULT_BINS) -> Reals:
    """Compute the mutual information of the binned readings of every pair of sensors.

    readings (T, N) -> I(A; B) in nats, (N, N), between 0 and min(H(A), H(B)), exactly symmetric.
    The diagonal contains the entropies, I(A; A) = H(A). bins: Maximum per sensor, at least 2.

    McGregor et al. (2011), section "Information Theory". This is the plug-in estimate, without
    correction for the number of frames.
    """
    return information_from_codes(maximum_entropy_codes(readings, bins))


def information_from_codes(codes: ArrayLike) -> Reals:
    """Compute the mutual information of every pair of discrete series. codes (T, N) -> (N, N)."""
    values = np.asarray(codes)
    n_frames, n_sensors = values.shape

    def count(first: int, second: int) -> Floats:
        counts = np.zeros((n_sensors, n_sensors))
        for frames in slices_of(n_frames, CHUNK_FRAMES):
            # float32 products are fastest, and exact for counts of up to 2^24.
            left = (values[frames] == first).astype(np.float32)
            right = left if first == second else (values[frames] == second).astype(np.float32)
            counts += left.T @ right
        return counts

    return information_from_logarithms(joint_logarithms(count, int(values.max()) + 1), n_frames)


def joint_logarithms(count: Callable[[int, int], Floats], n_codes: int) -> Floats:
    """Sum n log n over the joint counts of every pair of sensors, (N, N).

    count: ``count(a, b)`` returns the number of frames in which sensor i has code a and sensor j
        has code b, (N, N); memory does not grow with the number of codes.
    """
    joint: Floats = np.zeros(())
    for a in range(n_codes):
        for b in range(a, n_codes):
            counts = count(a, b)
            terms = xlogy(counts, counts)
            joint = joint + (terms if a == b else terms + terms.T)
    return joint


def information_from_logarithms(joint: Floats, n_frames: int) -> Reals:
    """Compute the mutual information from the sums of n log n over joint counts.

    joint (N, N) -> (N, N). With counts n over T frames, ``T I(A; B) = sum n_ab log n_ab
    - sum n_a log n_a - sum n_b log n_b + T log T``.
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
