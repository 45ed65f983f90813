"""Agreement of the similarity of sensors to all others between two sets of data.

Split-half reliability of correlations.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.errors import InputError
from anisomap.numerics.precision import Reals
from anisomap.numerics.similarity.correlation import moments, scale_extremes

_MAX_CORRELATION = 0.999  # a profile hardly repeats better; Fisher's z stays finite


def profile_agreement(
    first: Reals,
    second: Reals,
    known_first: NDArray[np.bool_],
    known_second: NDArray[np.bool_],
) -> NDArray[np.float64]:
    """Correlate the profile of each sensor in one similarity with each profile in another.

    first, second (N, N) -> (N, N).
    """
    others = ~np.eye(len(first), dtype=bool)
    a_known, b_known = (
        (known & others).astype(np.float64) for known in (known_first, known_second)
    )
    a, b = first * a_known, second * b_known
    count = np.maximum(a_known @ b_known.T, 1.0)
    sum_a, sum_b = a @ b_known.T, a_known @ b.T
    covariance = a @ b.T - sum_a * sum_b / count
    variance_a = (a * a) @ b_known.T - sum_a**2 / count
    variance_b = a_known @ (b * b).T - sum_b**2 / count
    size = np.sqrt(np.maximum(variance_a, 0) * np.maximum(variance_b, 0))
    least = np.finfo(np.float64).eps * len(first)
    found = np.divide(covariance, size, out=np.zeros_like(size), where=size > least)
    return np.asarray(np.arctanh(np.clip(found, -_MAX_CORRELATION, _MAX_CORRELATION)))


N_BLOCKS = 20
"""Number of blocks of consecutive frames that form the two halves; chosen by hand."""

MIN_FRAMES = 4
"""Minimum number of frames for a reliability: 2 per half."""

MIN_SENSORS = 3
"""Minimum number of sensors for a reliability: a correlation over 3 pairs."""

_MAX_SENSORS = 4000  # sampled sensors; their 8 million pairs determine the reliability
_ROUNDING = 1e-12  # relative, of a variance over pairs that is 0


def split_blocks(n_frames: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Split frames into two halves of alternating blocks of consecutive frames.

    Halves of alternating frames would be nearly equal, since contacts last several frames; halves
    of alternating blocks are nearly independent.
    """
    if n_frames < 2:
        raise InputError(f"split-half needs at least 2 frames, got {n_frames}")
    blocks = np.array_split(np.arange(n_frames), min(N_BLOCKS, n_frames))
    return np.concatenate(blocks[::2]), np.concatenate(blocks[1::2])


def at_frames(values: NDArray[Any], frames: NDArray[np.intp]) -> NDArray[Any]:
    """Return the readings of increasing frames, shape (t, N).

    As ``values[frames]``, but runs of consecutive frames are copied at once, and the result is
    contiguous by column if the values are.
    """
    ends = np.flatnonzero(np.diff(frames, append=-1) != 1)
    begins = frames[np.concatenate([[0], ends[:-1] + 1])]
    runs = zip(begins.tolist(), frames[ends].tolist(), strict=True)
    return np.concatenate([values[first : last + 1] for first, last in runs])


@dataclass(frozen=True, eq=False)
class SplitCorrelation:
    """Pearson's r of all pairs of sensors, and how well it repeats.

    correlation (N, N): Of all frames: see `anisomap.numerics.similarity.correlation.pearson`.
    reliability: Correlation between the halves of the frames, over pairs of sensors, in [-1, 1].
    """

    correlation: Reals
    reliability: float


def correlation_and_reliability(readings: ArrayLike) -> SplitCorrelation:
    """Compute Pearson's r, and correlate it between the two halves, over pairs of sensors.

    readings (T, N).
    """
    values = scale_extremes(readings)
    n_frames, n_sensors = values.shape
    step = -(-n_sensors // _MAX_SENSORS)
    if n_frames < MIN_FRAMES:
        return SplitCorrelation(moments(values).correlation(), 0.0)
    # Merging the halves takes a tenth of the time of multiplying all frames again.
    first, second = (moments(at_frames(values, half)) for half in split_blocks(n_frames))
    even, odd = (one.correlation()[::step, ::step] for one in (first, second))
    reliability = _agreement(even, odd, len(even))
    return SplitCorrelation(first.merged(second).correlation(), reliability)


def _agreement(first: Reals, second: Reals, n_compared: int) -> float:
    """Correlate two matrices over the pairs of some sensors; 0 if either is constant.

    Both matrices are symmetric, have a diagonal of 1, and are 0 in the rows of all other sensors,
    so that sums over all elements replace the selection of pairs.
    """
    if n_compared < MIN_SENSORS:
        return 0.0
    a, b = (np.asarray(one, dtype=np.float64).ravel() for one in (first, second))
    n_pairs = n_compared * (n_compared - 1)

    def mean(total: float) -> float:
        return (total - len(first)) / n_pairs

    squares = mean(float(a @ a)), mean(float(b @ b))
    means = mean(float(a.sum())), mean(float(b.sum()))
    variances = [square - one**2 for square, one in zip(squares, means, strict=True)]
    if any(v <= _ROUNDING * s for v, s in zip(variances, squares, strict=True)):
        return 0.0
    covariance = mean(float(a @ b)) - means[0] * means[1]
    return float(np.clip(covariance / math.sqrt(variances[0] * variances[1]), -1, 1))
