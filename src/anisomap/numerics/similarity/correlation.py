"""Correlations of every pair of sensors, from moments of readings that can be merged."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csc_array

from anisomap.numerics.columns import centred_rows, ranked
from anisomap.numerics.compiled.parallel import (
    MIN_COMPILED_ROWS,
    has_loops,
    load_loops,
    parallel_map,
)
from anisomap.numerics.precision import MAX_SQUARED, Floats, Reals, float_type, mirror, row_blocks
from anisomap.numerics.similarity.co_occurrence import (
    CHUNK_FRAMES,
    Codes,
    Counts,
    Layout,
    co_occurrences,
)
from anisomap.numerics.similarity.rest import estimate_rest

_DENSE_PER_SPARSE = 40  # dense products in the time of one sparse product; measured
_SAMPLE_FRAMES = 63  # frames from which the rest value is estimated
_PANEL_ROWS = 192  # rows of the result per task; with 96, products take a fifth longer


def is_sparse(readings: NDArray[Any]) -> bool:
    """Return whether `sparse_comoments` is faster than a matrix product, for shape (T, N)."""
    n_frames, n_sensors = readings.shape
    active = np.count_nonzero(readings != _rest(readings), axis=1).astype(np.float64)
    return bool(_DENSE_PER_SPARSE * np.vdot(active, active) <= float(n_sensors) ** 2 * n_frames)


def sparse_comoments(readings: NDArray[Any]) -> tuple[Floats, Floats]:
    """Compute means and co-moments from the readings that differ from rest.

    readings (T, N) -> mean (N,), comoment (N, N).
    """
    n_frames, n_sensors = readings.shape
    rest = _rest(readings)
    begins, sensors, depths = _active(readings, rest)
    sums = np.bincount(sensors, weights=depths, minlength=n_sensors)
    products = np.empty((n_sensors, n_sensors))

    def add(begin: int) -> None:
        rows = slice(begin, min(begin + _PANEL_ROWS, n_sensors))
        np.outer(sums[rows], sums / -n_frames, out=products[rows])
        load_loops("similarity").add_products(products[rows], begin, sensors, depths, begins)

    with parallel_map(n_sensors) as map_threads:
        map_threads(add, range(0, n_sensors, _PANEL_ROWS))
    mirror(products)
    return rest + sums / n_frames, products


def _active(
    readings: NDArray[Any], rest: NDArray[Any]
) -> tuple[NDArray[np.int64], NDArray[np.uint32], Floats]:
    """Return the readings that differ from rest, frame by frame, as sparse matrices are stored."""
    by_sensor = readings.strides[0] < readings.strides[1]
    rows = readings.T if by_sensor else readings  # in the order of memory
    active = rows != (rest[:, None] if by_sensor else rest)
    counts = np.count_nonzero(active, axis=1)
    begins = np.concatenate([[0], np.cumsum(counts)])
    found = np.flatnonzero(active)  # faster than a search in two dimensions
    values = rows.ravel()[found].astype(np.float64)
    if by_sensor:
        found -= np.repeat(np.arange(len(rows)) * rows.shape[1], counts)
        values -= np.repeat(rest, counts)
        stored: Any = csc_array((values, found, begins), shape=readings.shape).tocsr()
        return stored.indptr.astype(np.int64), stored.indices.astype(np.uint32), stored.data
    sensors = found - np.repeat(np.arange(len(rows)) * rows.shape[1], counts)
    values -= rest[sensors]
    return begins.astype(np.int64), sensors.astype(np.uint32), values


def _rest(readings: NDArray[Any]) -> NDArray[Any]:
    """Estimate the most frequent reading of each sensor by the median of some frames."""
    n_frames = len(readings)
    frames = np.linspace(0, n_frames - 1, min(n_frames, _SAMPLE_FRAMES)).astype(int)
    return np.asarray(np.sort(readings[frames], axis=0)[len(frames) // 2])


MIN_FAST_PRODUCT_SENSORS = 128
"""Minimum number of sensors for products in float32; below, they save little time."""

SINGLE_FRAMES = 1024
"""Products summed in float32. A sum of n products is off by n 2^-24 at most, relative to the sum of
their magnitudes, so r is by 6e-5; with heavy tails, errors of 1e-5 were found."""

_BLOCK_ROWS = 64  # rows normalised at a time; their intermediate arrays stay in the cache
_FLOAT32_RANGE = 1e15  # of readings; sums of their squares over frames stay within float32


@dataclass(frozen=True, eq=False)
class Moments:
    """First and second moments of N sensors over T frames.

    Attributes
    ----------
    n_frames : int
        T.
    mean : ndarray of shape (N,)
        Mean reading of each sensor.
    comoment : ndarray of shape (N, N)
        Sums over frames of products of deviations from the means: T times the covariance. Exactly
        symmetric, and exactly zero for constant sensors.
    """

    n_frames: int
    mean: Floats
    comoment: Floats

    @classmethod
    def of(cls, readings: ArrayLike, *, single: bool = False) -> Moments:
        """Compute the moments of finite readings, (T, N).

        single: Whether to multiply in float32, twice as fast; correlations are accurate to 6e-5.
        """
        values = np.asarray(readings)
        total = cls._of_chunk(values[:CHUNK_FRAMES], single)
        for begin in range(CHUNK_FRAMES, len(values), CHUNK_FRAMES):
            total = total.merged(cls._of_chunk(values[begin : begin + CHUNK_FRAMES], single))
        return total

    @classmethod
    def _of_chunk(cls, chunk: NDArray[np.generic], single: bool) -> Moments:
        if chunk.shape[1] >= MIN_COMPILED_ROWS and has_loops() and is_sparse(chunk):
            return cls(len(chunk), *sparse_comoments(chunk))
        if single and (found := _float32_deviations(chunk)) is not None:
            centre, small = found
            beside = (np.ones(len(chunk), np.float32) @ small).astype(np.float64) / len(chunk)
            comoment = np.outer(-len(chunk) * beside, beside)
            for begin in range(0, len(small), SINGLE_FRAMES):
                part = small[begin : begin + SINGLE_FRAMES]
                comoment += part.T @ part
            return cls(len(chunk), centre + beside, comoment)
        # Subtracting the first frame first leaves no rounding error for constant sensors. A copy in
        # float64 before would take longer than all the rest: memory that is new is slow.
        deviations = np.subtract(chunk, chunk[0], dtype=np.float64)
        mean = deviations.mean(axis=0)
        deviations -= mean
        return cls(len(chunk), chunk[0] + mean, deviations.T @ deviations)

    def merged(self, other: Moments) -> Moments:
        """Merge with the moments of other frames of the same sensors, in any order up to rounding.

        Chan, Golub & LeVeque (1983), The American Statistician 37: 242-247.
        """
        n_frames = self.n_frames + other.n_frames
        step = other.mean - self.mean
        weight = self.n_frames * other.n_frames / n_frames
        comoment = np.empty_like(self.comoment)
        for rows in row_blocks(len(comoment)):
            np.outer(step[rows], step, out=comoment[rows])
            comoment[rows] *= weight
            comoment[rows] += self.comoment[rows]
            comoment[rows] += other.comoment[rows]
        return Moments(n_frames, self.mean + step * (other.n_frames / n_frames), comoment)

    def varying(self) -> NDArray[np.bool_]:
        """Return which sensors vary, shape (N,)."""
        return np.asarray(np.diag(self.comoment) > 0)

    def correlation(self) -> Reals:
        """Return Pearson's r of every pair of sensors, (N, N): see `pearson`."""
        return correlation_of_blocks(np.diag(self.comoment), lambda rows: self.comoment[rows])


@dataclass(frozen=True, eq=False)
class CoOccurrences:
    """Joint counts (M, M) of binary series over T frames, and the first series of each sensor."""

    n_frames: int
    first: NDArray[np.int64]
    counts: Counts

    @classmethod
    def of(cls, codes: Codes, layout: Layout) -> CoOccurrences:
        """Count in an array of codes of shape (T, N), T >= 1."""
        return cls(len(codes), layout.first, co_occurrences(codes, layout))

    def merged(self, other: CoOccurrences) -> CoOccurrences:
        """Merge with the counts of other frames of the same series, in any order."""
        n_frames = self.n_frames + other.n_frames
        dtype = np.uint32 if n_frames <= np.iinfo(np.uint32).max else np.uint64
        return CoOccurrences(n_frames, self.first, np.add(self.counts, other.counts, dtype=dtype))


def correlation_of_blocks(squares: NDArray[Any], comoments: Callable[[slice], Floats]) -> Reals:
    """Normalise co-moments to correlations, some rows at a time. squares (N,) -> (N, N)."""
    n_sensors = len(squares)
    spread = np.sqrt(squares)
    scale = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0)
    correlation = np.empty((n_sensors, n_sensors), float_type(n_sensors))
    for begin in range(0, n_sensors, _BLOCK_ROWS):
        rows = slice(begin, begin + _BLOCK_ROWS)
        # Multiplying the scales first rounds (i, j) and (j, i) alike.
        products = np.outer(scale[rows], scale)
        products *= comoments(rows)
        np.maximum(products, -1, out=products)
        np.minimum(products, 1, out=products)
        correlation[rows] = products
    np.fill_diagonal(correlation, 1.0)
    return correlation


def _float32_deviations(chunk: NDArray[Any]) -> tuple[Floats, NDArray[np.float32]] | None:
    """Return approximate means and float32 deviations; None if squares would overflow float32."""
    lowest, highest = (np.asarray(f(chunk, axis=0), np.float64) for f in (np.min, np.max))
    extent = highest - lowest
    if (extent > _FLOAT32_RANGE).any() or ((extent < 1 / _FLOAT32_RANGE) & (extent > 0)).any():
        return None
    if chunk.dtype == np.float32:
        # Sums of rows in float32 would be rounded relative to themselves, and the mean be far off;
        # a difference of numbers in float32 is rounded relative to the difference.
        mean = np.clip(chunk.mean(axis=0, dtype=np.float64), lowest, highest).astype(np.float32)
        return mean.astype(np.float64), chunk - mean
    mean = np.where(extent > 0, chunk.mean(axis=0, dtype=np.float64), lowest)
    deviations = np.empty(chunk.shape, dtype=np.float32)
    # The subtraction is in float64: float32 would lose small deviations from a large mean.
    np.subtract(chunk, mean, out=deviations, dtype=np.float64, casting="same_kind")
    return mean, deviations


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

    def comoments(rows: slice) -> Floats:
        products = counts[rows].astype(np.int64)
        products *= n_frames
        products -= np.outer(on[rows], on)
        return products.astype(np.float64)

    return correlation_of_blocks(n_frames * on - on * on, comoments)


def squares_overflow(magnitude: Floats) -> NDArray[np.bool_]:
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
        # Of each sensor with itself and all later ones.
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
        np.multiply(covariance, np.outer(scale, scale), out=matrix)
        mirror(matrix)
        np.fill_diagonal(matrix, 1.0)
    return np.asarray(np.clip(found, -1, 1, out=found))


_MIN_SENSORS = 8  # of fewer, the mean is mostly each sensor's own reading; chosen by hand
_APART = 0.25  # share of the pairs that are taken for distant
_MAX_FRAMES, _MAX_SAMPLED = 4000, 250  # evenly spaced, that show the common signal


def common_share(correlation: Reals) -> float:
    """Return how much of the variance of the mean over sensors is a common signal, in [0, 1].

    It is ``c / mean(r)``, over all pairs. If all standardised sensors share a signal of variance c,
    and others are local, distant pairs have the correlation c, which the lower quartile of r
    estimates: contacts as wide as half of the skin leave a quarter of the pairs apart.
    """
    if len(correlation) < _MIN_SENSORS:
        return 0.0
    mean = float(correlation.mean(dtype=np.float64))
    apart = float(np.quantile(correlation[np.triu_indices(len(correlation), 1)], _APART))
    return min(1.0, apart / mean) if apart > 0 else 0.0


def without_common_signal(readings: NDArray[Any]) -> tuple[NDArray[Any], float]:
    """Return readings less the signal that all sensors share, shape (T, N), and its share.

    The mean over sensors estimates the signal, and is subtracted with the weight ``sqrt(s)``, the
    share of its amplitude, with s from `common_share`; with 1, it is the average reference of
    electroencephalography (Offner 1950; Bertrand, Perrin & Pernier 1985, Electroencephalography and
    Clinical Neurophysiology 62: 462-464). From a sensor that contains less of the mean than others,
    only what it contains is subtracted: otherwise all such sensors would share its negative.
    """
    n_frames, n_sensors = readings.shape
    some = readings[:: -(-n_frames // _MAX_FRAMES), :: -(-n_sensors // _MAX_SAMPLED)]
    varying = some[:, (some != some[0]).any(axis=0)]
    share = common_share(pearson(varying))
    if share == 0:
        return readings, 0.0
    values = scale_extremes(readings).astype(np.float64)
    values -= values.mean(axis=0)
    amplitude = values.std(axis=0)
    varies = amplitude > 0
    mean = (values[:, varies] / amplitude[varies]).mean(axis=1)
    size = max(float(mean @ mean), np.finfo(float).tiny)
    own = np.clip(mean @ values / np.where(varies, amplitude, 1) / size, 0, 1)
    values -= math.sqrt(share) * mean[:, None] * (own * amplitude)
    return values, share
