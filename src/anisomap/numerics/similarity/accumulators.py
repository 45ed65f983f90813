"""Statistics of readings that are computed per chunk of frames and merged."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from anisomap.numerics.compiled.parallel import MIN_COMPILED_ROWS
from anisomap.numerics.precision import Reals, float_type, row_blocks
from anisomap.numerics.similarity.co_occurrence import (
    CHUNK_FRAMES,
    Codes,
    Counts,
    Layout,
    co_occurrences,
)
from anisomap.numerics.similarity.sparse_products import is_sparse, sparse_comoments

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
    mean: NDArray[np.float64]
    comoment: NDArray[np.float64]

    @classmethod
    def of(cls, readings: ArrayLike, *, single: bool = False) -> Moments:
        """Compute the moments of an array.

        Parameters
        ----------
        readings : array_like of shape (T, N)
            Finite readings, T >= 1.
        single : bool
            Multiply in float32, which is twice as fast. Means, deviations and sums over chunks
            stay float64, so that correlations are accurate to 6e-5, usually 1e-5.
        """
        chunks = _chunks(np.asarray(readings))
        total = cls._of_chunk(next(chunks), single)
        for chunk in chunks:
            total = total.merged(cls._of_chunk(chunk, single))
        return total

    @classmethod
    def _of_chunk(cls, chunk: NDArray[np.generic], single: bool) -> Moments:
        if chunk.shape[1] >= MIN_COMPILED_ROWS and is_sparse(chunk):
            return cls(len(chunk), *sparse_comoments(chunk))
        if single and (found := _float32_deviations(chunk)) is not None:
            centre, small = found
            beside = (np.ones(len(chunk), np.float32) @ small).astype(np.float64) / len(chunk)
            comoment = np.outer(-len(chunk) * beside, beside)
            for begin in range(0, len(small), SINGLE_FRAMES):
                part = small[begin : begin + SINGLE_FRAMES]
                comoment += part.T @ part
            return cls(len(chunk), centre + beside, comoment)
        # Subtracting the first frame first leaves no rounding error for constant sensors.
        deviations = np.asarray(chunk, dtype=np.float64) - chunk[0]
        mean = deviations.mean(axis=0)
        deviations -= mean
        return cls(len(chunk), chunk[0] + mean, deviations.T @ deviations)

    def merged(self, other: Moments) -> Moments:
        """Merge with the moments of other frames of the same sensors.

        The order of merging affects rounding only.

        Notes
        -----
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
        """Return Pearson's r of every pair of sensors.

        Returns
        -------
        ndarray of shape (N, N)
            In [-1, 1], exactly symmetric, ones on the diagonal; 0 between a constant sensor and
            any other.
        """
        return correlation_of_comoments(self.comoment)


@dataclass(frozen=True, eq=False)
class CoOccurrences:
    """Joint counts of binary series over T frames.

    n_frames: T.
    first: First series of each sensor: see `anisomap.numerics.similarity.co_occurrence.Layout`.
    counts: Frames in which both series are on; symmetric.
    """

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


@dataclass(frozen=True, eq=False)
class StoredCodes:
    """Codes of all frames, which take less memory than joint counts of many sensors.

    n_frames: T.
    parts: Small non-negative integers, in the order of the frames.
    """

    n_frames: int
    parts: tuple[NDArray[np.integer[Any]], ...]

    @classmethod
    def of(cls, codes: NDArray[np.integer[Any]]) -> StoredCodes:
        """Store codes of shape (T, N) in the smallest integer type."""
        return cls(len(codes), (codes.astype(np.min_scalar_type(codes.max(initial=0))),))

    def merged(self, other: StoredCodes) -> StoredCodes:
        """Append the codes of later frames of the same sensors."""
        return StoredCodes(self.n_frames + other.n_frames, self.parts + other.parts)

    def whole(self) -> NDArray[np.integer[Any]]:
        """Concatenate all codes, shape (T, N)."""
        return np.concatenate(self.parts)


def correlation_of_comoments(comoment: NDArray[np.float64]) -> Reals:
    """Normalise co-moments to correlations; see `Moments.correlation`."""
    return correlation_of_blocks(np.diag(comoment), lambda rows: comoment[rows])


def correlation_of_blocks(
    squares: NDArray[Any], comoments: Callable[[slice], NDArray[np.float64]]
) -> Reals:
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


def _float32_deviations(
    chunk: NDArray[Any],
) -> tuple[NDArray[np.float64], NDArray[np.float32]] | None:
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


def _chunks(readings: NDArray[np.generic]) -> Iterator[NDArray[np.generic]]:
    for start in range(0, len(readings), CHUNK_FRAMES):
        yield readings[start : start + CHUNK_FRAMES]
