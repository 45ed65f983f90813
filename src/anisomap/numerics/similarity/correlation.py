"""Correlations of every pair of sensors, from sums over frames that can be merged."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.distance import squareform

from anisomap.numerics.columns import centred_rows, ranked
from anisomap.numerics.precision import Floats, Reals, float_type, slices_of, symmetric_from_upper
from anisomap.numerics.similarity.rest import estimate_rest

CHUNK_FRAMES = 8192
"""Frames multiplied at a time, which bounds the memory of their copy in float64."""

_MIN_SINGLE = 200  # sensors; rounding of products in float32 is far below the sampling noise


@dataclass(frozen=True, eq=False)
class PairSums:
    """Sums over T frames of the readings of N sensors, which can be merged.

    mean (N,): Mean reading of each sensor.
    products (N, N): Sums over frames of products of deviations from the means: T times the
        covariance. Exactly symmetric, and exactly zero for constant sensors.
    """

    n_frames: int
    mean: Floats
    products: Floats

    @classmethod
    def of(cls, readings: ArrayLike) -> PairSums:
        """Sum over finite readings, (T, N), T >= 1."""
        values, parts = np.asarray(readings), []
        for frames in slices_of(len(values), CHUNK_FRAMES):
            first = values[frames.start]
            # Differences from the first frame have no rounding error if a sensor is constant.
            deviations = np.subtract(values[frames], first, dtype=np.float64)
            mean = deviations.mean(axis=0)
            deviations -= mean
            # A unit for each sensor prevents overflow and underflow of squares in float32.
            unit = np.maximum(np.abs(deviations).max(axis=0), np.finfo(np.float64).tiny)
            deviations /= unit
            scaled = deviations.astype(np.float32 if unit.size >= _MIN_SINGLE else np.float64)
            products = np.outer(unit, unit) * (scaled.T @ scaled)
            parts.append(cls(len(deviations), first + mean, products))
        return reduce(cls.merged, parts)

    def merged(self, other: PairSums) -> PairSums:
        """Merge with the sums over other frames of the same sensors, in any order up to rounding.

        Chan, Golub & LeVeque (1983), The American Statistician 37: 242-247.
        """
        n_frames = self.n_frames + other.n_frames
        step = other.mean - self.mean
        products = np.outer(step, step)
        products *= self.n_frames * other.n_frames / n_frames
        products += self.products
        products += other.products
        return PairSums(n_frames, self.mean + step * (other.n_frames / n_frames), products)

    def correlation(self) -> Reals:
        """Return Pearson's r of every pair of sensors, (N, N): see `pearson`."""
        spread = np.sqrt(np.diag(self.products))
        scale = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0)
        # Multiplying the scales first rounds (i, j) and (j, i) alike.
        correlation = np.outer(scale, scale)
        correlation *= self.products
        np.clip(correlation, -1, 1, out=correlation)
        np.fill_diagonal(correlation, 1.0)
        return correlation.astype(float_type(len(correlation)), copy=False)


def pearson(readings: ArrayLike) -> Reals:
    """Compute Pearson's r of every pair of sensors. readings (T, N) -> (N, N).

    In [-1, 1], exactly symmetric, ones on the diagonal; 0 between a constant sensor and any other.
    """
    return PairSums.of(readings).correlation()


def spearman(readings: ArrayLike) -> Reals:
    """Compute Spearman's rho of every pair of sensors; see `pearson`.

    Ties are assigned their mean rank. Invariant under increasing transformations of a sensor.
    """
    return pearson(ranked(readings))


def co_activation(readings: ArrayLike) -> Reals:
    """Compute the phi coefficient of the activity (beyond rest or not) of every pair of sensors.

    Phi is Pearson's r of 0 and 1. See `pearson` for the shapes and `estimate_rest` for the
    definition of rest.
    """
    return pearson(estimate_rest(readings).active(readings).astype(np.float64))


N_BLOCKS = 20
"""Number of blocks of consecutive frames that form the two halves; chosen by hand."""

_MIN_SPLIT_FRAMES = 4  # for a reliability: 2 per half
_MIN_SPLIT_SENSORS = 3  # for a reliability: a correlation over 3 pairs
_MAX_PAIRED = 4000  # sampled sensors; their 8 million pairs determine a reliability


def correlation_and_reliability(
    readings: ArrayLike, n_blocks: int = N_BLOCKS
) -> tuple[Reals, float]:
    """Compute Pearson's r, and its correlation between two halves, over pairs of sensors.

    readings (T, N) -> (N, N), reliability in [-1, 1].
    """
    values = np.asarray(readings)
    n_frames, n_sensors = values.shape
    if n_frames < _MIN_SPLIT_FRAMES or n_sensors < _MIN_SPLIT_SENSORS:
        return pearson(values), 0.0
    # Merging the halves takes a tenth of the time of multiplying all frames again.
    blocks = np.array_split(values, min(n_blocks, n_frames))  # contacts last for several frames
    first, second = (PairSums.of(np.concatenate(blocks[half::2])) for half in (0, 1))
    whole, step = first.merged(second).correlation(), -(-n_sensors // _MAX_PAIRED)
    halves = (one.correlation()[::step, ::step] for one in (first, second))
    pairs = [squareform(one, checks=False) for one in halves]
    return whole, float(pearson(np.stack(pairs, axis=1))[0, 1])


_STACKED_BYTES = 1 << 24  # of products of all blocks for some sensors; chosen by hand


def resampled_correlation(
    readings: NDArray[np.floating], edges: NDArray[np.intp], weights: Floats
) -> NDArray[np.float32]:
    """Compute Pearson's r of every pair of sensors over weighted blocks of frames.

    readings (T, N), weights (R, B) -> (R, N, N).
    """
    scaled = centred_rows(readings)
    n_sensors, n_blocks = len(scaled), len(edges) - 1
    share = weights / (weights @ np.diff(edges))[:, None]
    share = share.astype(np.float32)
    means = share @ np.add.reduceat(scaled, edges[:-1], axis=1).T
    found = np.zeros((len(weights), n_sensors, n_sensors), np.float32)
    blocks = list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))
    at_once = max(8, _STACKED_BYTES // (4 * n_blocks * n_sensors))
    workspace = np.empty(n_blocks * min(at_once, n_sensors) * n_sensors, np.float32)
    for begin in range(0, n_sensors, at_once):
        # Products of each sensor with itself and all later ones.
        rows, columns = slice(begin, begin + at_once), slice(begin, None)
        shape = found[0, rows, columns].shape
        products = workspace[: n_blocks * math.prod(shape)].reshape(n_blocks, *shape)
        for product, (first, end) in zip(products, blocks, strict=True):
            np.matmul(scaled[rows, first:end], scaled[columns, first:end].T, out=product)
        weighted = share @ products.reshape(n_blocks, -1)
        found[:, rows, columns] = weighted.reshape(len(weights), *shape)
    for matrix, mean in zip(found, means, strict=True):
        covariance = matrix - np.outer(mean, mean)
        variance = np.diag(covariance)
        scale = np.where(variance > 0, 1 / np.sqrt(np.where(variance > 0, variance, 1)), 0)
        matrix[:] = symmetric_from_upper(covariance * np.outer(scale, scale))
        np.fill_diagonal(matrix, 1.0)
    return np.asarray(np.clip(found, -1, 1, out=found))


_MIN_SENSORS = 8  # with fewer, each sensor makes up much of the mean; chosen by hand
_APART = 0.25  # share of the pairs that count as distant
_MAX_FRAMES, _MAX_SAMPLED = 4000, 250  # evenly spaced frames and sensors for the common signal


def without_common_signal(readings: NDArray[Any]) -> tuple[NDArray[Any], float]:
    """Return readings less the signal that all sensors share, shape (T, N), and its share s.

    s, in [0, 1], is the signal's share of the variance of the mean over sensors: ``c / mean(r)``,
    over all pairs. If all standardised sensors share a signal of variance c, and other signals are
    local, distant pairs have the correlation c. The lower quartile of r estimates c, since contacts
    as wide as half of the skin do not reach both sensors of a quarter of the pairs.

    The mean over sensors estimates the signal. It is subtracted with the weight ``sqrt(s)``, the
    signal's share of its amplitude. A weight of 1 gives the average reference of EEG (Offner 1950;
    Bertrand, Perrin & Pernier 1985, Electroencephalography and Clinical Neurophysiology 62:
    462-464). If a sensor contains less of the mean than other sensors, only this part is
    subtracted; otherwise, all such sensors would share the negative of the signal.
    """
    n_frames, n_sensors = readings.shape
    some = readings[:: -(-n_frames // _MAX_FRAMES), :: -(-n_sensors // _MAX_SAMPLED)]
    r = pearson(some[:, (some != some[0]).any(axis=0)])
    pairs = r[np.triu_indices(len(r), 1)]
    apart = float(np.quantile(pairs, _APART)) if len(r) >= _MIN_SENSORS else 0.0
    if apart <= 0:
        return readings, 0.0
    share = min(1.0, apart / float(r.mean(dtype=np.float64)))
    values = readings.astype(np.float64)
    values -= values.mean(axis=0)
    amplitude = values.std(axis=0)
    varies = amplitude > 0
    mean = (values[:, varies] / amplitude[varies]).mean(axis=1)
    size = max(float(mean @ mean), np.finfo(float).tiny)
    own = np.clip(mean @ values / np.where(varies, amplitude, 1) / size, 0, 1)
    values -= math.sqrt(share) * mean[:, None] * (own * amplitude)
    return values, share
