"""Mean of linear and rank correlation, weighted by their reliability."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.precision import Reals
from anisomap.numerics.reliability.sampling_noise import sampling_variance
from anisomap.numerics.reliability.split_half import (
    SplitCorrelation,
    at_frames,
    correlation_and_reliability,
)
from anisomap.numerics.similarity.rest import Rest, rest_and_ranks

# Tuned on simulated skins, seeds 101-105; 3 to 10 in place of 5 give about equal maps.
_POWER_OF_RELIABILITY = 5.0
_POWER_OF_RATIO = 10.0
_MAX_SENSORS_OF_HALVES = 1500  # of which the halves of two similarities take 72 MB

_MIN_FRAMES_FOR_HALVES = 8192
"""Frames from which autocorrelations of all frames serve for the halves; chosen by hand.

The halves of shorter recordings differ by up to 10 % in the variance of their correlations.
"""


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
    return split_blend(readings).similarity


@dataclass(frozen=True, eq=False)
class SplitBlend:
    """A blended correlation of all frames, and those of the two halves of the frames.

    similarity (N, N): See `blended_correlation`.
    weights: Weight of Pearson's r, in [0, 1], in all frames and in each of the `halves`.
    ranks (T, N): Ranks of depths beyond rest, of float32 or float64.
    halves (N, N): Blended correlations of the halves of the frames
        (`anisomap.numerics.reliability.split_half.split_blocks`), with ranks among all frames;
        empty if they were not asked for.
    """

    similarity: Reals
    weights: tuple[float, ...]
    rest: Rest
    ranks: Reals
    halves: tuple[Reals, ...] = ()


def split_blend(readings: ArrayLike, *, halves: bool = False) -> SplitBlend:
    """Compute `blended_correlation` with what it was blended from, and that of halves.

    readings (T, N).
    """
    values = np.asarray(readings)
    rest, ranks = rest_and_ranks(values, single=True)
    halves = halves and values.shape[1] <= _MAX_SENSORS_OF_HALVES
    linear, by_rank = (correlation_and_reliability(one, halves=halves) for one in (values, ranks))
    parts = zip((linear, *linear.halves), (by_rank, *by_rank.halves), strict=True)
    blended, weights = zip(*(_blended(*part) for part in parts), strict=True)
    return SplitBlend(blended[0], weights, rest, ranks, blended[1:])


@dataclass(frozen=True, eq=False)
class Blend:
    """A blended correlation, and what it was blended from.

    similarity (N, N): See `blended_correlation`.
    variance (N, N): Its sampling variance for unrelated sensors.
    weights: Weight of Pearson's r, in [0, 1], in all frames and in each of the `halves`.
    ranks_of_all (T, N): Ranks of depths beyond rest, in all frames of the recording.
    halves (N, N): See `SplitBlend`.
    deviations (N, N): Standard deviations of r and of rho of unrelated sensors; empty for short
        recordings.
    frames: Frames of the half that was blended.
    """

    similarity: Reals
    variance: Reals
    weights: tuple[float, ...]
    rest: Rest
    ranks_of_all: Reals
    halves: tuple[Reals, ...] = ()
    deviations: tuple[Reals, ...] = ()
    frames: NDArray[np.intp] | None = None

    def select(self, sensors: NDArray[np.bool_]) -> Blend:
        """Return the blend of some of the sensors, given as a mask of shape (N,)."""
        inside = np.ix_(sensors, sensors)
        return replace(
            self,
            similarity=self.similarity[inside],
            variance=self.variance[inside],
            rest=self.rest.select(sensors),
            ranks_of_all=self.ranks_of_all[:, sensors],
            halves=tuple(half[inside] for half in self.halves),
            deviations=tuple(one[inside] for one in self.deviations),
        )

    @property
    def weight(self) -> float:
        """Weight of Pearson's r in all frames, in [0, 1]."""
        return self.weights[0]

    @cached_property
    def ranks(self) -> Reals:
        """Ranks of depths in the blended frames, shape (t, N)."""
        if self.frames is None:
            return self.ranks_of_all
        return np.asarray(at_frames(self.ranks_of_all, self.frames))

    def of_half(self, half: int, frames: NDArray[np.intp], readings: NDArray[np.generic]) -> Blend:
        """Return the blend of one of the halves, given its frames and its readings."""
        weight, ranks = self.weights[1 + half], self.ranks_of_all
        if self.deviations:
            # Readings are as autocorrelated in a half as in all frames.
            variance = _combined_variance(weight, self.deviations)
            variance *= len(ranks) / len(frames)
        else:
            parts = (readings, at_frames(ranks, frames))
            variance = _combined_variance(weight, _deviations(parts))
        return Blend(self.halves[half], variance, (weight,), self.rest, ranks, frames=frames)


def blend(readings: ArrayLike) -> Blend:
    """Compute `blended_correlation` and its sampling variance, with what they are computed from.

    readings (T, N).

    The variance is ``(w sd(r) + (1 - w) sd(rho))^2``, with the standard deviations of
    `anisomap.numerics.reliability.sampling_noise.sampling_variance` for the readings and for the
    ranks: the errors of r and rho are taken to be proportional, as they nearly are.
    """
    values = np.asarray(readings)
    found = split_blend(values, halves=True)
    deviations = _deviations((values, found.ranks))
    variance = _combined_variance(found.weights[0], deviations)
    kept = deviations if found.halves and len(values) >= _MIN_FRAMES_FOR_HALVES else ()
    return Blend(
        found.similarity, variance, found.weights, found.rest, found.ranks, found.halves, kept
    )


def _deviations(parts: tuple[NDArray[Any], ...]) -> tuple[Reals, ...]:
    """Return the standard deviations of the correlations of readings and of ranks."""
    return tuple(np.sqrt(sampling_variance(part)) for part in parts)


def _combined_variance(weight: float, deviations: tuple[Reals, ...]) -> Reals:
    linear, by_rank = deviations
    deviation = weight * linear
    deviation += (1 - weight) * by_rank
    return np.asarray(np.square(deviation, out=deviation))


def _blended(linear: SplitCorrelation, by_rank: SplitCorrelation) -> tuple[Reals, float]:
    """Return the blended correlation, and the weight of Pearson's r; overwrite `linear`."""
    p, q = max(linear.reliability, 0.0), max(by_rank.reliability, 0.0)
    ratio = 1.0 if q >= p else q / p
    weight = 1 - (1 - p**_POWER_OF_RELIABILITY) * ratio**_POWER_OF_RATIO
    blended = linear.correlation
    blended *= weight
    blended += (1 - weight) * by_rank.correlation
    np.fill_diagonal(blended, 1.0)
    return blended, weight
