"""Split-half reliability of correlations, and linear and rank correlation blended by it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import squareform

from anisomap.errors import InputError
from anisomap.numerics.precision import Floats, Reals
from anisomap.numerics.reliability.sampling_noise import sampling_variance
from anisomap.numerics.similarity.correlation import PairSums, pearson, resampled_correlation
from anisomap.numerics.similarity.rest import Rest, ranks_of_depths

N_BLOCKS = 20
"""Number of blocks of consecutive frames that form the two halves; chosen by hand."""

_MIN_FRAMES = 4  # for a reliability: 2 per half
_MIN_SENSORS = 3  # for a reliability: a correlation over 3 pairs
_MAX_SENSORS = 4000  # sampled sensors; their 8 million pairs determine the reliability
_ROUNDING = 1e-12  # relative, of a variance over pairs that is 0


def split_blocks(n_frames: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Split frames into two halves of alternating blocks: contacts last for several frames."""
    if n_frames < 2:
        raise InputError(f"split-half needs at least 2 frames, got {n_frames}")
    blocks = np.array_split(np.arange(n_frames), min(N_BLOCKS, n_frames))
    return np.concatenate(blocks[::2]), np.concatenate(blocks[1::2])


def at_frames(values: NDArray[Any], frames: NDArray[np.intp]) -> NDArray[Any]:
    """Return the readings of increasing frames, (t, N), in the memory order of all.

    As ``values[frames]``, but runs of consecutive frames are copied at once.
    """
    ends = np.flatnonzero(np.diff(frames, append=-1) != 1)
    begins = frames[np.concatenate([[0], ends[:-1] + 1])]
    runs = zip(begins.tolist(), frames[ends].tolist(), strict=True)
    return np.concatenate([values[first : last + 1] for first, last in runs])


def correlation_and_reliability(readings: ArrayLike) -> tuple[Reals, float]:
    """Compute Pearson's r, and its correlation between the two halves, over pairs of sensors.

    readings (T, N) -> (N, N), reliability in [-1, 1].
    """
    values = np.asarray(readings)
    n_frames, n_sensors = values.shape
    if n_frames < _MIN_FRAMES:
        return pearson(values), 0.0
    # Merging the halves takes a tenth of the time of multiplying all frames again.
    first, second = (PairSums.of(at_frames(values, half)) for half in split_blocks(n_frames))
    step = -(-n_sensors // _MAX_SENSORS)
    halves = (one.correlation()[::step, ::step] for one in (first, second))
    return first.merged(second).correlation(), _agreement(*halves)


def _agreement(first: Reals, second: Reals) -> float:
    """Correlate two symmetric matrices over the pairs of sensors; 0 if either is constant."""
    if len(first) < _MIN_SENSORS:
        return 0.0
    a, b = (squareform(one, checks=False).astype(np.float64) for one in (first, second))
    squares = a @ a, b @ b
    a -= a.mean()
    b -= b.mean()
    if any(one @ one <= _ROUNDING * size for one, size in zip((a, b), squares, strict=True)):
        return 0.0
    return float(np.clip((a @ b) / math.sqrt((a @ a) * (b @ b)), -1, 1))


# Tuned on simulated skins, seeds 101-105; 3 to 10 in place of 5 give about equal maps.
_POWER_OF_RELIABILITY = 5.0
_POWER_OF_RATIO = 10.0


def blended_correlation(readings: ArrayLike) -> Reals:
    """Combine Pearson's r and Spearman's rho by their split-half reliability.

    Parameters
    ----------
    readings : array_like of shape (T, N)
        Finite readings.

    Returns
    -------
    ndarray of shape (N, N)
        ``w r + (1 - w) rho``: in [-1, 1], exactly symmetric, ones on the diagonal. Invariant
        under changes of the unit and the zero of a sensor.

    Notes
    -----
    On tactile data a few deep contacts dominate Pearson's r, which makes it noisy in short
    recordings; ranks are less noisy but distort distances. Ranks are of depths beyond rest
    (`anisomap.numerics.similarity.rest.estimate_rest`), since ranks of readings at rest are noise.
    With the reliabilities p of r and q of rho, ``1 - w = (1 - p^5) min(1, q / p)^10``: rho has
    weight if r is unreliable, unless rho is even less reliable.
    """
    values = np.asarray(readings)
    ranks = ranks_of_depths(values, single=True)
    return _blended(correlation_and_reliability(values), correlation_and_reliability(ranks))[0]


@dataclass(frozen=True, eq=False)
class Blend:
    """A blended correlation, and what it was blended from.

    similarity, variance (N, N): See `blended_correlation`; variance for unrelated sensors.
    weight: Weight of Pearson's r, in [0, 1].
    readings, ranks (T, N): Ranks are of depths beyond rest.
    """

    similarity: Reals
    variance: Reals
    weight: float
    readings: NDArray[Any]
    ranks: Reals

    @classmethod
    def of(cls, readings: ArrayLike, rest: Rest | None = None, *, centred: bool = False) -> Blend:
        """Blend the correlations of readings, (T, N), whose rest may be known.

        centred: Whether a common signal was subtracted, after which sensors do not rest alike.
        The variance is ``(w sd(r) + (1 - w) sd(rho))^2``: the errors of r and rho are nearly
        proportional.
        """
        values = np.asarray(readings)
        ranks = ranks_of_depths(values, rest, single=True, alike=not centred)
        both = (correlation_and_reliability(one) for one in (values, ranks))
        similarity, weight = _blended(*both)
        deviation = weight * np.sqrt(sampling_variance(values))
        deviation += (1 - weight) * np.sqrt(sampling_variance(ranks))
        return cls(similarity, np.square(deviation, out=deviation), weight, values, ranks)

    def select(self, sensors: NDArray[np.bool_]) -> Blend:
        """Return the blend of some of the sensors, given as a mask of shape (N,)."""
        inside = np.ix_(sensors, sensors)
        return replace(
            self,
            similarity=self.similarity[inside],
            variance=self.variance[inside],
            readings=self.readings[:, sensors],
            ranks=self.ranks[:, sensors],
        )

    def resampled(self, edges: NDArray[np.intp], weights: Floats) -> NDArray[np.floating]:
        """Return the correlations over weighted blocks of frames. weights (R, B) -> (R, N, N)."""
        found = resampled_correlation(self.readings, edges, weights)
        found *= self.weight
        rho = resampled_correlation(self.ranks, edges, weights)
        rho *= 1 - self.weight
        found += rho
        return found


def _blended(linear: tuple[Reals, float], by_rank: tuple[Reals, float]) -> tuple[Reals, float]:
    """Return the blended correlation, and the weight of Pearson's r; overwrite `linear`."""
    (blended, p), (rho, q) = linear, by_rank
    p, q = max(p, 0.0), max(q, 0.0)
    ratio = 1.0 if q >= p else q / p
    weight = 1 - (1 - p**_POWER_OF_RELIABILITY) * ratio**_POWER_OF_RATIO
    blended *= weight
    blended += (1 - weight) * rho
    np.fill_diagonal(blended, 1.0)
    return blended, weight
